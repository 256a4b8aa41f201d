"""The table of docs/benchmark_suite.md: its place in the page, and its rows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from studies import benchmark_suite
from studies.outcomes.outcome import RESULTS_PART
from swarmd.sim.experiments.benchmark import load_task

pytestmark = pytest.mark.long


def test_files_of_other_seeds_make_one_row_for_each_pattern(tmp_path: Path) -> None:
    first, second = tmp_path / "a.csv", tmp_path / "b.json"
    first.write_text("task,seed,value,name\nshelter,0,0.25,walk\nshelter,0,0.5,light\n")
    results = [{"name": "walk", "values": {"1": 0.75, "2": None}}]
    second.write_text(json.dumps({"tasks": [{"name": "shelter", "results": results}]}))
    _, _, *rows = benchmark_suite.table([str(first), str(second)]).splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert cells == [
        ["`shelter`", "-", "`light`", "0.50", "-", "share", "1"],  # intervals that are unknown
        ["`shelter`", "-", "`walk`", "0.50", "0.25 to 0.75", "share", "2"],
    ]


def test_the_page_has_one_place_for_the_table() -> None:
    assert len(RESULTS_PART.findall(benchmark_suite.PAGE.read_text())) == 1


def test_all_arenas_have_the_scale_of_the_bar() -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("mujoco")
    figure = benchmark_suite.figure_of([load_task(name) for name in ("doorway", "transport")])
    scales = [
        axes.bbox.size / np.ptp([axes.get_xlim(), axes.get_ylim()], 1) for axes in figure.axes
    ]
    (bar,) = figure.findobj(lambda artist: artist.get_gid() == benchmark_suite.BAR)
    length = np.ptp(bar.get_transform().transform(bar.get_xydata())[:, 0])  # type: ignore[attr-defined]
    assert np.array(scales) == pytest.approx(np.full((2, 2), length))
    (legend,) = figure.legends
    assert "source of items" in [text.get_text() for text in legend.get_texts()]

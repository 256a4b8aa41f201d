"""The table of docs/benchmark_suite.md: its rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import swarmd.config
from studies import benchmark_suite

pytestmark = pytest.mark.long
SUITE = Path(swarmd.config.__path__[0]) / "scenarios" / "benchmark"


def short(tmp_path: Path) -> str:
    task = yaml.safe_load((SUITE / "doorway.yaml").read_text())
    file = tmp_path / "short.yaml"
    file.write_text(yaml.safe_dump({**task, "duration": 0.5}))
    return str(file)


@pytest.mark.parametrize("patterns", [("drive", "random_walk"), ("stand",)])
def test_the_table_has_the_patterns_of_a_task(tmp_path: Path, patterns: tuple[str, ...]) -> None:
    results = benchmark_suite.results_of(short(tmp_path), range(2), patterns, tmp_path, 1)
    head, _, *rows = benchmark_suite.table([results]).splitlines()
    assert [cell.strip() for cell in head.strip("|").split("|")] == [
        "task", "rank", "pattern", "median", "95 %", "unit", "runs",
    ]  # fmt: skip
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [(one[0], one[2], one[-1]) for one in cells] == [
        ("`short`", f"`{pattern}`", "2") for pattern in patterns
    ]


def test_all_arenas_have_the_scale_of_the_bar() -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("mujoco")
    figure = benchmark_suite.figure_of(("benchmark/doorway", "benchmark/transport"))
    figure.draw_without_rendering()
    scales = [
        axes.bbox.size / np.ptp([axes.get_xlim(), axes.get_ylim()], 1) for axes in figure.axes
    ]
    (bar,) = figure.findobj(lambda artist: artist.get_gid() == benchmark_suite.BAR)
    length = np.ptp(bar.get_transform().transform(bar.get_xydata())[:, 0])  # type: ignore[attr-defined]
    assert np.array(scales) == pytest.approx(np.full((2, 2), length))
    (legend,) = figure.legends
    assert "source of items" in [text.get_text() for text in legend.get_texts()]

"""The picture of one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tests.sim.plots.conftest import Overlaps, Walk

pytest.importorskip("matplotlib")
Full = Callable[[int], Trace]


def labels(figure: Figure) -> list[str]:
    return [
        text.get_text() for text in (figure.axes[0].get_legend() or figure.legends[0]).get_texts()
    ]


def test_each_robot_has_its_line_in_the_legend(walk: Walk) -> None:
    figure = trajectories_figure(walk(3))
    assert labels(figure) == ["tb3-00", "tb3-01", "tb3-02", "start", "end"]
    assert figure.axes[0].get_aspect() == 1.0


def test_the_legend_names_each_kind_of_mark(full: Full) -> None:
    assert labels(trajectories_figure(full(3))) == [
        *("tb3-00", "tb3-01", "tb3-02", "start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]


def test_many_robots_are_coloured_by_time_and_not_named(full: Full) -> None:
    figure = trajectories_figure(full(30))
    assert labels(figure) == [
        *("start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["y [m]", "time [s]"]


@pytest.mark.parametrize("n", [2, 7, 20, 21, 200])
def test_no_texts_overlap(full: Full, overlaps: Overlaps, n: int) -> None:
    trace = full(n)
    trace = replace(trace, ids=tuple(f"{robot}-waffle_pi-WWW" for robot in trace.ids))
    title = "paper_exp1_hardware, law=paper,lidar_visibility=real, seed 519\nleast typical run"
    assert overlaps(trajectories_figure(trace, title)) == []


@pytest.mark.parametrize("n", [1, 7, 30])
def test_one_instant_is_a_picture(walk: Walk, n: int, tmp_path: Path) -> None:
    save(trajectories_figure(walk(n, 1)), tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 5_000


def test_an_empty_run_is_an_error(walk: Walk) -> None:
    with pytest.raises(SwarmError, match="nothing to draw"):
        trajectories_figure(walk(2, 0))

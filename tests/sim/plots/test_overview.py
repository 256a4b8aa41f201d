"""Many runs at a glance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from swarmd.sim.plots.trajectories import MAX_RUNS, overview_figure
from tests.sim.plots.runs import walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")


def note(figure: Figure) -> str:
    return figure.get_supxlabel()


def test_each_run_has_its_place_and_name() -> None:
    trace = walk(3)
    figure = overview_figure([(f"seed {k}", lambda: trace) for k in range(7)])
    assert [axes.get_title() for axes in figure.axes] == [f"seed {k}" for k in range(7)]
    figure.draw_without_rendering()
    assert len({round(axes.get_position().x0, 6) for axes in figure.axes}) == 3
    assert figure.get_suptitle() == "7 runs"


def test_all_are_drawn_to_one_scale_which_is_reported() -> None:
    small, large = walk(1, arena="3x3"), walk(9, arena="6x4")
    figure = overview_figure([("a", lambda: small), ("b", lambda: large)], note="by seed")
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()
    assert note(figure).startswith("by seed; each frame 6.24 m x 4.24 m; outlines: starts;")


def test_a_run_without_a_trace_is_named() -> None:
    trace = walk(3)
    figure = overview_figure([("a", lambda: None), ("b", lambda: trace)])
    assert [len(axes.texts) for axes in figure.axes] == [1, 0]
    assert [text.get_text() for text in figure.axes[0].texts] == ["no trace"]


def test_more_than_fit_are_counted() -> None:
    trace = walk(2, 3)
    figure = overview_figure([(str(k), lambda: trace) for k in range(MAX_RUNS + 3)])
    assert len(figure.axes) == MAX_RUNS
    assert note(figure).startswith("the first 25 of 28 runs")

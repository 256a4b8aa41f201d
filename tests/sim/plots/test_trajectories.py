"""The picture of one run, and of many at a glance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.theme import new_figure
from swarmd.sim.plots.trajectories import (
    BOTH,
    MAX_RUNS,
    NONE,
    ONE,
    OTHER,
    Mark,
    marks_of,
    overview_figure,
    paint_contacts,
    trajectories_figure,
)
from tests.sim.plots.runs import full, walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")


def labels(figure: Figure) -> list[str]:
    return [
        text.get_text() for text in (figure.axes[0].get_legend() or figure.legends[0]).get_texts()
    ]


def test_each_robot_has_its_line_in_the_legend() -> None:
    figure = trajectories_figure(walk(3))
    assert labels(figure) == ["tb3-00", "tb3-01", "tb3-02", "start", "end"]
    assert figure.axes[0].get_aspect() == 1.0


def test_the_legend_names_each_kind_of_mark() -> None:
    assert labels(trajectories_figure(full(3))) == [
        *("tb3-00", "tb3-01", "tb3-02", "start", "end", "joins", "leaves", "movable box or item"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]


def test_many_robots_are_coloured_by_time_and_not_named() -> None:
    figure = trajectories_figure(full(30))
    assert labels(figure) == [
        *("start", "end", "joins", "leaves", "movable box or item"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["y [m]", "time [s]"]


def test_robots_that_are_pushed_together_do_not_move() -> None:
    trace = walk(2, contact_t=np.array([0.5]), contact_pair=np.array([[0, 1]]),
                 contact_speed=np.zeros((1, 2)))  # fmt: skip
    (mark,) = marks_of(trace)
    assert mark.kind == NONE
    assert mark.place == pytest.approx(tuple(trace.pose[5, :, :2].mean(axis=0)))


def test_contacts_of_a_kind_at_one_place_have_one_mark_with_their_number() -> None:
    axes = new_figure(3.0, 3.0).add_subplot()
    axes.set_xlim(-2.0, 2.0)
    marks = marks_of(full(2))
    assert [mark.kind for mark in marks] == [BOTH, ONE, OTHER]  # a long contact has one
    near, far = Mark(BOTH, (1.31, 1.0)), Mark(BOTH, (-1.0, 1.0))
    paint_contacts(axes, [*marks, *[Mark(BOTH, (1.29, 1.0)), near] * 50, far], size=8.0)
    (x, y), *others = (np.asarray(dots.get_offsets())[0] for dots in axes.collections)
    assert len(others) == 4  # the far one, and one of each kind
    assert (-1.0, 1.0) in {(x, y), *map(tuple, others)}
    assert any(np.allclose(place, (1.3, 1.0)) for place in [(x, y), *others])
    assert [text.get_text() for text in axes.texts] == ["100"]


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


def test_each_robot_has_its_start_mark_though_its_pose_is_known_later() -> None:
    """As in the recording of a robot that was switched on after the others."""
    trace = walk(3)
    trace.pose[:7, 1] = np.nan
    axes = trajectories_figure(trace).axes[0]
    hollow = [
        np.asarray(path.vertices)
        for body in axes.collections
        if not np.size(body.get_facecolor()) and body.get_zorder() == 3.0
        for path in body.get_paths()
        if np.size(path.vertices) > 4
    ]
    middles = np.array([corners[:-1].mean(axis=0) for corners in hollow])
    starts = [trace.pose[0, 0, :2], trace.pose[7, 1, :2], trace.pose[0, 2, :2]]
    assert len(middles) == 3
    assert np.abs(middles - starts).max() < 0.3

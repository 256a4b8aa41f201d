"""The picture of one run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.theme import new_figure
from swarmd.sim.plots.trajectories import (
    BOTH,
    NONE,
    ONE,
    OTHER,
    marks_of,
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
        *("tb3-00", "tb3-01", "tb3-02", "start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]


def test_many_robots_are_coloured_by_time_and_not_named() -> None:
    figure = trajectories_figure(full(30))
    assert labels(figure) == [
        *("start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["y [m]", "time [s]"]


def test_robots_that_are_pushed_together_do_not_move() -> None:
    trace = walk(2, contact_t=np.array([0.5]), contact_pair=np.array([[0, 1]]),
                 contact_speed=np.zeros((1, 2)))  # fmt: skip
    (mark,) = marks_of(trace)
    assert mark.kind == NONE
    assert mark.place == pytest.approx(tuple(trace.pose[5, :, :2].mean(axis=0)))


def test_each_kind_of_contact_is_painted_with_all_its_marks() -> None:
    axes = new_figure(3.0, 3.0).add_subplot()
    marks = marks_of(full(2))
    assert [mark.kind for mark in marks] == [BOTH, ONE, OTHER]  # a long contact has one
    paint_contacts(axes, [*marks, marks[0]], size=8.0)
    assert [len(np.asarray(dots.get_offsets())) for dots in axes.collections] == [2, 1, 1]

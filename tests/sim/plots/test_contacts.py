"""Every contact has one mark, which shows the moving robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.contacts import BOTH, NONE, ONE, OTHER, face_of, marks_of, paint_contacts
from swarmd.sim.plots.scene import robot_colour
from swarmd.sim.plots.theme import CONTACT_COLOUR, new_figure
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from tests.sim.plots.conftest import Walk

Full = Callable[[int], Trace]


def test_a_long_contact_has_one_mark(full: Full) -> None:
    marks = marks_of(full(2))
    assert [(mark.kind, mark.movers) for mark in marks] == [
        (BOTH, (0, 1)),
        (ONE, (1,)),
        (OTHER, (1,)),
    ]


def test_robots_that_are_pushed_together_do_not_move(walk: Walk) -> None:
    trace = walk(2, contact_t=np.array([0.5]), contact_pair=np.array([[0, 1]]),
                 contact_speed=np.zeros((1, 2)))  # fmt: skip
    (mark,) = marks_of(trace)
    assert (mark.kind, mark.movers) == (NONE, ())
    between = trace.pose[5, :, :2].mean(axis=0)
    assert mark.place == pytest.approx(tuple(between))


def test_a_single_mover_gives_its_colour_where_robots_have_one(full: Full) -> None:
    both, one, _ = marks_of(full(2))
    assert face_of(both, is_by_robot=True) == CONTACT_COLOUR
    assert face_of(one, is_by_robot=True) == robot_colour(1)
    assert face_of(one, is_by_robot=False) == CONTACT_COLOUR


def test_each_kind_is_painted_with_all_its_marks(full: Full) -> None:
    pytest.importorskip("matplotlib")
    axes = new_figure(3.0, 3.0).add_subplot()
    marks = marks_of(full(2))
    paint_contacts(axes, [*marks, marks[0]], is_by_robot=True, size=8.0)
    assert [len(np.asarray(dots.get_offsets())) for dots in axes.collections] == [2, 1, 1]

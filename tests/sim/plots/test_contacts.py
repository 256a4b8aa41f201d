"""Every contact has one mark, which shows how many robots were moving."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.theme import new_figure
from swarmd.sim.plots.trajectories import BOTH, NONE, ONE, OTHER, marks_of, paint_contacts
from swarmd.sim.trace import Trace
from tests.sim.plots.runs import full, walk




def test_a_long_contact_has_one_mark() -> None:
    marks = marks_of(full(2))
    assert [mark.kind for mark in marks] == [BOTH, ONE, OTHER]


def test_robots_that_are_pushed_together_do_not_move() -> None:
    trace = walk(2, contact_t=np.array([0.5]), contact_pair=np.array([[0, 1]]),
                 contact_speed=np.zeros((1, 2)))  # fmt: skip
    (mark,) = marks_of(trace)
    assert mark.kind == NONE
    between = trace.pose[5, :, :2].mean(axis=0)
    assert mark.place == pytest.approx(tuple(between))


def test_each_kind_is_painted_with_all_its_marks() -> None:
    pytest.importorskip("matplotlib")
    axes = new_figure(3.0, 3.0).add_subplot()
    marks = marks_of(full(2))
    paint_contacts(axes, [*marks, marks[0]], size=8.0)
    assert [len(np.asarray(dots.get_offsets())) for dots in axes.collections] == [2, 1, 1]

"""Touches: once each, and who ran into whom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarmd.sim.metrics import contacts
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.trace import ARENA
from tests.sim.metrics.runs import run

STILL = np.zeros((1, 3, 3))


def test_contacts_with_robots_and_arena_are_counted_separately() -> None:
    steps = [(0.01 * k, 0, 1) for k in range(100)]
    steps += [(5.0, 1, 0), (5.2, 2, ARENA), (9.0, 2, ARENA)]
    trace = run(STILL, steps)
    pairs = [(one.a, one.b) for one in contacts.contact_list(trace)]
    assert sorted(pairs) == [("r0", "r1")] * 2 + [("r2", contacts.WALLS)] * 2
    assert contacts.count_of(trace, "robot") == 2
    assert contacts.count_of(trace, "arena") == 2
    assert METRICS["box_contacts"].value(trace) is None


def test_a_new_contact_begins_only_after_a_pause() -> None:
    trace = run(STILL, [(0.0, 0, 1), (0.5, 0, 1), (1.1, 0, 1)])
    assert contacts.count_of(trace, "robot") == 2
    assert len(contacts.contact_list(trace, gap=0.4)) == 3
    assert len(contacts.contact_list(trace, gap=1.0)) == 1


def test_a_robot_called_arena_is_not_taken_for_the_walls() -> None:
    trace = run(STILL, [(0.0, 0, 1)], ids=("arena", "b", "c"))
    assert contacts.count_of(trace, "robot") == 1
    assert contacts.count_of(trace, "arena") == 0


def test_movable_boxes_are_counted_apart_from_the_arena() -> None:
    steps = [(0.0, 0, ARENA - 1), (0.0, 1, ARENA - 2), (0.0, 2, ARENA)]
    trace = run(STILL, steps, movable_boxes=("crate", "chest"))
    assert [(one.a, one.b, one.kind) for one in contacts.contact_list(trace)] == [
        ("r0", "crate", "box"),
        ("r1", "chest", "box"),
        ("r2", contacts.WALLS, "arena"),
    ]
    assert METRICS["box_contacts"].value(trace) == 2
    assert contacts.count_of(trace, "arena") == 1


def test_the_list_has_the_moving_robots_and_the_closing_speed() -> None:
    # Given once from the other side: its speeds belong to the robots all the same.
    steps = [(1.0, 0, 2, 0.2, 0.005), (1.1, 2, 0, 0.01, 0.25), (1.2, 0, 2, -0.1, 0.0)]
    (contact,) = contacts.contact_list(run(STILL, steps))
    assert (contact.start, contact.end) == (1.0, 1.2)
    assert (contact.a, contact.b, contact.kind) == ("r0", "r2", "robot")
    assert contact.closing_speed == pytest.approx(0.26)
    assert (contact.is_a_moving, contact.is_b_moving) == (True, False)  # 1 cm/s is still standing
    (contact,) = contacts.contact_list(run(STILL, [(0.0, 0, 1, -0.2, 0.3)]))
    assert (contact.is_a_moving, contact.is_b_moving) == (False, True)  # `a` draws back
    assert contact.closing_speed == pytest.approx(0.1)


def test_the_list_is_in_order_of_time() -> None:
    trace = run(STILL, [(3.0, 0, 1), (1.0, 1, 2), (2.0, 0, ARENA)])
    assert [one.start for one in contacts.contact_list(trace)] == [1.0, 2.0, 3.0]


def test_hardest_contact_is_of_robots() -> None:
    trace = run(STILL, [(0.0, 0, 1, 0.1, 0.1), (0.0, 1, 2, 0.3, 0.2), (0.0, 2, ARENA, 0.9, 0.0)])
    assert contacts.hardest_contact(trace) == pytest.approx(0.5)
    assert contacts.hardest_contact(run(STILL)) is None


def test_absent_robots_can_have_contacts() -> None:
    trace = replace(run(STILL, [(0.0, 0, 1)]), present=np.array([[True, False, True]]))
    assert contacts.count_of(trace, "robot") == 1

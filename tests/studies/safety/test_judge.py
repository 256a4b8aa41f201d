"""The judge of collisions, on traces made by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from studies.safety.judge import collisions, stuck_windows
from studies.safety.judgement import Judgement, judge
from swarmd.core.values import Array
from swarmd.sim.metrics.contacts import WALLS
from swarmd.sim.trace import ARENA, Trace
from tests.support.traces import trace_of

Row = tuple[float, int, int, float, float]
"""A step of a contact: time, the two robots, and the closing speed of each one's surface."""


def run(
    touches: Sequence[Row] = (),
    *,
    pose: Array | None = None,
    seconds: float = 20.0,
    command: float = 0.1,
) -> Trace:
    """Two robots, face to face, and a rammer beyond; 2 m apart, ten instants per second.

    Each robot has the command `command` in m/s.
    """
    if pose is None:
        pose = np.zeros((round(10.0 * seconds) + 1, 3, 3))
        pose[:, :, 0], pose[:, 1, 2] = (0.0, 2.0, 4.0), np.pi
    safe = np.zeros_like(pose)
    safe[..., 0] = command
    return trace_of(pose, touches, ids=("a", "b", "ram"), safe=safe, movable_boxes=("crate",))


def judged(*touches: Row) -> Judgement:
    return judge(run(touches), {"ram"})


def test_a_trace_without_contacts_has_no_collisions() -> None:
    found = judged()
    assert (found.collisions, found.faults, found.touches, found.worst) == (0, 0, 0, 0.0)
    assert found.seconds == pytest.approx(40.0)  # of the two protected robots
    assert (found.goals, found.goal_seconds, found.windows, found.stuck) == (0, 0.0, 0, 0)
    # The second and the rammer are back to back: 2 m less twice the outline behind an axle.
    assert found.min_gap == pytest.approx(2.0 - 2.0 * 0.102)


@pytest.mark.parametrize(
    ("touch", "collided", "at_fault"),
    [
        ((5.0, 0, 1, 0.0, 0.0), 1, 0),  # contact without motion
        ((5.0, 0, 1, 0.1, 0.0), 1, 1),  # the first drives into the second
        ((5.0, 0, 1, -0.1, 0.2), 1, 1),  # the second drives into the first, which backs away
        ((5.0, 0, 2, 0.0, 0.3), 1, 0),  # rammed at rest
        ((5.0, 0, 2, 0.02, 0.3), 1, 0),  # at the allowed speed
        ((5.0, 0, 2, 0.021, 0.3), 1, 1),  # above the allowed speed
        ((5.0, 2, 0, 0.3, 0.1), 1, 1),  # the same with the robots in reverse order
        ((5.0, 2, 0, 0.3, -0.1), 1, 0),
    ],
)
def test_the_robot_that_closes_is_at_fault(touch: Row, collided: int, at_fault: int) -> None:
    found = judged(touch)
    assert (found.collisions, found.faults) == (collided, at_fault)


def test_contacts_between_rammers_do_not_count() -> None:
    assert collisions(run([(5.0, 1, 2, 0.3, 0.3)]), {"b", "ram"}) == []


def test_a_long_touch_counts_once_a_second() -> None:
    steps: list[Row] = [(5.0 + 0.01 * i, 0, 1, 0.1, 0.0) for i in range(250)]
    assert judged(*steps).collisions == 3
    assert judged(*steps[:100]).collisions == 1
    assert judged(steps[0], (5.0, 0, 2, 0.1, 0.0)).faults == 2  # each pair counts separately


def test_the_fastest_own_surface_within_a_count_is_reported() -> None:
    found = collisions(
        run([(5.0, 0, 2, 0.0, 0.3), (5.1, 0, 2, 0.07, 0.0), (5.2, 0, 2, 0.03, 0.3)]), {"ram"}
    )
    assert [(one.time, one.a, one.b, one.robot) for one in found] == [(5.0, "a", "ram", "a")]
    assert found[0].own_speed == pytest.approx(0.07)


def test_a_pushed_robot_with_command_zero_is_not_at_fault() -> None:
    trace = run([(5.0, 0, 1, 0.2, 0.0), (8.0, 0, ARENA, 0.2, 0.0)], command=0.0)
    found = judge(trace)
    assert (found.collisions, found.touches) == (1, 1)
    assert (found.faults, found.touch_faults, found.pushed) == (0, 0, 2)


@pytest.mark.parametrize(
    ("at", "twist", "is_fault"),
    [
        (4.9, (0.1, 0.0), True),
        (4.6, (0.1, 0.0), True),
        (4.9, (0.0, 0.2), True),  # a corner of it moves at 2.7 cm/s
        (4.9, (0.0, 0.1), False),
        (4.3, (0.1, 0.0), False),  # it has come to rest since
        (5.1, (0.1, 0.0), False),  # after the contact
    ],
)
def test_a_command_shortly_before_makes_a_motion_its_own(
    at: float, twist: tuple[float, float], is_fault: bool
) -> None:
    trace = run([(5.0, 0, 1, 0.2, 0.0)], command=0.0)
    trace.safe[np.isclose(trace.t, at), 0, :2] = twist
    assert [one.is_fault for one in collisions(trace)] == [is_fault]


def test_the_command_of_the_other_robot_does_not_change_the_judgement() -> None:
    trace = run([(5.0, 0, 1, 0.2, 0.0)], command=0.0)
    trace.safe[:, 1, 0] = 0.1
    assert [one.is_pushed for one in collisions(trace)] == [True]


def test_a_robot_that_drives_on_after_a_push_is_at_fault() -> None:
    trace = run([(5.0, 0, 1, 0.3, 0.0), (5.5, 0, 1, 0.1, 0.0)], command=0.0)
    trace.safe[np.isclose(trace.t, 5.5), 0, 0] = 0.1
    (found,) = collisions(trace)
    assert (found.is_fault, found.is_pushed) == (True, False)
    assert (found.own_speed, found.pushed_speed) == pytest.approx((0.1, 0.3))


@pytest.mark.parametrize(
    ("touches", "hits"),
    [
        ([(5.0, 0, 2, 0.1, 0.0)], [True]),
        ([(5.0, 0, 2, 0.0, 0.1), (5.01, 0, 2, 0.1, 0.0)], [False]),  # it was rammed, then drove
        ([(5.0, 0, 2, 0.0, 0.1), (5.4, 0, 2, 0.0, 0.0), (6.0, 0, 2, 0.1, 0.0)], [False, True]),
        ([(5.0 + 0.1 * i, 0, 2, 0.1, 0.0) for i in range(11)], [True, False]),
    ],
)
def test_fault_is_judged_at_the_first_step_of_a_touch(touches: list[Row], hits: list[bool]) -> None:
    trace = run(touches)
    assert [one.is_hit for one in collisions(trace, {"ram"})] == hits
    assert judge(trace, {"ram"}).hits == sum(hits)


@pytest.mark.parametrize(("other", "name"), [(ARENA, WALLS), (ARENA - 1, "crate")])
def test_walls_and_boxes_count_apart_from_robots(other: int, name: str) -> None:
    touches: list[Row] = [(5.0, 1, other, 0.1, 0.0)]
    found = judged(*touches)
    assert (found.collisions, found.touches, found.touch_faults) == (0, 1, 1)
    assert found.worst_touch == pytest.approx(0.1)
    assert collisions(run(touches))[0].b == name


def test_a_box_pushed_into_a_robot_at_rest_is_no_fault() -> None:
    assert judged((5.0, 1, ARENA - 1, 0.0, 0.5)).touch_faults == 0


def test_robots_that_start_in_contact_are_not_judged_until_they_part() -> None:
    resting: list[Row] = [(0.01 * i, 0, 1, 0.1, 0.0) for i in range(1, 400)]
    assert judged(*resting).collisions == 0
    assert judged(*resting, (6.0, 0, 1, 0.1, 0.0)).collisions == 1


def test_a_robot_that_stays_at_its_place_is_stuck_and_one_that_travels_is_not() -> None:
    t = np.linspace(0.0, 20.0, 201)
    pose = np.zeros((len(t), 3, 3))
    pose[:, 0, 0] = 0.02 * np.sin(t)
    pose[:, 1, 0] = 2.0 + 0.01 * t  # 10 cm in a window
    pose[:, 2, 0] = 6.0
    trace = run(pose=pose)
    assert stuck_windows(trace, np.array([0])) == (2, 2)
    assert stuck_windows(trace, np.array([1])) == (2, 0)


def test_an_incomplete_last_window_does_not_count() -> None:
    assert stuck_windows(run(seconds=29.0), np.array([0])) == (2, 2)


def test_goals_are_the_last_counts_of_protected_robots() -> None:
    trace = run()
    goals = np.full((len(trace.t), 3), np.nan)
    goals[1:, 0], goals[1:, 1], goals[1:, 2] = 2.0, 3.0, 50.0
    goals[-1, 1] = 4.0
    trace.report["goals"] = goals  # type: ignore[index]  # this trace has a dict
    found = judge(trace, {"ram"})
    assert (found.goals, found.windows, found.stuck) == (6, 4, 4)
    assert found.goal_seconds == pytest.approx(40.0)

"""What robots are to do beside what they do, and the reason of each difference."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.goal import GoalState
from swarmd.core.messages import Latch, Presence, Reason, State
from swarmd.operator.session.members_view import Contact
from swarmd.operator.verbs.goal.words import (
    Difference,
    content_of,
    describe_goal,
    differences,
    present_goals,
    set_apart,
)
from tests.support.goals import goal_status, make_goal, member_with, view_of
from tests.support.statuses import make_member

DRIVE = make_goal(7)
STAND = make_goal(8, None)
RED = make_goal(9, "flocking", targets=("label:red",))


def line(member: Any, *others: Any) -> Difference:
    """The line of one robot, beside others."""
    return differences(view_of(member, *others), [member.robot])[0]


def test_a_robot_that_runs_its_goal_is_as_desired() -> None:
    found = line(member_with("r1", goal_status(DRIVE)))
    assert (found.desired, found.actual, found.reason) == ("drive", "running drive", "")
    assert found.is_as_desired


@pytest.mark.parametrize(
    ("state", "changes", "reason"),
    [
        (GoalState.OFFERED, {"reason": "offered: resume takes it"}, "offered"),
        (GoalState.ENDED, {"reason": "stopped by bob"}, "stopped by bob"),
        (GoalState.ENDED, {"reason": "", "superseded": "goal 9 of bob: flocking"}, "goal 9 of bob"),
        (GoalState.LOADING, {}, "loading"),
    ],
)
def test_the_reason_is_that_of_the_robot(
    state: GoalState, changes: dict[str, Any], reason: str
) -> None:
    goals = goal_status(DRIVE, state=state, **changes)
    found = line(member_with("r1", goals, state=State.STOPPED, reason=Reason.OPERATOR))
    assert not found.is_as_desired
    assert reason in found.reason


def test_a_run_that_an_emergency_stop_ended_is_told_apart_from_an_emergency_stop() -> None:
    goals = goal_status(DRIVE, state=GoalState.ENDED, reason="estopped (estop) by bob")
    found = line(member_with("r1", goals, state=State.IDLE, reason=Reason.RESET))
    assert found.reason == "its run ended: estopped (estop) by bob; resume runs the goal again"


def test_an_emergency_stop_names_its_issuer() -> None:
    latches = {"e1": Latch(issuer="bob", scope="swarm", reason="smoke", age=3.0)}
    found = line(member_with("r1", goal_status(DRIVE), state=State.ESTOPPED, latches=latches))
    assert found.reason == "estopped by bob, 3.0 s ago, for swarm: smoke"


def test_a_goal_that_another_robot_holds_has_not_come_yet() -> None:
    late = member_with("r1", goal_status(DRIVE))
    found = line(late, member_with("r2", goal_status(RED)))
    assert (found.desired, found.is_as_desired) == ("flocking", False)
    assert "goal 9 of anna" in found.reason
    assert line(late, member_with("r2", goal_status(STAND))).desired == "stand"


def test_a_goal_for_other_labels_leaves_a_robot_with_its_own() -> None:
    other = member_with("r1", goal_status(RED, own=DRIVE), labels=())
    assert line(other).goal == DRIVE
    assert line(other).is_as_desired
    free = line(member_with("r1", None, labels=()), member_with("r2", goal_status(RED)))
    assert (free.goal, free.is_as_desired) == (None, True)
    assert "no target" in free.note


def test_a_robot_that_stands_does_what_a_goal_without_a_pattern_wants() -> None:
    goals = goal_status(STAND, state=GoalState.STANDING)
    stopped = member_with("r1", goals, state=State.STOPPED, pattern=None)
    assert line(stopped).is_as_desired
    assert not line(member_with("r1", goals)).is_as_desired


@pytest.mark.parametrize("presence", [Presence.FAILED, Presence.LEFT])
def test_a_robot_that_is_gone_is_named(presence: Presence) -> None:
    gone = make_member("r1", presence, age=3.0)
    found = line(gone, member_with("r2", goal_status(DRIVE)))
    assert (found.actual, found.desired) == (presence.value, "drive")
    assert presence.value in found.reason


def test_a_robot_of_the_roster_that_was_never_seen_is_absent() -> None:
    view = view_of(member_with("r2", goal_status(DRIVE)), roster=("r9",))
    assert differences(view, ["r9"])[0].actual == "absent"


def test_a_robot_of_another_version_is_a_difference() -> None:
    from msgspec.structs import replace

    other = replace(make_member("r1"), status=None, contact=Contact.OTHER_VERSION, version="9.9")
    assert "9.9" in line(other).reason


def test_the_present_goal_is_the_greatest_one_held_and_has_one_before() -> None:
    view = view_of(
        member_with("r1", goal_status(DRIVE)),
        member_with("r2", goal_status(RED, before=DRIVE)),
        member_with("r3", None),
    )
    assert present_goals(view) == (RED, DRIVE)
    assert present_goals(view_of(member_with("r3", None))) == (None, None)


def test_undo_sets_apart_who_runs_and_who_stands() -> None:
    view = view_of(make_member("r1", labels=("red",)), make_member("r2", labels=("blue",)))
    blue = make_goal(6, targets=("label:blue",))
    assert set_apart(view, RED, blue) == (["r2"], ["r1"])
    assert set_apart(view, RED, DRIVE) == (["r1", "r2"], [])
    assert set_apart(view, STAND, blue) == (["r2"], [])


def test_an_undone_goal_is_desired_no_more() -> None:
    blue = make_goal(8, "flocking", targets=("r2",))
    again = make_goal(9, targets=("r1",), undoes=blue.id)
    first = member_with("r1", goal_status(again))
    ended = goal_status(blue, state=GoalState.ENDED, reason="stopped by bob")
    found = line(member_with("r2", ended, state=State.STOPPED, reason=Reason.OPERATOR), first)
    assert (found.goal, found.desired, found.is_as_desired) == (None, "-", True)
    assert "was undone" in found.note
    missed = line(member_with("r2", goal_status(blue)), first)
    assert (missed.is_as_desired, missed.desired) == (False, "-")
    later = make_goal(10, targets=("r2",))
    assert (
        line(member_with("r2", ended), first, member_with("r3", goal_status(later))).goal == later
    )


def test_the_content_of_a_goal_makes_an_equal_one() -> None:
    again = make_goal(10, **{k: v for k, v in content_of(RED).items() if k != "pattern"})
    assert content_of(again) == {**content_of(RED), "pattern": "drive"}


def test_a_goal_in_words() -> None:
    goal = make_goal(7, params={"speed": 0.1}, targets=("tb3-*", "label:red"), seconds=60.0)
    words = describe_goal(goal)
    for part in ("goal 7 of anna: drive", "speed=0.1", "tb3-*, label red", "for 60 s"):
        assert part in words

"""Conditions that an operator waits for."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.goal import GoalState
from swarmd.core.messages import Presence, State
from swarmd.operator.verbs.wait.words import Awaited, meeting, read_awaited, unmet
from tests.support.goals import goal_status, make_goal, member_with, view_of
from tests.support.statuses import make_member

RUNNING = make_member("r1")
IDLE = make_member("r2", state=State.IDLE, pattern=None)
FAILED = make_member("r3", Presence.FAILED)
ALL = ("r1", "r2", "r3")


def test_reads_conditions() -> None:
    words = ["state=running", "pattern=drive", "goal", "count=3", "presence=alive"]
    assert read_awaited(words) == Awaited("running", "drive", "alive", goal=True, count=3)


@pytest.mark.parametrize(
    ("word", "subject"),
    [
        ("stat=running", "'state'"),
        ("state=runing", "'running'"),
        ("state", "state=VALUE"),
        ("goal=7", "without a value"),
        ("count=0", "count=5"),
        ("count=x", "count=5"),
        ("pattern=A B", "'A B'"),
        ("presence=here", "presence"),
    ],
)
def test_refuses_wrong_conditions(word: str, subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        read_awaited([word])


def test_a_condition_stands_once() -> None:
    with pytest.raises(ConfigError, match="already"):
        read_awaited(["state=idle", "state=running"])


@pytest.mark.parametrize(
    ("awaited", "lacking"),
    [
        (Awaited(state="running"), {"r2", "r3"}),
        (Awaited(state="idle"), {"r1", "r3"}),
        (Awaited(pattern="drive"), {"r2", "r3"}),
        (Awaited(presence="alive"), {"r3"}),
        (Awaited(presence="failed"), {"r1", "r2"}),
        (Awaited(state="running", pattern="flocking"), {"r1", "r2", "r3"}),
    ],
)
def test_robots_that_do_not_meet_it_are_named(awaited: Awaited, lacking: set[str]) -> None:
    assert unmet(view_of(RUNNING, IDLE, FAILED), ALL, awaited).keys() == lacking


def test_a_robot_that_nobody_has_seen_is_waited_for() -> None:
    assert unmet(view_of(RUNNING), ("r1", "r9"), Awaited(presence="alive")).keys() == {"r9"}
    assert unmet(view_of(), (), Awaited(state="running"))


def test_robots_that_are_not_alive_do_not_hold_the_others_back() -> None:
    """r3 has failed, and r4 of the roster was never heard."""
    names = (*ALL, "r4")
    awaited = read_awaited(["state=idle", "count=alive"])
    assert unmet(view_of(RUNNING, IDLE, FAILED), names, awaited).keys() == {"", "r1", "r3", "r4"}
    rested = view_of(make_member("r1", state=State.IDLE, pattern=None), IDLE, FAILED)
    assert unmet(rested, names, awaited) == {}
    assert meeting(rested, names, awaited) == ("r1", "r2")
    assert unmet(view_of(), names, awaited)[""] == "0 of 1 robot"
    assert unmet(view_of(FAILED), ("r3",), awaited), "no robot is alive"


def test_a_count_is_met_by_some() -> None:
    view = view_of(RUNNING, IDLE, FAILED)
    assert unmet(view, ALL, Awaited(count=2)) == {}
    assert unmet(view, ALL, Awaited(count=3))[""] == "2 of 3 robots"
    assert unmet(view, ALL, Awaited(state="running", count=1)) == {}
    assert unmet(view, ALL, Awaited(state="running", count=2)).keys() == {"", "r2", "r3"}


def test_a_goal_is_met_as_it_is_desired() -> None:
    goal = make_goal(3)
    there = member_with("r1", goal_status(goal))
    offered = member_with(
        "r2", goal_status(goal, state=GoalState.OFFERED, reason="offered"), state=State.IDLE
    )
    assert unmet(view_of(there), ("r1",), Awaited(goal=True)) == {}
    assert unmet(view_of(there, offered), ("r1", "r2"), Awaited(goal=True)) == {"r2": "offered"}


def test_with_a_number_only_the_robots_that_meet_it_are_told() -> None:
    awaited = Awaited(state="running", count=1)
    assert unmet(view_of(RUNNING, IDLE, FAILED), ALL, awaited) == {}
    assert meeting(view_of(RUNNING, IDLE, FAILED), ALL, awaited) == ("r1",)

"""What a robot records of a peer that has failed: its last beacon, and the link to it."""

from __future__ import annotations

import pytest

from swarmd.core.goal import Goal, HeldGoal
from swarmd.core.messages import Body, State
from swarmd.core.record import RecordKind
from swarmd.daemon.recording.lost_member import LostMember
from swarmd.link.datagram import STATES, Beacon, BodyReport
from swarmd.link.members.link_quality import LinkQuality

GOAL = HeldGoal.of(Goal(generation=3, issuer="anna", targets=("*",), id="g", pattern="drive"), 1.0)
OTHER = HeldGoal.of(Goal(generation=4, issuer="anna", targets=("*",), id="h", pattern="drive"), 1.0)
LINK = LinkQuality(received=25, lost=7, age=5.0, round_trip=0.0031)


def beacon(state: int = STATES.index(State.RUNNING), goal: bytes = GOAL.digest) -> Beacon:
    digests = tuple(goal if kind is RecordKind.GOAL else b"" for kind in RecordKind)
    body = BodyReport.of(Body(platform="burger", surface_speed=0.3, radius=0.1))
    return Beacon(
        robot="b", instance=b"123456", sequence=1, wire=1, state=state, revision=7,
        digests=digests, body=body,
    )  # fmt: skip


def test_a_member_is_told_with_its_state_its_link_and_its_goal() -> None:
    member = LostMember.of(beacon(), LINK, GOAL)
    assert member == LostMember(
        robot="b", state="running", platform="burger", age=5.0, received=25, lost=7,
        round_trip=0.0031, goal=GOAL.goal.text,
    )  # fmt: skip


@pytest.mark.parametrize("held", [None, OTHER])
def test_a_goal_that_is_not_known_here_is_not_claimed(held: HeldGoal | None) -> None:
    """A beacon has the digest of a goal alone."""
    assert LostMember.of(beacon(), LINK, held).goal == ""


def test_a_state_of_a_later_version_and_a_link_that_is_not_known_are_said_so() -> None:
    member = LostMember.of(beacon(state=200), None, GOAL)
    assert (member.state, member.age, member.received) == ("unknown", None, 0)

"""A roster on its way ends a hand, as it ends a run: it may revoke the key that drives."""

from __future__ import annotations

from swarmd.core.events import RosterInput
from swarmd.core.messages import Reason, State
from tests.robot.test_hand import driven, standing, still
from tests.support.hand import BACK, HandOn
from tests.support.robot_harness import RobotHarness

ROSTER = RosterInput("generation 3 of the roster", False)


def drives_no_more(harness: RobotHarness, hand: HandOn) -> None:
    """No word of the hand moves the robot."""
    assert not harness.status.driven_by
    for _ in range(5):
        hand.word(BACK)
        assert still(harness, 0.1)


def test_a_new_roster_ends_a_hand() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(0.5, BACK)
    assert harness.twist == BACK
    harness.step(ROSTER)
    drives_no_more(harness, hand)


def test_a_new_roster_ends_a_hand_and_the_run_beneath() -> None:
    harness, hand = driven()
    harness.step(ROSTER)
    status = harness.status
    assert (status.state, status.reason) == (State.STOPPED, Reason.ROSTER_CHANGED)
    drives_no_more(harness, hand)

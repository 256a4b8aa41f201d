"""What a robot tells of faults that only peers can name: in its status, its log and its memory."""

from __future__ import annotations

from swarmd.core.events import PeerFaultsInput
from swarmd.core.messages import PeerFault
from swarmd.robot.memory import recall, remember
from tests.support.robot_harness import RobotHarness

MUTE = PeerFault(robot="r2", kind="mute", by=3, of=4, since=6.0)
SUSPECTED = PeerFault(robot="r3", kind="unheard", by=0, of=3, since=5.0)


def test_a_fault_is_in_the_status_ages_and_is_logged_once() -> None:
    harness = RobotHarness()
    harness.step(PeerFaultsInput((MUTE,)))
    harness.now += 2.0
    harness.step(PeerFaultsInput((MUTE, SUSPECTED)))
    harness.now += 1.5
    status = harness.robot.status(harness.now)
    assert [(one.robot, one.kind, one.since) for one in status.peer_faults] == [
        ("r2", "mute", 7.5),
        ("r3", "unheard", 6.5),
    ]
    assert [event.text for event in status.events if "r2" in event.text] == [
        f"peer r2: {MUTE.text}"
    ]
    assert not any("r3" in event.text for event in status.events)  # it suspects, and knows nothing


def test_a_recalled_robot_knows_them() -> None:
    harness = RobotHarness()
    harness.step(PeerFaultsInput((MUTE,)))
    robot = harness.robot
    other = recall(remember(robot), robot.identity.setup)
    assert other.status(harness.now).peer_faults == (MUTE,)


def test_no_motion_depends_on_them() -> None:
    harness = RobotHarness()
    assert harness.robot.step(PeerFaultsInput((MUTE,)), harness.now) is None

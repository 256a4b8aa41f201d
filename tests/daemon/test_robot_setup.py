"""The head of a recording: the state of the robot from which a replay continues."""

from __future__ import annotations

from swarmd.daemon.recording.head import head_of
from swarmd.daemon.robot_setup import recording_head
from swarmd.patterns.drive.pattern import Drive
from tests.support.robot_harness import RobotHarness


def test_a_head_holds_what_the_robot_is_made_of_and_what_happened_to_it_before() -> None:
    harness = RobotHarness("burger", {"drive": Drive})
    harness.advance(1.0)
    harness.applied("estop", id="first")
    harness.applied("reset", ids=("first",))
    harness.applied("run", pattern="drive")
    harness.advance(1.0)
    harness.applied("estop", id="second", reason="a chair")
    harness.advance(2.0)
    head = head_of(recording_head(harness.robot, "s", harness.now).texts(), "here")
    identity, earlier = head.identity, head.earlier
    assert (head.swarm, identity.robot, identity.platform.name) == ("s", "tb3-01", "burger")
    assert (identity.seed, identity.instance, identity.setup.driver) == (1, "boot1", "story")
    assert identity.setup == harness.robot.identity.setup
    assert earlier.latches is not None
    assert {name: one.reason for name, one in earlier.latches.held.items()} == {"second": "a chair"}
    age = earlier.latches.held["second"].age
    assert age is not None
    assert abs(age - 2.0) < 1e-6
    assert earlier.latches.cleared == ("first",)
    assert (earlier.revision, earlier.generation) == (harness.epoch.revision, 1)
    assert earlier.goals == harness.robot.goals

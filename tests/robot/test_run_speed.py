"""A run with a greatest speed keeps it, whatever the pattern asks and whoever changes the run."""

from __future__ import annotations

from swarmd.core.messages import State
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, Raiser


def fastest(harness: RobotHarness, seconds: float = 1.0) -> float:
    """The greatest speed in m/s that the base is commanded in the next `seconds`."""
    begin = len(harness.commands)
    harness.advance(seconds)
    return max(abs(twist.linear) for _, twist in harness.commands[begin:])


def running(speed: float | None = 0.1) -> RobotHarness:
    harness = RobotHarness("waffle_pi", {**PATTERNS, "forward": Forward, "raises": Raiser})
    harness.advance(1.0)
    harness.applied("run", pattern="forward", speed=speed)
    harness.advance(1.0)
    return harness


def test_a_run_is_as_fast_as_its_pattern_asks_without_a_bound_and_with_one_at_most_that() -> None:
    assert fastest(running(None)) == 0.2
    harness = running()
    assert fastest(harness) == 0.1
    assert (harness.robot.running_pattern, harness.robot.running_speed) == ("forward", 0.1)


def test_a_robot_that_is_slow_by_its_bound_is_neither_blocked_nor_limited_by_protection() -> None:
    harness = running(0.02)
    harness.advance(10.0)
    decision = harness.robot.decision
    assert (decision.requested.linear, decision.safe.linear) == (0.02, 0.02)
    assert not decision.is_active
    assert not decision.is_recovering


def test_parameters_do_not_raise_it() -> None:
    harness = running()
    harness.applied("param", params={"speed": 0.25})
    assert fastest(harness) == 0.1
    assert harness.robot.running_speed == 0.1


def test_new_code_of_the_run_keeps_it() -> None:
    harness = running()
    harness.applied("reload", pattern="forward", is_rerun=True)
    assert fastest(harness) == 0.1


def test_a_restart_after_a_fault_keeps_it() -> None:
    harness = running()
    harness.applied("run", pattern="raises", speed=0.05)
    before = harness.robot.generation
    while harness.robot.generation == before:
        harness.advance(0.5)
    assert harness.robot.state is State.RUNNING
    assert harness.robot.running_speed == 0.05
    assert fastest(harness) == 0.05


def test_the_next_run_has_its_own() -> None:
    harness = running()
    harness.applied("run", pattern="forward")
    assert harness.robot.running_speed is None
    assert fastest(harness) == 0.2

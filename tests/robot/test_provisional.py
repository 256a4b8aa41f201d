"""A robot that runs provisional code: the first fault ends the run, and only that of this code."""

from __future__ import annotations

from swarmd.api import Twist
from swarmd.core.events import CodeInput
from swarmd.core.host_messages import CancelTrial, KillHost, Load
from swarmd.core.messages import Reason, State
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, Raiser, standing_state


def running(pattern: str, *, is_provisional: bool) -> RobotHarness:
    harness = RobotHarness(
        patterns={**PATTERNS, "own": Forward, "raises": Raiser},
        is_provisional=lambda generation: is_provisional,
    )
    harness.advance(1.0)
    harness.ask("run", pattern=pattern)
    return harness


def test_the_first_fault_of_provisional_code_ends_the_run() -> None:
    harness = running("raises", is_provisional=True)
    harness.advance(1.0)
    assert standing_state(harness) == (State.FAULTED, Reason.QUARANTINED)
    (failed,) = harness.failed_code
    assert failed.generation == harness.robot.generation
    assert "on purpose" in failed.text
    harness.sent.clear()
    harness.advance(5.0)
    assert not any(isinstance(command, Load) for command in harness.sent)
    assert harness.twist.is_zero


def test_other_code_is_restarted_with_what_it_ran() -> None:
    harness = running("raises", is_provisional=False)
    harness.sent.clear()
    harness.advance(1.0)
    loads = [command for command in harness.sent if isinstance(command, Load)]
    assert loads
    assert all(load.is_restart for load in loads)
    assert harness.failed_code == []


def test_a_push_lets_the_running_pattern_go_on() -> None:
    harness = running("own", is_provisional=False)
    harness.advance(0.5)
    harness.sent.clear()
    reply = harness.applied("reload", pattern="own", keeps_running=True)
    assert "goes on with the old code" in reply.text
    assert not any(isinstance(command, KillHost | Load) for command in harness.sent)
    assert isinstance(harness.sent[-1], CancelTrial)
    harness.advance(1.0)
    assert harness.twist == Twist(0.2)
    harness.ask("run", pattern="own")
    (load,) = (command for command in harness.sent if isinstance(command, Load))
    assert (load.is_fresh, load.is_restart) == (True, False)


def test_code_that_was_removed_lets_the_running_pattern_go_on() -> None:
    harness = running("own", is_provisional=False)
    harness.advance(0.5)
    harness.sent.clear()
    harness.step(CodeInput())
    harness.advance(1.0)
    assert harness.twist == Twist(0.2)
    assert not any(isinstance(command, KillHost) for command in harness.sent)
    harness.ask("stop")
    harness.sent.clear()
    harness.step(CodeInput())
    assert [type(command) for command in harness.sent] == [KillHost]

"""Regressions of faulty hosts and late loops, in simulated time."""

from __future__ import annotations

import pytest

from swarmd.api import Inputs, Outputs, Twist
from swarmd.core.events import TICK_INPUT
from swarmd.core.host_messages import KillHost, Load, Loaded, Stepped
from swarmd.core.messages import Code, Reason, State
from swarmd.core.refusal import Refusal
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, standing_state, started

BACK = {"speed": -0.1}


@pytest.mark.parametrize("is_stopped_first", [True, False])
def test_run_while_the_host_hangs_loads_in_a_fresh_host(is_stopped_first: bool) -> None:
    harness = started()
    harness.is_hung = True
    harness.advance(0.5)
    if is_stopped_first:
        harness.ask("stop")
    run = harness.request("run", pattern="forward", params=BACK)
    assert harness.send(run) is None
    harness.sent.clear()
    harness.is_hung = False  # the new host will answer; the old one never got the load
    harness.advance(1.0)
    assert harness.reply_to(run).code is Code.APPLIED
    loads = [command for command in harness.sent if isinstance(command, Load)]
    assert [load.is_fresh for load in loads] == [True]
    assert not any(isinstance(command, KillHost) for command in harness.sent)
    assert harness.twist == Twist(-0.1)


def test_load_in_a_silent_host_fails_after_3_s() -> None:
    harness = started()
    harness.is_hung = True
    harness.advance(0.5)
    run = harness.request("run", pattern="forward", params=BACK)
    harness.send(run)
    harness.advance(3.3)
    assert not harness.is_answered(run)
    harness.advance(0.5)
    answer = harness.reply_to(run)
    assert (answer.code, answer.refusal) == (Code.FAILED, Refusal.PATTERN_FAILED)
    assert standing_state(harness) == (State.STOPPED, Reason.LOAD_FAILED)


def test_command_is_zero_during_a_slow_load_until_the_next_run() -> None:
    harness = started()
    harness.is_hung = True
    run = harness.request("run", pattern="forward", params=BACK)
    harness.send(run)
    harness.advance(2.9)
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.RUNNING, Reason.COMMAND_EXPIRED)
    assert not harness.is_answered(run)
    harness.host_says(Loaded(harness.status.generation, 10.0, frozenset(), {}))
    assert harness.reply_to(run).code is Code.APPLIED
    assert standing_state(harness)[0] is State.RUNNING


def test_stale_scans_during_a_load_end_the_run_before_it_alone() -> None:
    harness = started()
    harness.is_hung = True
    harness.scans = lambda seq, now: None
    run = harness.request("run", pattern="forward", params=BACK)
    harness.send(run)
    harness.advance(2.9)
    assert standing_state(harness) == (State.STOPPED, Reason.STALE_SCAN)
    assert not harness.is_answered(run)
    harness.host_says(Loaded(harness.status.generation, 10.0, frozenset(), {}))
    assert harness.reply_to(run).code is Code.APPLIED
    harness.advance(0.1)
    assert standing_state(harness) == (State.RUNNING, Reason.STALE_SCAN)
    assert harness.twist.is_zero


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_param_request_overtaken_by_a_stop_is_answered(verb: str) -> None:
    harness = started()
    harness.is_hung = True
    change = harness.request("param", params={"speed": "0.1"})
    assert harness.send(change) is None
    harness.ask(verb)
    assert harness.reply_to(change).refusal is Refusal.OVERTAKEN


def test_param_request_that_the_pattern_does_not_answer_fails_after_3_s() -> None:
    harness = started()
    change = harness.request("param", params={"speed": "0.1"})
    harness.is_hung = True
    harness.send(change)
    harness.is_hung = False  # the pattern goes on, but the change is lost
    harness.advance(2.9)
    assert not harness.is_answered(change)
    harness.advance(0.2)
    reply = harness.reply_to(change)
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.PATTERN_FAILED)


@pytest.mark.parametrize(
    ("late", "state"),
    [(0.99, (State.RUNNING, None)), (1.0 + 1e-6, (State.STOPPED, Reason.LOOP_STALLED))],
)
def test_loop_over_1_s_late_is_stalled(late: float, state: tuple[State, Reason | None]) -> None:
    harness = started()
    harness.advance(late, ticks=False)
    harness.step(TICK_INPUT)
    assert harness.status.state is state[0]
    assert state[1] is None or standing_state(harness) == state
    assert harness.twist.is_zero or state[0] is State.RUNNING


def test_a_stall_ends_a_run_that_waits_for_its_start() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(0.5)
    harness.ask("run", pattern="forward", at={harness.robot.id: harness.now + 5.0})
    harness.advance(1.0)
    assert harness.status.state is State.IDLE
    harness.advance(1.5, ticks=False)
    harness.advance(8.0)
    assert standing_state(harness) == (State.STOPPED, Reason.LOOP_STALLED)


def test_a_stall_leaves_an_idle_robot_idle_and_is_an_event() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(0.5)
    looked = harness.status.epoch
    harness.advance(1.5, ticks=False)
    harness.step(TICK_INPUT)
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)
    assert harness.status.events[-1].text == "the daemon did not run for 1.5 s"
    assert harness.refused("run", pattern="forward", epoch=looked).refusal is Refusal.STALE_EPOCH
    harness.ask("run", pattern="forward")
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_what_an_earlier_load_or_run_says_late_starts_nothing_and_moves_nothing() -> None:
    """Rule `late`: no late report of the pattern host starts motion (docs/evidence/motion.md)."""
    harness = started()
    earlier = harness.status.generation
    harness.is_hung = True
    harness.ask("stop")
    harness.send(harness.request("run", pattern="forward", params=BACK))
    loading = harness.sent[-1]
    assert isinstance(loading, Load)
    assert loading.generation != earlier
    harness.host_says(Loaded(earlier, 10.0, frozenset(), {}))
    harness.advance(0.2)
    assert (harness.status.state, harness.twist) == (State.STOPPED, Twist())
    harness.host_says(Loaded(loading.generation, 10.0, frozenset(), {}))
    harness.host_says(Stepped(earlier, Outputs(Twist(0.2)), 1))
    harness.advance(0.1)
    assert (harness.status.state, harness.twist) == (State.RUNNING, Twist())
    harness.host_says(Stepped(loading.generation, Outputs(Twist(-0.1)), 1))
    harness.advance(0.05)
    assert harness.twist == Twist(-0.1)


def test_a_restart_after_a_failure_gives_a_run_no_more_time() -> None:
    class FailsOnce(Forward):
        steps = 0

        def drive(self, inputs: Inputs) -> Twist:
            FailsOnce.steps += 1
            if FailsOnce.steps == 5:
                raise ZeroDivisionError("on purpose")
            return super().drive(inputs)

    harness = RobotHarness(patterns={"own": FailsOnce})
    harness.advance(1.0)
    harness.ask("run", pattern="own", seconds=10.0)
    harness.advance(9.5)
    assert harness.twist == Twist(0.2)
    assert harness.status.state is State.RUNNING
    harness.advance(1.0)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    assert FailsOnce.steps > 5

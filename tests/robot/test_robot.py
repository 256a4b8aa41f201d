"""One robot and its pattern, in simulated time."""

from __future__ import annotations

from itertools import pairwise

import pytest

from swarmd.api import Inputs, MovementPattern, Outputs, Params, Twist
from swarmd.core.clock import TICK
from swarmd.core.codec import Decoder, encode
from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    DuplicateInput,
    MessageInput,
    NeighborsInput,
)
from swarmd.core.host_messages import HostDied, KillHost, Load, Loaded, Step, Stepped
from swarmd.core.messages import Code, Reason, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.values import ZERO, Neighbor, Scalar
from swarmd.pattern_host.wire import MAX_FRAME, encode_command
from tests.support.robot_harness import RobotHarness, acted
from tests.support.stub_patterns import PATTERNS, idle, standing_state, started


def test_never_moves_before_a_run() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(3.0)
    assert all(twist.is_zero for _, twist in harness.commands)
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)


def test_runs_the_requested_command_within_limits() -> None:
    harness = started(speed=1.0)
    assert harness.twist == Twist(harness.platform.limits.linear)
    assert standing_state(harness) == (State.RUNNING, None)


def test_stop_zeroes_at_once_until_the_next_run() -> None:
    harness = started()
    harness.applied("stop")
    assert harness.twist.is_zero
    harness.commands.clear()
    harness.advance(3.0)
    assert all(twist.is_zero for _, twist in harness.commands)
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)
    harness.applied("run", pattern="forward")
    harness.advance(0.2)
    assert harness.twist.linear > 0.0


@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize("stall", [0.0, 0.5])
def test_zero_comes_with_the_ack_of_a_stop_and_no_later_command_moves(
    verb: str, stall: float
) -> None:
    harness = started()
    harness.advance(stall, ticks=False)  # the stop is the first input after a stall
    assert harness.twist.linear > 0.0
    harness.commands.clear()
    harness.applied(verb)
    assert harness.commands == [(harness.now, ZERO)]
    harness.advance(5.0)
    assert all(twist.is_zero for _, twist in harness.commands)


@pytest.mark.parametrize("stall", [0.0, 0.2, 0.25, 0.5, 0.9])
def test_a_driving_robot_commands_zero_once_after_a_stall_and_else_never(stall: float) -> None:
    """The requested command has expired after 0.25 s; the pattern answers at once."""
    harness = started()
    harness.advance(stall, ticks=False)
    thawed = harness.now
    harness.commands.clear()
    harness.advance(60.0)
    zeros = {at for at, twist in harness.commands if twist.is_zero}
    assert zeros == ({round(thawed + TICK, 9)} if stall >= 0.25 else set())


def test_repeated_stop_is_one_change() -> None:
    harness = started()
    stop = harness.request("stop")
    first, again = harness.send(stop), harness.send(stop)
    assert first is not None
    assert again is not None
    assert (again.code, again.epoch) == (Code.APPLIED, first.epoch)
    harness.ask("run", pattern="forward")
    harness.advance(0.2)
    assert harness.answer(stop).refusal is Refusal.OVERTAKEN  # a copy from before the run
    last = harness.answer(harness.request("stop"))
    assert last.epoch != first.epoch
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize("rate", [8.0, 10.0])
def test_requested_command_expires_after_three_steps(rate: float) -> None:
    """At 8 Hz the deadline lies between two ticks."""
    paced = type("Paced", (PATTERNS["forward"],), {"rate": rate})
    harness = RobotHarness(patterns={"paced": paced})
    harness.advance(1.0)
    harness.applied("run", pattern="paced")
    harness.advance(0.5)
    harness.is_hung = True
    harness.commands.clear()
    harness.advance(0.6)
    steps = [command.inputs.now for command in harness.sent if isinstance(command, Step)]
    zero_at = next(at for at, twist in harness.commands if twist.is_zero)
    assert zero_at == pytest.approx(steps[-2] + 3.0 / rate, abs=1e-6)  # the last has no answer
    assert not any(twist.linear for at, twist in harness.commands if at >= zero_at)
    assert harness.status.reason is Reason.COMMAND_EXPIRED


def test_silent_host_is_killed_after_1_s_and_its_pattern_restarts() -> None:
    harness = started()
    begin = harness.now
    harness.is_hung = True
    harness.sent.clear()
    harness.advance(1.15)
    assert any(isinstance(command, KillHost) for command in harness.sent)
    assert standing_state(harness) == (State.RUNNING, Reason.PATTERN_RESTARTING)
    harness.is_hung = False
    harness.advance(0.3)
    assert harness.twist == Twist(0.2)
    assert harness.status.health.host_restarts == 1
    assert harness.now - begin < 2.0


def test_failed_restart_stops_the_robot_after_2_s() -> None:
    harness = started()
    harness.is_hung = True
    harness.advance(2.9)
    assert standing_state(harness) == (State.RUNNING, Reason.PATTERN_RESTARTING)
    harness.advance(0.3)
    assert standing_state(harness) == (State.STOPPED, Reason.PATTERN_RESTARTING)
    harness.is_hung = False
    harness.advance(2.0)
    assert harness.twist.is_zero


def test_pattern_that_keeps_raising_is_quarantined() -> None:
    harness = started("raiser")
    harness.advance(5.0)
    assert standing_state(harness) == (State.FAULTED, Reason.QUARANTINED)
    assert "on purpose" in harness.status.detail
    loads = [command for command in harness.sent if isinstance(command, Load)]
    assert len(loads) == 4
    assert harness.twist.is_zero
    assert harness.refused("run", pattern="forward").refusal is Refusal.FAULTED
    harness.applied("reset")
    assert standing_state(harness) == (State.IDLE, Reason.RESET)


def test_dead_host_zeroes_at_once_and_is_replaced() -> None:
    harness = started()
    harness.host_says(HostDied(harness.status.generation, "was killed by SIGKILL"))
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.PATTERN_RESTARTING
    harness.advance(0.5)
    assert harness.twist == Twist(0.2)


def test_non_finite_command_is_a_fault() -> None:
    harness = idle()
    harness.ask("run", pattern="not_finite")
    harness.advance(0.1)
    assert harness.twist.is_zero
    harness.advance(3.0)
    assert standing_state(harness) == (State.FAULTED, Reason.QUARANTINED)


def test_finished_pattern_leaves_the_robot_idle() -> None:
    harness = started("finisher")
    harness.advance(1.0)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    assert harness.status.detail == "arrived"
    assert harness.twist.is_zero


def test_restart_does_not_extend_the_seconds_of_a_run() -> None:
    class Early(MovementPattern[Params]):
        params_type = Params

        def drive(self, inputs: Inputs) -> Twist:
            if inputs.now < 1001.2:
                raise RuntimeError("not yet")
            return Twist(0.1)

    harness = RobotHarness(patterns={"early": Early})
    harness.advance(1.0)
    harness.ask("run", pattern="early", seconds=2.0)
    harness.advance(1.5)
    assert harness.twist == Twist(0.1)
    harness.advance(0.6)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)


def test_actions_hold_the_scan_behind_the_command() -> None:
    harness = started()
    harness.is_hung = True
    harness.advance(0.25)
    actions = acted(harness.robot, TICK_INPUT, harness.now)
    assert 0 <= actions.requested_scan_seq < actions.decision.scan_seq


def test_actions_are_idle_before_a_run_while_the_base_is_there() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    assert acted(harness.robot, TICK_INPUT, harness.now).is_idle
    assert not acted(harness.robot, DriverInput(False, "gone"), harness.now).is_idle
    running = started()
    assert not acted(running.robot, TICK_INPUT, running.now).is_idle


def test_each_tick_of_a_robot_that_must_stand_is_marked() -> None:
    harness = started()
    assert not acted(harness.robot, TICK_INPUT, harness.now).is_stopped
    harness.ask("stop")
    harness.step(DriverInput(False, "someone else drives"))
    for _ in range(40):  # 2 s at 20 Hz
        harness.advance(0.05)
        actions = acted(harness.robot, TICK_INPUT, harness.now)
        assert (actions.is_stopped, actions.twist) == (True, ZERO)
        assert not actions.is_idle
    harness.ask("estop", id="e1")
    assert acted(harness.robot, TICK_INPUT, harness.now).is_stopped
    harness.ask("reset", ids=("e1",))
    assert not acted(harness.robot, TICK_INPUT, harness.now).is_stopped
    harness.step(DuplicateInput("instance b"))
    assert acted(harness.robot, TICK_INPUT, harness.now).is_stopped


def test_hold_of_the_driver_zeroes_and_ends_the_run() -> None:
    harness = started()
    hold = Reason.SCAN_CONFLICT
    harness.step(DriverInput(True, "two publish /scan", hold=hold))
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.RUNNING, hold)
    harness.step(DriverInput(True, "there"))
    harness.advance(0.2)
    assert harness.twist == Twist(0.2)
    harness.step(DriverInput(True, "two publish /scan", hold=hold))
    harness.advance(2.1)
    assert standing_state(harness) == (State.STOPPED, hold)


def test_pattern_steps_at_its_rate_and_on_every_new_scan() -> None:
    harness = started()
    harness.sent.clear()
    begin = harness.now
    harness.advance(4.0)
    steps = [command.inputs for command in harness.sent if isinstance(command, Step)]
    assert sum(inputs.is_new_scan for inputs in steps) == 20
    times = [inputs.now for inputs in steps]
    assert max(b - a for a, b in pairwise([begin, *times])) <= 0.1 + 1e-6


def test_messages_arrive_from_neighbours_on_declared_channels() -> None:
    harness = started("listener")
    harness.robot.step(NeighborsInput((Neighbor("tb3-02", 0.0),)), harness.now)
    harness.step(MessageInput("tb3-02", "listener/count", 7))
    harness.step(MessageInput("tb3-02", "listener/count", "seven"))
    harness.step(MessageInput("tb3-02", "other/count", 8))
    harness.step(MessageInput("tb3-03", "listener/count", 9))
    harness.advance(0.2)
    assert harness.status.report["heard"] == "(('tb3-02', 7),)"


def test_messages_to_an_earlier_run_are_dropped() -> None:
    harness = started("listener")
    harness.robot.step(NeighborsInput((Neighbor("tb3-02", 0.0),)), harness.now)
    harness.step(MessageInput("tb3-02", "listener/count", 7))
    harness.ask("run", pattern="listener")
    harness.advance(0.5)
    assert harness.status.report["heard"] == "()"


def test_outgoing_messages_are_limited_per_channel() -> None:
    harness = started("listener")
    harness.messages.clear()
    for n in range(400):
        harness.now += 0.001
        generation = harness.status.generation
        harness.host_says(Stepped(generation, Outputs(messages={"count": n, "other": n}), -1))
    names = {name for name, _ in harness.messages}
    assert names == {"listener/count"}
    assert len(harness.messages) <= 5 + 0.4 * 20 + 1


def test_age_of_a_late_step_counts_from_its_start() -> None:
    harness = started(speed=0.1)
    harness.is_hung = True
    harness.advance(0.15)
    generation = harness.status.generation
    harness.advance(0.8)
    harness.host_says(Stepped(generation, Outputs(Twist(0.1)), 1))
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.COMMAND_EXPIRED


def test_load_outlives_the_end_of_the_run_before() -> None:
    harness = idle()
    harness.ask("run", pattern="forward", seconds=0.5)
    harness.advance(0.2)
    harness.is_hung = True
    run = harness.request("run", pattern="finisher")
    assert harness.send(run) is None
    harness.advance(0.5)
    assert harness.status.reason is Reason.FINISHED
    harness.host_says(Loaded(2, 10.0, frozenset(), {}))
    assert harness.reply_to(run).code is Code.APPLIED
    assert harness.status.pattern == "finisher"


@pytest.mark.parametrize("rate", [8.0, 10.0, 30.0, 50.0])
def test_every_rate_is_kept_without_scans(rate: float) -> None:
    harness = RobotHarness(
        patterns={"paced": type("Paced", (PATTERNS["listener"],), {"rate": rate})}
    )
    harness.advance(1.0)
    harness.ask("run", pattern="paced")
    harness.sent.clear()
    harness.scans = lambda seq, now: None
    harness.advance(0.5)
    steps = sum(isinstance(command, Step) for command in harness.sent)
    assert steps == pytest.approx(0.5 * rate, abs=1.01)


def test_any_report_gives_a_readable_status() -> None:
    harness = started()
    report: dict[str, Scalar] = {
        "a": 1e305,
        "b": float("nan"),
        "c": 2**60,
        "d": "x" * 999,
        "e" * 99: 1,
        "f": True,
    }
    generation = harness.status.generation
    harness.host_says(Stepped(generation, Outputs(Twist(0.1), report=report), 1))
    read = Decoder(Status)(encode(harness.status))
    assert read.report == {"d": "x" * 256, "e" * 64: 1, "f": True}


def test_flood_of_messages_keeps_the_newest_and_is_counted() -> None:
    harness = started("listener")
    harness.robot.step(NeighborsInput((Neighbor("tb3-02", 0.0),)), harness.now)
    harness.sent.clear()
    for n in range(1000):
        harness.robot.step(MessageInput("tb3-02", "listener/count", [n, "x" * 900]), harness.now)
    harness.advance(0.1)
    step = next(command for command in harness.sent if isinstance(command, Step))
    assert len(encode_command(step)) < MAX_FRAME
    assert step.inputs.messages[-1].value[0] == 999  # type: ignore[index]  # as sent above
    dropped = harness.status.health.dropped
    assert dropped["msg:inbox_full"] + len(step.inputs.messages) == 1000
    assert dropped["msg:wrong_type"] == len(step.inputs.messages)

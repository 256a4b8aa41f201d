"""One robot and its pattern, told in simulated time."""

from __future__ import annotations

from itertools import pairwise

import pytest

from swarmd.api import Inputs, MovementPattern, Outputs, Params, Twist
from swarmd.core.codec import Decoder, encode
from swarmd.core.host_messages import HostDied, KillHost, Load, Loaded, Step, Stepped
from swarmd.core.messages import Code, Reason, State, Status
from swarmd.core.values import Neighbor, Scalar
from swarmd.pattern_host.wire import MAX_FRAME, encode_command
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state, started


def test_never_moves_before_it_is_asked() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(3.0)
    assert all(twist.is_zero for _, twist in story.commands)
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_drives_what_the_pattern_wishes_within_limits() -> None:
    story = started(speed=1.0)
    assert story.twist == Twist(story.platform.limits.linear)
    assert standing_state(story) == (State.RUNNING, None)


def test_a_refused_run_leaves_the_running_pattern_alone() -> None:
    story = started(speed=0.1)
    reply = story.ask("run", pattern="forward", params={"sped": 0.2})
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert "did you mean 'speed'" in reply.text
    story.advance(1.0)
    assert story.twist == Twist(0.1)
    assert story.status.pattern == "forward"


def test_stop_zeroes_at_once_and_needs_a_run() -> None:
    story = started()
    reply = story.ask("stop")
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert story.twist.is_zero
    story.commands.clear()
    story.advance(3.0)
    assert all(twist.is_zero for _, twist in story.commands)
    assert standing_state(story) == (State.STOPPED, Reason.OPERATOR)
    assert story.ask("run", pattern="forward") is not None
    story.advance(0.2)
    assert story.twist.linear > 0.0


def test_a_repeated_stop_is_one_change_and_stops_all_the_same() -> None:
    story = started()
    stop = story.request("stop")
    first, again = story.send(stop), story.send(stop)
    assert first is not None
    assert again is not None
    assert (again.code, again.epoch) == (Code.APPLIED, first.epoch)
    story.ask("run", pattern="forward")
    story.advance(0.2)
    last = story.send(stop)
    assert last is not None
    assert last.epoch != first.epoch
    assert story.twist.is_zero
    assert standing_state(story) == (State.STOPPED, Reason.OPERATOR)


def test_a_wish_expires_after_three_steps_and_not_a_tick_later() -> None:
    story = started()
    last = story.now
    story.is_hung = True
    story.commands.clear()
    story.advance(0.6)
    zero_at = next(at for at, twist in story.commands if twist.is_zero)
    last_wish = max(at for at, twist in story.commands if not twist.is_zero)
    assert zero_at == pytest.approx(last + 0.3, abs=0.051)
    assert zero_at - last <= 0.3 + 1e-9
    assert last_wish < zero_at
    assert story.status.reason is Reason.COMMAND_EXPIRED


def test_a_silent_host_is_killed_after_a_second_and_its_pattern_reloaded() -> None:
    story = started()
    begin = story.now
    story.is_hung = True
    story.sent.clear()
    story.advance(1.15)
    assert any(isinstance(command, KillHost) for command in story.sent)
    assert standing_state(story) == (State.RUNNING, Reason.PATTERN_RESTARTING)
    story.is_hung = False
    story.advance(0.3)
    assert story.twist == Twist(0.2)
    assert story.status.health.host_restarts == 1
    assert story.now - begin < 2.0


def test_a_pattern_that_never_comes_back_stops_the_robot_after_two_seconds() -> None:
    story = started()
    story.is_hung = True
    story.advance(2.9)
    assert standing_state(story) == (State.RUNNING, Reason.PATTERN_RESTARTING)
    story.advance(0.3)
    assert standing_state(story) == (State.STOPPED, Reason.PATTERN_RESTARTING)
    story.is_hung = False
    story.advance(2.0)
    assert story.twist.is_zero


def test_a_pattern_that_keeps_raising_is_restarted_with_backoff_then_quarantined() -> None:
    story = started("raiser")
    story.advance(5.0)
    assert standing_state(story) == (State.FAULTED, Reason.QUARANTINED)
    assert "on purpose" in story.status.detail
    loads = [command for command in story.sent if isinstance(command, Load)]
    assert len(loads) == 4
    assert story.twist.is_zero
    refused = story.ask("run", pattern="forward")
    assert refused is not None
    assert refused.code is Code.REFUSED
    assert story.ask("reset") is not None
    assert standing_state(story) == (State.IDLE, Reason.RESET)


def test_a_raising_pattern_zeroes_with_the_very_event() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.ask("run", pattern="raiser")
    for _ in range(20):
        story.advance(0.05)
        if story.status.reason is Reason.PATTERN_RESTARTING:
            break
    assert story.twist.is_zero
    assert standing_state(story) == (State.RUNNING, Reason.PATTERN_RESTARTING)


def test_a_dead_host_zeroes_at_once_and_is_replaced() -> None:
    story = started()
    story.host_says(HostDied(story.status.generation, "was killed by SIGKILL"))
    assert story.twist.is_zero
    assert story.status.reason is Reason.PATTERN_RESTARTING
    story.advance(0.5)
    assert story.twist == Twist(0.2)


def test_a_wish_that_is_no_number_counts_as_a_fault() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.ask("run", pattern="not_finite")
    story.advance(0.1)
    assert story.twist.is_zero
    story.advance(3.0)
    assert standing_state(story) == (State.FAULTED, Reason.QUARANTINED)


def test_a_finished_pattern_leaves_the_robot_idle() -> None:
    story = started("finisher")
    story.advance(1.0)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)
    assert story.status.detail == "arrived"
    assert story.twist.is_zero


def test_a_run_with_a_duration_ends_when_it_is_over() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.ask("run", pattern="forward", seconds=1.0)
    story.advance(0.9)
    assert not story.twist.is_zero
    story.advance(0.15)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)


def test_a_pattern_that_failed_once_gets_no_more_time_than_it_was_given() -> None:
    class Early(MovementPattern[Params]):
        params_type = Params

        def drive(self, inputs: Inputs) -> Twist:
            if inputs.now < 1001.2:
                raise RuntimeError("not yet")
            return Twist(0.1)

    story = RobotHarness(patterns={"early": Early})
    story.advance(1.0)
    story.ask("run", pattern="early", seconds=2.0)
    story.advance(1.5)
    assert story.twist == Twist(0.1)
    story.advance(0.6)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)


def test_a_command_tells_which_scan_its_wish_rests_on() -> None:
    story = started()
    story.is_hung = True
    story.advance(0.25)
    actions = story.robot.tick(story.now)
    assert 0 <= actions.requested_scan_seq < actions.decision.scan_seq


def test_the_pattern_is_stepped_at_its_rate_and_on_every_new_scan() -> None:
    story = started()
    story.sent.clear()
    begin = story.now
    story.advance(4.0)
    steps = [command.inputs for command in story.sent if isinstance(command, Step)]
    assert sum(inputs.is_new_scan for inputs in steps) == 20
    times = [inputs.now for inputs in steps]
    assert max(b - a for a, b in pairwise([begin, *times])) <= 0.1 + 1e-6


def test_only_neighbours_are_heard_and_only_on_its_own_channels() -> None:
    story = started("listener")
    story.robot.on_neighbors((Neighbor("tb3-02", 0.0),), story.now)
    assert story.robot.on_message("tb3-02", "listener/count", 7, story.now)
    assert story.robot.on_message("tb3-02", "listener/count", "seven", story.now)
    assert story.robot.on_message("tb3-02", "other/count", 8, story.now)
    assert not story.robot.on_message("tb3-03", "listener/count", 9, story.now)
    story.advance(0.2)
    assert story.status.report["heard"] == "(('tb3-02', 7),)"


def test_what_was_said_to_an_earlier_run_is_not_heard_in_the_next() -> None:
    story = started("listener")
    story.robot.on_neighbors((Neighbor("tb3-02", 0.0),), story.now)
    assert story.robot.on_message("tb3-02", "listener/count", 7, story.now)
    story.ask("run", pattern="listener")
    story.advance(0.5)
    assert story.status.report["heard"] == "()"


def test_what_it_says_goes_out_on_declared_channels_at_most_twenty_times_a_second() -> None:
    story = started("listener")
    story.messages.clear()
    for n in range(400):
        story.now += 0.001
        generation = story.status.generation
        story.host_says(Stepped(generation, Outputs(messages={"count": n, "other": n}), -1))
    names = {name for name, _ in story.messages}
    assert names == {"listener/count"}
    assert len(story.messages) <= 5 + 0.4 * 20 + 1


def test_a_late_answer_counts_from_when_its_step_was_asked_for() -> None:
    story = started(speed=0.1)
    story.is_hung = True
    story.advance(0.15)
    generation = story.status.generation
    story.advance(0.8)
    story.host_says(Stepped(generation, Outputs(Twist(0.1)), 1))
    assert story.twist.is_zero
    assert story.status.reason is Reason.COMMAND_EXPIRED


def test_what_an_operator_asked_for_next_outlives_the_end_of_the_pattern_before() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.ask("run", pattern="forward", seconds=0.5)
    story.advance(0.2)
    story.is_hung = True
    run = story.request("run", pattern="finisher")
    assert story.send(run) is None
    story.advance(0.5)
    assert story.status.reason is Reason.FINISHED
    story.host_says(Loaded(2, 10.0, frozenset(), {}))
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is Code.APPLIED
    assert story.status.pattern == "finisher"


@pytest.mark.parametrize("rate", [8.0, 10.0, 30.0, 50.0])
def test_any_rate_is_kept_without_scans_too(rate: float) -> None:
    story = RobotHarness(patterns={"paced": type("Paced", (PATTERNS["listener"],), {"rate": rate})})
    story.advance(1.0)
    story.ask("run", pattern="paced")
    story.sent.clear()
    story.scans = lambda seq, now: None
    story.advance(0.5)
    steps = sum(isinstance(command, Step) for command in story.sent)
    assert steps == pytest.approx(0.5 * rate, abs=1.01)


def test_whatever_a_pattern_reports_its_status_can_be_read() -> None:
    story = started()
    report: dict[str, Scalar] = {
        "a": 1e305,
        "b": float("nan"),
        "c": 2**60,
        "d": "x" * 999,
        "e" * 99: 1,
        "f": True,
    }
    generation = story.status.generation
    story.host_says(Stepped(generation, Outputs(Twist(0.1), report=report), 1))
    read = Decoder(Status)(encode(story.status))
    assert read.report == {"d": "x" * 256, "e" * 64: 1, "f": True}


def test_a_flood_of_messages_keeps_the_newest_and_is_counted() -> None:
    story = started("listener")
    story.robot.on_neighbors((Neighbor("tb3-02", 0.0),), story.now)
    story.sent.clear()
    for n in range(1000):
        story.robot.on_message("tb3-02", "listener/count", [n, "x" * 900], story.now)
    story.advance(0.1)
    step = next(command for command in story.sent if isinstance(command, Step))
    assert len(encode_command(step)) < MAX_FRAME
    assert step.inputs.messages[-1].value[0] == 999  # type: ignore[index]  # as sent above
    dropped = story.status.health.dropped
    assert dropped["msg:inbox_full"] + len(step.inputs.messages) == 1000
    assert dropped["msg:wrong_type"] == len(step.inputs.messages)

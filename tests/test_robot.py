"""The life of one robot, told in simulated time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import pytest

from swarmd.api import Inputs, MovementPattern, Outputs, Params, Pattern, Scan, Twist, about
from swarmd.frames import Died, Kill, Load, Ready, Step, Stepped
from swarmd.messages import Code, Epoch, Latch, Reason, State
from swarmd.testing.story import Story, empty_scan
from swarmd.values import Neighbor


class SpeedParams(Params, frozen=True):
    speed: Annotated[float, about("forward", ge=-1.0, le=1.0, unit="m/s")] = 0.2


class Forward(MovementPattern[SpeedParams]):
    """Drives straight."""

    params_type = SpeedParams

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(self.params.speed)


class Raiser(Pattern[Params]):
    """Raises at every third step."""

    count = 0

    def step(self, inputs: Inputs) -> Outputs:
        self.count += 1
        if self.count % 3 == 0:
            raise ZeroDivisionError("on purpose")
        return Outputs(Twist(0.2))


class Finisher(Pattern[Params]):
    """Is done after the fifth step."""

    count = 0

    def step(self, inputs: Inputs) -> Outputs:
        self.count += 1
        return Outputs(Twist(0.1), done="arrived" if self.count == 5 else None)


class NotFinite(Pattern[Params]):
    """Wishes something that is no number."""

    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(Twist(float("nan")))


class Listener(Pattern[Params]):
    """Says and hears integers."""

    channels: Mapping[str, type] = {"count": int}
    heard: tuple[object, ...] = ()

    def step(self, inputs: Inputs) -> Outputs:
        self.heard += tuple((m.sender, m.value) for m in inputs.messages)
        return Outputs(messages={"count": 3, "other": 1}, report={"heard": str(self.heard)})


PATTERNS: dict[str, type[Pattern[Any]]] = {
    "forward": Forward,
    "raiser": Raiser,
    "finisher": Finisher,
    "not_finite": NotFinite,
    "listener": Listener,
}


def started(pattern: str = "forward", **params: float) -> Story:
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    reply = story.ask("run", pattern=pattern, params=params)
    assert reply is not None
    assert reply.code is Code.APPLIED, reply.text
    story.advance(0.5)
    return story


def standing_state(story: Story) -> tuple[State, Reason | None]:
    status = story.status
    return status.state, status.reason


def test_never_moves_before_it_is_asked() -> None:
    story = Story(patterns=PATTERNS)
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
    assert any(isinstance(command, Kill) for command in story.sent)
    assert standing_state(story) == (State.RUNNING, Reason.PATTERN_RESTARTING)
    story.is_hung = False
    story.advance(0.3)
    assert story.twist == Twist(0.2)
    assert story.status.health.host_restarts == 1
    assert story.now - begin < 2.0


def test_a_pattern_that_never_comes_back_stops_the_robot_after_two_seconds() -> None:
    story = started()
    story.is_hung = True
    story.advance(2.6)
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
    story = Story(patterns=PATTERNS)
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
    story.host_says(Died(story.status.generation, "was killed by SIGKILL"))
    assert story.twist.is_zero
    assert story.status.reason is Reason.PATTERN_RESTARTING
    story.advance(0.5)
    assert story.twist == Twist(0.2)


def test_a_wish_that_is_no_number_counts_as_a_fault() -> None:
    story = Story(patterns=PATTERNS)
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
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    story.ask("run", pattern="forward", seconds=1.0)
    story.advance(0.9)
    assert not story.twist.is_zero
    story.advance(0.15)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)


# Senses


def test_no_scan_yet_holds_and_then_stops() -> None:
    story = Story(patterns=PATTERNS)
    story.scans = lambda seq, now: None
    story.advance(1.0)
    story.ask("run", pattern="forward")
    story.advance(1.0)
    assert standing_state(story) == (State.RUNNING, Reason.NO_SCAN)
    story.advance(1.2)
    assert standing_state(story) == (State.STOPPED, Reason.NO_SCAN)
    assert all(twist.is_zero for _, twist in story.commands)


def test_a_stale_scan_zeroes_exactly_when_it_is_too_old() -> None:
    story = started()
    scan_at = story.now  # advance(0.5) ends between two sweeps; find the last one
    age = story.status.verdict.scan_age
    assert age is not None
    scan_at -= age
    story.scans = lambda seq, now: None
    story.commands.clear()
    story.advance(1.5)
    limit = scan_at + story.platform.scan.stale_after
    moving = [at for at, twist in story.commands if not twist.is_zero]
    stood = [at for at, twist in story.commands if twist.is_zero]
    assert max(moving) <= limit
    assert min(stood) <= limit + 0.001
    assert story.status.reason is Reason.STALE_SCAN
    story.advance(1.6)
    assert standing_state(story) == (State.STOPPED, Reason.STALE_SCAN)


def test_a_lost_scan_now_and_then_does_not_stop_it() -> None:
    story = started()
    story.scans = lambda seq, now: None if seq % 3 == 0 else empty_scan(story.platform, seq, now)
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_frozen_scans_stop_it_with_their_own_reason() -> None:
    story = started()
    frozen = empty_scan(story.platform, 10_000, 5.0)
    story.scans = lambda seq, now: frozen
    story.advance(1.5)
    assert story.status.reason is Reason.FROZEN_SCAN


@pytest.mark.parametrize("what", ["all_nan", "sector", "lengths", "empty"])
def test_invalid_scans_stop_it_with_their_own_reason(what: str) -> None:
    story = started()

    def bad(seq: int, now: float) -> Scan:
        scan = empty_scan(story.platform, seq, now, 2.0)
        if what == "all_nan":
            return replace(scan, ranges=np.full(360, np.nan))
        if what == "sector":
            return replace(scan, ranges=np.where(np.arange(360) < 30, np.nan, scan.ranges))
        if what == "lengths":
            return replace(scan, ranges=scan.ranges[:-7])
        return replace(scan, ranges=np.empty(0), bearings=np.empty(0))

    story.scans = bad
    story.advance(2.0)
    assert story.status.reason is Reason.INVALID_SCAN
    assert story.twist.is_zero
    story.advance(1.6)
    assert standing_state(story) == (State.STOPPED, Reason.INVALID_SCAN)


def test_single_unknown_rays_do_not_stop_it() -> None:
    story = started()
    story.scans = story.nan_scan(0.1)
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_a_changing_number_of_rays_does_not_stop_it() -> None:
    story = started()

    def changing(seq: int, now: float) -> Scan:
        n = 350 + 5 * (seq % 4)
        bearings = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        scan = empty_scan(story.platform, seq, now)
        return replace(scan, ranges=np.full(n, 2.0), bearings=bearings)

    story.scans = changing
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_stale_odometry_holds_a_robot_that_has_odometry() -> None:
    story = started()
    story.odometry = None
    story.advance(0.6)
    assert story.twist.is_zero
    assert story.status.reason is Reason.STALE_ODOMETRY


def test_a_lost_driver_holds_and_its_return_does_not_start_a_stopped_robot() -> None:
    story = started()
    story.carry_out(story.robot.on_driver(False, "cable", story.now))
    assert story.twist.is_zero
    assert story.status.reason is Reason.DRIVER_LOST
    story.advance(2.2)
    assert standing_state(story) == (State.STOPPED, Reason.DRIVER_LOST)
    story.carry_out(story.robot.on_driver(True, "there", story.now))
    story.advance(2.0)
    assert story.twist.is_zero


def test_protection_overrules_the_wish_while_running_and_only_then() -> None:
    story = started()
    story.scans = lambda seq, now: replace(
        empty_scan(story.platform, seq, now),
        ranges=np.where(np.abs(np.arange(360) - 180) > 150, 0.3, np.inf),
    )
    story.advance(0.5)
    assert story.twist.linear < 0.0
    assert story.status.verdict.is_active
    story.ask("stop")
    story.advance(1.0)
    assert story.twist.is_zero


# Requests


def test_a_request_for_another_epoch_is_refused_and_names_who_changed_it() -> None:
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    seen = story.epoch
    first = story.send(story.request("run", seen, pattern="forward", operator="alice"))
    second = story.send(story.request("run", seen, pattern="finisher", operator="bob"))
    assert first is not None
    assert first.code is Code.APPLIED
    assert second is not None
    assert second.code is Code.REFUSED
    assert "by alice (run forward)" in second.text
    assert story.status.pattern == "forward"


def test_a_replayed_run_never_moves_it() -> None:
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    request = story.request("run", pattern="forward")
    story.send(request)
    story.ask("stop")
    again = story.send(request)
    assert again is not None
    assert again.code is Code.REFUSED
    story.advance(1.0)
    assert story.twist.is_zero


def test_an_epoch_of_an_earlier_life_is_refused() -> None:
    story = Story(patterns=PATTERNS, boot="boot2")
    reply = story.send(story.request("run", Epoch("boot1", 0), pattern="forward"))
    assert reply is not None
    assert reply.code is Code.REFUSED


def test_a_robot_that_is_not_named_does_not_answer() -> None:
    story = Story(patterns=PATTERNS)
    request = story.request("stop")
    other = type(request)(
        id="x", operator="a", verb="stop", targets={"tb3-02": Epoch("b", 0)}, args={}
    )
    assert story.send(other) is None
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_a_thawed_guardian_stops_before_it_reads_what_waited() -> None:
    story = started()
    waiting = story.request("run", pattern="forward")
    story.advance(3.0, ticks=False)
    late = story.send(waiting)
    assert late is not None
    assert late.code is Code.REFUSED
    assert "stall" in late.text
    assert story.twist.is_zero
    assert standing_state(story) == (State.STOPPED, Reason.LOOP_STALLED)
    story.advance(2.0)
    assert story.twist.is_zero


def test_a_loop_that_is_a_second_late_is_not_yet_stalled() -> None:
    story = started()
    story.advance(0.99, ticks=False)
    story.carry_out(story.robot.tick(story.now))
    assert story.status.state is State.RUNNING


def test_estop_latches_and_is_written_before_the_ack() -> None:
    story = started()
    reply = story.send(story.request("estop", id="e1", scope="swarm"))
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert reply.text.startswith("commanded zero")
    assert set(story.written[-1].held) == {"e1"}
    assert story.twist.is_zero
    assert standing_state(story) == (State.ESTOPPED, Reason.ESTOP)
    refused = story.ask("run", pattern="forward")
    assert refused is not None
    assert refused.code is Code.REFUSED
    stop = story.ask("stop")
    assert stop is not None
    assert stop.code is Code.APPLIED


def test_an_earlier_lifes_latch_holds_the_next_one() -> None:
    story = started()
    story.send(story.request("estop", id="e1"))
    reborn = Story(patterns=PATTERNS, latches=story.written[-1], boot="boot2")
    assert standing_state(reborn) == (State.ESTOPPED, Reason.ESTOP)


def test_a_reset_that_crosses_a_second_estop_leaves_it_latched() -> None:
    story = Story(patterns=PATTERNS)
    story.send(story.request("estop", id="e1"))
    reset = story.request("reset", ids=["e1"])
    story.send(story.request("estop", id="e2"))
    reply = story.send(reset)
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert set(story.status.latches) == {"e1", "e2"}
    partly = story.ask("reset", ids=["e1"])
    assert partly is not None
    assert partly.code is Code.REFUSED
    assert standing_state(story)[0] is State.ESTOPPED
    story.ask("reset", ids=["e2"])
    assert standing_state(story) == (State.IDLE, Reason.RESET)


def test_a_peers_swarm_wide_latch_is_taken_over_unless_it_was_reset_here() -> None:
    story = started()
    swarm_wide = {"e9": Latch(issuer="alice", scope="swarm")}
    only_there = {"e8": Latch(issuer="alice", scope="robots")}
    story.carry_out(story.robot.on_latches(only_there, story.now))
    assert story.status.state is State.RUNNING
    story.carry_out(story.robot.on_latches(swarm_wide, story.now))
    assert standing_state(story) == (State.ESTOPPED, Reason.ESTOP)
    story.ask("reset", ids=["e9"])
    story.carry_out(story.robot.on_latches(swarm_wide, story.now))
    assert standing_state(story)[0] is State.IDLE


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_stopping_while_a_pattern_is_loaded_cancels_it(verb: str) -> None:
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    story.is_hung = True
    run = story.request("run", pattern="forward")
    assert story.send(run) is None
    story.ask(verb)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is Code.REFUSED
    story.host_says(Ready(1, 10.0, frozenset(), {}))
    story.is_hung = False
    story.advance(1.0)
    assert story.twist.is_zero
    assert story.status.state in (State.STOPPED, State.ESTOPPED)


def test_a_load_that_hangs_fails_after_three_seconds_and_stops_the_body() -> None:
    story = started()
    story.is_hung = True
    run = story.request("run", pattern="finisher")
    assert story.send(run) is None
    story.advance(3.1)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is not Code.APPLIED
    assert story.twist.is_zero
    assert story.status.state is State.STOPPED


def test_a_load_that_hangs_in_an_idle_robot_fails_after_three_seconds() -> None:
    story = Story(patterns=PATTERNS)
    story.advance(1.0)
    story.is_hung = True
    run = story.request("run", pattern="forward")
    assert story.send(run) is None
    story.advance(2.9)
    assert not any(reply.id == run.id for reply in story.replies)
    story.advance(0.15)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is Code.FAILED
    assert "loading took more than 3 s" in answer.text
    assert isinstance(story.sent[-1], Kill)
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_a_host_that_hangs_is_replaced_even_if_its_robot_was_stopped_meanwhile() -> None:
    story = started()
    story.is_hung = True
    story.advance(0.2)
    story.ask("stop")
    story.sent.clear()
    story.advance(1.1)
    assert [type(command) for command in story.sent] == [Kill]
    assert standing_state(story) == (State.STOPPED, Reason.OPERATOR)


def test_outputs_of_an_older_generation_are_dropped() -> None:
    story = started(speed=0.1)
    old = story.status.generation
    story.ask("run", pattern="forward", params={"speed": 0.0})
    story.advance(0.2)
    story.host_says(Stepped(old, Outputs(Twist(0.2)), 5))
    assert story.twist.is_zero


def test_param_set_changes_the_running_pattern_until_the_next_run() -> None:
    story = started(speed=0.1)
    reply = story.ask("param", set={"speed": "0.15"})
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert story.status.params["speed"].value == 0.15
    assert story.status.params["speed"].source == "runtime"
    story.advance(0.2)
    assert story.twist == Twist(0.15)
    story.ask("run", pattern="forward")
    story.advance(0.2)
    assert story.twist == Twist(0.2)


def test_param_set_out_of_range_changes_nothing() -> None:
    story = started(speed=0.1)
    reply = story.ask("param", set={"speed": "7"})
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert "speed is '7'" in reply.text
    story.advance(0.2)
    assert story.twist == Twist(0.1)


def test_a_second_holder_of_the_id_faults_it_until_it_has_gone_and_a_reset() -> None:
    story = started()
    story.carry_out(story.robot.on_duplicate("instance b", story.now))
    assert story.twist.is_zero
    assert standing_state(story) == (State.FAULTED, Reason.DUPLICATE_ID)
    refused = story.ask("reset")
    assert refused is not None
    assert refused.code is Code.REFUSED
    story.carry_out(story.robot.on_duplicate(None, story.now))
    story.ask("reset")
    assert standing_state(story) == (State.IDLE, Reason.RESET)


# Steps and messages


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

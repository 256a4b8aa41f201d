"""A hand on a robot: who drives it, what ends that, and that nothing late moves it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.events import DriveInput, HazardsInput, LeaveInput, ReadingsInput, RequestInput
from swarmd.core.goal import Goal
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import StartTrial
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import Code, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.core.values import Scan, Twist
from swarmd.testing.scans import Disc, empty_scan, scan_of
from tests.support.hand import BACK, FORWARD, HandOn
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

LEASE = 0.5  # s, of docs/drive.md
RUN = "forward"


def standing() -> tuple[RobotHarness, HandOn]:
    harness = RobotHarness("waffle_pi", PATTERNS)
    harness.advance(1.0)
    return harness, HandOn(harness)


def running(**fields: Any) -> tuple[RobotHarness, HandOn]:
    harness, hand = standing()
    harness.applied("run", pattern=RUN, **fields)
    harness.advance(1.0)
    assert harness.twist == Twist(0.2)
    return harness, hand


def driven(**fields: Any) -> tuple[RobotHarness, HandOn]:
    """A robot whose run waits under a hand."""
    harness, hand = running(**fields)
    assert code(hand.take()) is Code.APPLIED
    hand.drive(0.5, BACK)
    assert harness.twist == BACK
    return harness, hand


def code(reply: Any) -> Code:
    assert reply is not None
    answer: Code = reply.code
    return answer


def still(harness: RobotHarness, seconds: float) -> bool:
    """True if the base is commanded zero in the next `seconds`."""
    begin = len(harness.commands)
    harness.advance(seconds)
    return all(twist.is_zero for _, twist in harness.commands[begin:])


# Drive and release


def test_an_idle_robot_drives_by_hand_says_by_whom_and_is_idle_after_the_release() -> None:
    harness, hand = standing()
    assert code(hand.take()) is Code.APPLIED
    assert still(harness, 0.3)  # taken, and no command yet
    hand.drive(1.0)
    assert (harness.twist, harness.status.driven_by) == (FORWARD, "anna")
    assert harness.status.state is State.IDLE
    assert harness.status.reason is None
    released = hand.release()
    assert released is not None
    assert (released.code, released.text) == (Code.APPLIED, "released; idle")
    assert still(harness, 1.0)
    assert (harness.status.driven_by, harness.status.state) == ("", State.IDLE)


def test_a_run_waits_for_the_hand_and_goes_on_by_the_word_of_its_driver() -> None:
    harness, hand = driven()
    assert (harness.status.state, harness.status.pattern) == (State.RUNNING, RUN)
    released = hand.release()
    assert released is not None
    assert (released.code, released.text) == (Code.APPLIED, "released; forward goes on")
    assert harness.twist == Twist(0.2)


def test_the_own_end_of_a_run_counts_on_beneath_the_hand() -> None:
    harness, hand = driven(seconds=3.0)
    hand.drive(3.0, BACK)
    assert (harness.status.state, harness.status.pattern) == (State.IDLE, None)
    assert harness.twist == BACK
    hand.release()
    assert still(harness, 1.0)


def test_a_run_that_is_asked_for_meanwhile_waits_too() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(0.3, BACK)
    harness.applied("run", pattern=RUN)
    hand.drive(0.5, BACK)
    assert (harness.twist, harness.status.pattern) == (BACK, RUN)
    hand.release()
    assert harness.twist == Twist(0.2)


# Protection


def wall(harness: RobotHarness) -> Callable[[int, float], Scan | None]:
    """Scans of a wall 0.2 m ahead of the sensor."""

    def scan(seq: int, now: float) -> Scan:
        empty = empty_scan(harness.platform, seq, now, 3.0)
        is_ahead = np.abs(empty.bearings) < 0.5
        return replace(empty, ranges=np.where(is_ahead, 0.2 + 1e-6 * (seq % 100), empty.ranges))

    return scan


@pytest.mark.parametrize("begin", [standing, running])
def test_protection_bounds_the_hand_and_says_why_it_stands(
    begin: Callable[[], tuple[RobotHarness, HandOn]],
) -> None:
    harness, hand = begin()
    hand.take()
    hand.drive(0.5, Twist(5.0, 0.0))
    assert harness.twist.linear == harness.platform.limits.linear
    harness.scans = wall(harness)
    hand.drive(1.0)
    assert harness.twist.linear <= 0.02
    assert harness.status.decision.is_active


@pytest.mark.parametrize("begin", [standing, running])
def test_holds_hold_the_hand(begin: Callable[[], tuple[RobotHarness, HandOn]]) -> None:
    harness, hand = begin()
    hand.take()
    hand.drive(0.5)
    harness.scans = lambda seq, now: None
    hand.drive(1.0)
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.STALE_SCAN


def test_a_bound_of_speed_bounds_the_hand_and_keeps_the_curve() -> None:
    harness, hand = standing()
    hand.take(speed=0.1)
    hand.drive(0.3, Twist(0.2, 0.4))
    assert (harness.twist.linear, harness.twist.angular) == pytest.approx((0.1, 0.2))


def test_a_hand_is_not_steered_around_what_a_run_is_steered_around() -> None:
    """A pillar 1 m ahead, 0.1 m to the left."""

    def scan(seq: int, now: float) -> Scan:
        noise = np.random.default_rng(seq)
        pillar = [Disc(1.0, 0.1, 0.15)]
        seen = scan_of(harness.platform, pillar, room=8.0, seq=seq, noise=0.003, rng=noise)
        return replace(seen, stamp=now)

    harness, hand = running()
    harness.scans = scan
    harness.advance(1.0)
    assert harness.twist.angular < -0.1
    hand.take()
    hand.drive(1.0, Twist(0.2))
    assert harness.twist == Twist(0.2)


def test_a_pattern_that_hangs_does_not_hold_the_hand() -> None:
    harness, hand = driven()
    harness.is_hung = True
    hand.drive(0.7, BACK)
    assert harness.twist == BACK


# Lost


def test_a_lost_hand_holds_the_run_until_a_resume() -> None:
    harness, _ = driven()
    harness.advance(LEASE)
    assert still(harness, 10.0)  # longer than a hold that ends a run
    status = harness.status
    assert (status.state, status.reason, status.driven_by) == (
        State.RUNNING,
        Reason.HAND_LOST,
        "",
    )
    assert harness.applied("resume").refusal is None
    harness.advance(0.1)
    assert harness.twist == Twist(0.2)


@pytest.mark.parametrize("is_of_a_goal", [True, False])
def test_a_resume_of_a_goal_that_was_seen_lets_the_run_of_that_goal_alone_go_on(
    is_of_a_goal: bool,
) -> None:
    wanted = Goal(generation=9, issuer="anna", id="seen", pattern=RUN)
    harness, _ = driven(goal=wanted if is_of_a_goal else None)
    harness.advance(LEASE)
    refused = harness.refused("resume", digest="00")
    assert refused.refusal is (Refusal.OVERTAKEN if is_of_a_goal else Refusal.NO_GOAL)
    assert still(harness, 1.0)
    told = harness.status.goal
    assert (told is not None) is is_of_a_goal
    if told is not None and told.own is not None:
        assert harness.applied("resume", digest=told.own.digest).text == "forward goes on"
        harness.advance(0.1)
        assert harness.twist == Twist(0.2)


@pytest.mark.parametrize("again", ["run", "hand"])
def test_a_new_run_or_a_released_hand_ends_the_hold(again: str) -> None:
    harness, _ = driven()
    harness.advance(1.0)
    if again == "run":
        harness.applied("run", pattern=RUN)
    else:
        other = HandOn(harness, "bob", 9e3)
        assert code(other.take()) is Code.APPLIED
        other.drive(0.2, BACK)
        assert harness.twist == BACK
        other.release()
    harness.advance(0.2)
    assert harness.twist == Twist(0.2)


def test_the_end_of_the_run_ends_the_hold() -> None:
    harness, _ = driven(seconds=3.0)
    harness.advance(3.0)
    status = harness.status
    assert (status.state, status.reason) == (State.IDLE, Reason.FINISHED)
    assert harness.robot.is_at_rest


def test_the_base_stands_when_the_lease_is_over_and_no_command_comes() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(1.0)
    last = harness.now - 0.1  # the last command, after which 0.1 s passed
    harness.advance(1.0)
    ends = [at for at, twist in harness.commands if not twist.is_zero]
    assert ends[-1] < last + LEASE
    stands = next(at for at, twist in harness.commands if at > last and twist.is_zero)
    assert stands == pytest.approx(last + LEASE, abs=1e-6)
    hand.word()
    assert still(harness, 1.0)


def test_a_command_that_arrives_after_the_lease_is_no_renewal() -> None:
    """The daemon was late by less than a stall: the command is read before the next tick."""
    harness, hand = standing()
    hand.take()
    hand.drive(0.5)
    harness.advance(LEASE, ticks=False)
    hand.word()
    harness.advance(0.05)
    assert harness.twist.is_zero
    assert harness.status.driven_by == ""


def test_a_start_that_was_asked_for_before_the_loss_ends_no_hold() -> None:
    harness, _ = driven()
    late = harness.request("resume")
    harness.advance(1.0)
    assert harness.answer(late).refusal is Refusal.STALE_EPOCH
    assert still(harness, 1.0)


def test_a_run_that_loads_when_the_hand_is_lost_is_held() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(0.2)
    harness.is_hung = True
    harness.ask("run", pattern=RUN)
    load = harness.sent[-1]
    harness.advance(1.0)
    harness.is_hung = False
    harness.host_answers(load)
    assert still(harness, 1.0)
    assert harness.status.reason is Reason.HAND_LOST


def of_peers(id: str = "later") -> Goal:
    """A goal that a robot joins."""
    return Goal(generation=9, issuer="bob", id=id, pattern=RUN, on_join="run", valid=60.0)


@pytest.mark.parametrize("begin", [standing, running])
def test_a_goal_that_was_set_before_the_loss_ends_no_hold(
    begin: Callable[[], tuple[RobotHarness, HandOn]],
) -> None:
    harness, hand = begin()
    hand.take()
    hand.drive(0.5)
    harness.advance(3.0)
    harness.find(of_peers(), 4.0)
    assert still(harness, 1.0)


def test_a_goal_that_is_set_meanwhile_waits_too() -> None:
    harness, hand = driven()
    harness.find(of_peers(), 0.1)
    hand.drive(0.5, BACK)
    assert (harness.twist, harness.status.driven_by) == (BACK, "anna")
    hand.release()
    assert harness.twist == Twist(0.2)


def test_a_reload_with_a_new_run_leaves_the_run_beneath_the_hand() -> None:
    harness, hand = driven()
    harness.applied("reload", pattern=RUN, is_rerun=True, operator="bob")
    hand.drive(0.5, BACK)
    assert (harness.twist, harness.status.driven_by) == (BACK, "anna")


def test_a_reload_that_was_asked_for_before_the_loss_ends_no_hold() -> None:
    harness, _ = driven()
    harness.is_hung = True
    harness.ask("reload", pattern=RUN, is_rerun=True)
    harness.is_hung = False
    trial = next(one for one in harness.sent if isinstance(one, StartTrial))
    harness.advance(1.0)
    harness.host_answers(trial)
    assert still(harness, 1.0)
    assert harness.status.reason is Reason.HAND_LOST


@pytest.mark.parametrize("is_heard", [True, False])
def test_no_pattern_of_a_low_battery_follows_a_run_beneath_a_hand(is_heard: bool) -> None:
    settings = LowBatterySettings(below=0.2, pattern=RUN, params={}, seconds=60.0)
    harness = RobotHarness("waffle_pi", PATTERNS, on_low_battery=settings)
    harness.advance(1.0)
    harness.applied("run", pattern=RUN)
    harness.advance(0.5)
    hand = HandOn(harness)
    hand.take()
    hand.drive(0.5)
    harness.advance(0.0 if is_heard else 1.0)
    for _ in range(80):
        harness.step(ReadingsInput({"battery": 0.1}))
        if is_heard:
            hand.word()
        harness.advance(0.5)
    assert (harness.status.state, harness.status.reason) == (State.STOPPED, Reason.LOW_BATTERY)
    assert still(harness, 1.0)


@pytest.mark.parametrize("leaves", [True, False])
@pytest.mark.parametrize("last", ["heard", "lost", "released"])
def test_after_a_restart_of_the_daemon_only_a_released_run_goes_on(last: str, leaves: bool) -> None:
    harness, hand = standing()
    harness.find(of_peers(), 1.0)
    harness.advance(0.5)
    hand.take()
    hand.drive(0.5, BACK)
    if last == "released":
        hand.release()
    harness.advance(1.0 if last == "lost" else 0.1)
    if leaves:
        harness.step(LeaveInput())
        assert harness.twist.is_zero
    again = RobotHarness("waffle_pi", PATTERNS, goals=harness.record, instance="boot2")
    again.advance(1.0)
    again.find(of_peers(), 5.0)
    again.advance(0.5)
    assert (again.twist == Twist(0.2)) is (last == "released")


# Stops


def estop(harness: RobotHarness) -> None:
    harness.applied("estop")


def stop(harness: RobotHarness) -> None:
    harness.applied("stop", operator="bob")


def hazard(harness: RobotHarness) -> None:
    harness.step(HazardsInput((Hazard(HazardKind.LIFTED),)))
    harness.step(HazardsInput(()))


def stall(harness: RobotHarness) -> None:
    harness.advance(2.0, ticks=False)


def standing_goal(harness: RobotHarness) -> None:
    held = harness.robot.goal
    generation = 1 if held is None else held.goal.generation + 1
    harness.find(Goal(generation=generation, issuer="bob", id="stand"), 0.0)


@pytest.mark.parametrize("end", [stop, estop, hazard, stall, standing_goal])
@pytest.mark.parametrize("begin", [standing, running])
def test_what_stops_a_robot_ends_the_hand_and_its_release_starts_nothing(
    begin: Callable[[], tuple[RobotHarness, HandOn]], end: Callable[[RobotHarness], None]
) -> None:
    harness, hand = begin()
    hand.take()
    hand.drive(0.5)
    end(harness)
    begin_at = len(harness.commands)
    hand.drive(0.5)
    assert code(hand.release()) is Code.REFUSED
    hand.drive(0.5)
    assert all(twist.is_zero for _, twist in harness.commands[begin_at:])
    assert harness.status.driven_by == ""


def test_an_estopped_robot_refuses_a_hand_and_a_stopped_one_takes_it() -> None:
    harness, hand = running()
    harness.applied("stop")
    assert code(hand.take()) is Code.APPLIED
    hand.drive(0.3)
    assert harness.twist == FORWARD
    harness.applied("estop")
    reply = hand.take()
    assert reply is not None
    assert reply.refusal is Refusal.ESTOPPED


def test_a_hand_that_was_asked_for_before_a_stop_is_refused() -> None:
    harness, hand = standing()
    harness.applied("stop")
    reply = hand.take(age=1.0)
    assert reply is not None
    assert reply.refusal is Refusal.OVERTAKEN


def test_a_stop_between_hand_and_run_ends_the_hand() -> None:
    """The run was asked for after the stop, the hand before it; the stop arrives last."""
    harness, hand = standing()
    hand.take()
    hand.drive(2.0, BACK)
    harness.applied("run", pattern=RUN)
    stop = harness.request("stop", age=1.0)
    hand.drive(0.1, BACK)
    assert harness.answer(stop).refusal is Refusal.OVERTAKEN
    assert harness.status.driven_by == ""
    assert harness.twist == Twist(0.2)


def test_a_late_stop_does_not_end_the_hold_of_a_lost_hand() -> None:
    """The run was asked for after the stop, and is held by a hand that was lost after both."""
    harness, hand = standing()
    hand.take()
    hand.drive(2.0, BACK)
    harness.applied("run", pattern=RUN)
    harness.advance(1.0)
    assert harness.refused("stop", age=2.0).refusal is Refusal.OVERTAKEN
    assert still(harness, 1.0)
    assert harness.status.reason is Reason.HAND_LOST


def test_a_stop_that_a_reset_has_overtaken_ends_the_hand() -> None:
    """The reset leaves the hand of an idle robot; the first copies of the stop got lost."""
    harness, hand = standing()
    hand.take()
    hand.drive(1.0)
    harness.applied("reset", operator="bob")
    hand.drive(0.1)
    harness.applied("stop", age=0.3)
    hand.drive(0.5)
    assert (harness.twist.is_zero, harness.status.driven_by) == (True, "")


# Others, and what is late


def test_the_first_hand_keeps_the_robot_and_the_second_is_told() -> None:
    harness, hand = driven()
    other = HandOn(harness, "bob")
    reply = other.take()
    assert reply is not None
    assert reply.refusal is Refusal.BUSY
    assert "anna" in reply.text
    other.word(FORWARD)
    assert harness.twist == BACK
    other.id = hand.id  # heard on the network
    other.order = 1000
    other.word(FORWARD)
    assert harness.twist == BACK
    assert code(other.release()) is Code.REFUSED
    assert harness.status.driven_by == "anna"


def test_a_copy_of_the_request_takes_nothing_after_the_release() -> None:
    harness, hand = standing()
    request = harness.request("drive", operator="anna")
    hand.id = request.id
    harness.answer(request)
    hand.drive(0.3)
    hand.release()
    harness.step(RequestInput(request))
    hand.drive(0.5)
    assert harness.twist.is_zero


def test_commands_out_of_order_repeated_or_late_are_dropped() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(0.3)
    hand.word(BACK, order=1)
    hand.word(BACK, order=hand.order - 1)
    assert harness.twist == FORWARD
    hand.word(BACK, age=0.4)  # 0.3 s more than the fastest is late
    assert harness.twist == FORWARD
    hand.word(BACK, age=0.2)
    assert harness.twist == BACK
    assert harness.status.health.dropped["drive:ignored"] == 3


def test_commands_that_are_all_held_back_drive_nothing() -> None:
    """The request shows how long the way is at most, if it has the clock of its sender."""
    harness, hand = standing()
    hand.take(clock="desk", issued=harness.now + hand.ahead)
    harness.advance(0.5)
    for _ in range(5):
        hand.word(age=0.4)
        harness.advance(0.1)
    assert harness.twist.is_zero


def test_a_slow_clock_of_the_sender_makes_nothing_late() -> None:
    harness, hand = standing()
    hand.take()
    for _ in range(600):
        hand.ahead -= 0.1 * 2e-4  # s
        hand.drive(0.1)
    hand.ahead -= 0.25
    hand.drive(0.1, BACK)
    assert harness.twist == BACK


def test_a_command_that_is_no_number_is_zero() -> None:
    harness, hand = standing()
    hand.take()
    hand.drive(0.2)
    hand.word(Twist(float("nan"), 0.0))
    assert harness.twist.is_zero


def test_a_hand_with_an_end_is_lost_then() -> None:
    harness, hand = running()
    hand.take(seconds=1.0)
    hand.drive(2.0, BACK)
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.HAND_LOST


def test_a_command_for_no_hand_costs_no_decision() -> None:
    harness, _ = standing()
    count = len(harness.commands)
    harness.step(DriveInput("r9", "anna", 1, 0.0, FORWARD))
    assert len(harness.commands) == count

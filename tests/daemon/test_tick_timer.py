"""The daemon's timer, on a loop whose time the test sets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import pairwise
from typing import cast

import pytest

from swarmd.core.clock import TICK
from swarmd.core.events import TICK_INPUT, OdometryInput
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.daemon.tick_timer import RESTING_PERIODS, TickTimer
from tests.support.robot_harness import RobotHarness


class HandLoop:
    """The part of a loop that the timer needs."""

    def __init__(self) -> None:
        self.now = 0.0
        self.calls: list[Call] = []

    def time(self) -> float:
        return self.now

    def call_at(self, at: float, call: Callable[[], None]) -> Call:
        self.calls.append(Call(self, at, call))
        return self.calls[-1]

    def run_until(self, end: float) -> None:
        while self.calls and (first := min(self.calls, key=lambda one: one.at)).at <= end:
            first.cancel()
            self.now = first.at
            first.call()
        self.now = end


class Call:
    """A call that can be cancelled."""

    def __init__(self, loop: HandLoop, at: float, call: Callable[[], None]) -> None:
        self.loop, self.at, self.call = loop, at, call

    def cancel(self) -> None:
        if self in self.loop.calls:
            self.loop.calls.remove(self)


@pytest.mark.parametrize("wake_in", [0.4, 1.5, 2.4])
def test_wake_up_is_kept_until_its_time(wake_in: float) -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.wake_in(wake_in * TICK)
    loop.run_until(3.5 * TICK)
    assert times == pytest.approx(sorted([wake_in, 1.0, 2.0, 3.0]))


def test_wake_up_is_replaced_and_stopped() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.wake_in(1.5 * TICK)
    timer.wake_in(2.5 * TICK)
    loop.run_until(2.1 * TICK)
    timer.wake_in(None)
    loop.run_until(3.1 * TICK)
    timer.stop()
    loop.run_until(9.0 * TICK)
    assert times == pytest.approx([1.0, 2.0, 3.0])


def test_a_timer_at_rest_ticks_half_as_often_and_counts_all_periods() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.rest(True)
    loop.run_until((1.5 + 3 * RESTING_PERIODS) * TICK)
    assert times == pytest.approx([1.0 + RESTING_PERIODS * i for i in range(4)])
    assert timer.periods == 1 + 3 * RESTING_PERIODS


@pytest.mark.parametrize("waited", [0.1, 0.9, 1.0, 1.1, 1.9])
def test_a_rest_ends_with_a_tick_within_a_period(waited: float) -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.rest(True)
    loop.run_until((1.0 + RESTING_PERIODS + waited) * TICK)
    timer.rest(False)
    timer.rest(False)
    times.clear()
    loop.run_until(loop.now + 3.01 * TICK)
    assert times[0] <= 1.0 + RESTING_PERIODS + waited + 1.0 + 1e-9
    assert all(1.0 - 1e-9 <= b - a <= 1.0 + 1e-9 for a, b in pairwise(times))
    assert len(times) >= 3


def test_a_stall_of_a_resting_timer_counts_from_the_time_of_its_tick() -> None:
    loop = HandLoop()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: None)
    timer.rest(True)
    loop.run_until(1.1 * TICK)
    for lateness, stalls in ((0.99, 0), (1.01, 1)):
        (call,) = loop.calls
        call.cancel()
        loop.now = call.at + lateness
        call.call()
        assert timer.stalls == stalls


def test_scans_bring_the_ticks_of_a_resting_timer_forward() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.tick_early()  # not at rest: nothing
    timer.rest(True)
    for scan in (4.5, 8.5, 12.5):  # at 5 Hz
        loop.run_until(scan * TICK)
        timer.tick_early()
        loop.run_until((scan + 0.01) * TICK)
    assert times == pytest.approx([1.0, 3.0, 4.5, 6.7, 8.5, 10.7, 12.5])
    assert timer.periods == pytest.approx(12, abs=1)
    timer.rest(False)
    loop.run_until(14.6 * TICK)
    assert times[7:] == pytest.approx([13.51, 14.51])


def test_one_tick_that_is_not_due_soon_brings_later_ticks_in_phase_with_scans() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.rest(True)
    for scan in (5.4, 9.4, 13.4):  # at 5 Hz; the tick after the first one is due at 7.0
        loop.run_until(scan * TICK)
        timer.tick_early()
        loop.run_until((scan + 0.4) * TICK)
        timer.tick_early()  # of a tick that is due 1.8 periods later, after one in phase: nothing
    loop.run_until(14.0 * TICK)
    assert times == pytest.approx([1.0, 3.0, 5.0, 5.4, 7.6, 9.4, 11.6, 13.4])


def test_a_resting_timer_keeps_its_wake_up() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.rest(True)
    loop.run_until(1.1 * TICK)
    timer.wake_in(0.5 * TICK)
    loop.run_until(3.1 * TICK)
    assert times == pytest.approx([1.0, 1.6, 1.0 + RESTING_PERIODS])


@pytest.mark.parametrize("scan_phase", [0.0, 0.03, 0.06, 0.11, 0.17])
def test_a_resting_robot_with_a_lidar_wakes_the_loop_ten_times_a_second(scan_phase: float) -> None:
    """In 0.2 s one scan, which brings a tick forward, and one more tick: 600 in 60 s.

    Odometry comes 20 times a second and wakes nothing: it waits for a scan or a tick.
    """
    loop, wakes, harness = HandLoop(), list[float](), RobotHarness("burger")
    epoch, begin = harness.now, 2.0

    def wake() -> None:
        harness.now = epoch + loop.now
        if loop.now >= begin:
            wakes.append(loop.now)
        odometry = Odometry(harness.now, Pose(), Twist())  # the last one of those that waited
        harness.step(OdometryInput(odometry))

    def tick() -> None:
        wake()
        harness.step(TICK_INPUT)
        timer.rest(harness.robot.is_at_rest)
        wake_at = harness.robot.wake_at(harness.now)
        timer.wake_in(None if wake_at is None else wake_at - harness.now)

    def scan() -> None:
        wake()
        harness.scan(harness.scans(round(5.0 * loop.now), harness.now))
        timer.tick_early()
        loop.call_at(loop.now + 0.2, scan)

    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), tick)
    loop.call_at(1.0 + scan_phase, scan)
    loop.run_until(begin + 60.0)
    assert harness.robot.is_at_rest
    assert len(set(wakes)) == pytest.approx(600, abs=2)

"""The daemon's timer, on a loop whose time the test sets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import pairwise
from typing import cast

import pytest

from swarmd.core.clock import TICK
from swarmd.daemon.tick_timer import RESTING_PERIODS, TickTimer


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
        loop.run_until((scan - 1.1) * TICK)
        timer.tick_early()  # of a tick that is not due within a period: nothing
        loop.run_until(scan * TICK)
        timer.tick_early()
        loop.run_until((scan + 0.01) * TICK)
    assert times == pytest.approx([1.0, 3.0, 4.5, 6.7, 8.5, 10.7, 12.5])
    assert timer.periods == pytest.approx(12, abs=1)
    timer.rest(False)
    loop.run_until(14.6 * TICK)
    assert times[7:] == pytest.approx([13.51, 14.51])


def test_a_resting_timer_keeps_its_wake_up() -> None:
    loop, times = HandLoop(), list[float]()
    timer = TickTimer(cast(asyncio.AbstractEventLoop, loop), lambda: times.append(loop.now / TICK))
    timer.rest(True)
    loop.run_until(1.1 * TICK)
    timer.wake_in(0.5 * TICK)
    loop.run_until(3.1 * TICK)
    assert times == pytest.approx([1.0, 1.6, 1.0 + RESTING_PERIODS])

"""The daemon's timer, on a loop whose time the test sets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import cast

import pytest

from swarmd.core.clock import TICK
from swarmd.daemon.tick_timer import TickTimer


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

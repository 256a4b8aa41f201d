"""The daemon's timer."""

from __future__ import annotations

import asyncio

from swarmd.core.clock import TICK
from swarmd.daemon.tick_timer import TickTimer


async def calls_of(wake_in: float | None, count: int) -> list[float]:
    """The times of the first calls in s, with a wake-up that is set once."""
    loop, times, done = asyncio.get_running_loop(), list[float](), asyncio.Event()
    begin = loop.time()

    def tick() -> None:
        times.append(loop.time() - begin)
        if len(times) == count:
            done.set()

    timer = TickTimer(loop, tick)
    timer.wake_in(wake_in)
    await asyncio.wait_for(done.wait(), 20.0)
    timer.stop()
    return times


def test_a_wake_up_between_later_ticks_needs_to_be_set_once() -> None:
    times = asyncio.run(calls_of(1.5 * TICK, 3))
    assert times[0] >= TICK - 1e-3
    assert times[1] >= 1.5 * TICK - 1e-3
    assert times[2] >= 2.0 * TICK - 1e-3
    assert len([at for at in asyncio.run(calls_of(None, 3)) if at < 2.9 * TICK]) <= 2

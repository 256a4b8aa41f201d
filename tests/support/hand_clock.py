"""A loop whose clock is in a test's hand: what is to happen in an hour happens now, at its time."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from tests.support.no_real_clock import no_real_clock

BEGIN = 1000.0
"""What the clock says at first, in s."""


class _Skipping(selectors.DefaultSelector):
    """Never waits for a timer: the clock goes on to it, as soon as nothing else is to be done."""

    now = BEGIN

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(0.0)
        if not found and timeout:
            self.now += timeout
        return found


class _Here(ThreadPoolExecutor):
    """Carries out at once what is meant for a thread, which would know another time."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **keywords))
        except Exception as error:
            done.set_exception(error)
        return done


class HandLoop(asyncio.SelectorEventLoop):
    """Begins at `BEGIN`; only its timers move it."""

    def __init__(self) -> None:
        self._skipping = _Skipping()
        super().__init__(self._skipping)
        self.set_default_executor(_Here())

    def time(self) -> float:
        return self._skipping.now


def run(story: Awaitable[None]) -> None:
    loop = HandLoop()
    try:
        with no_real_clock():
            loop.run_until_complete(story)
    finally:
        loop.close()


async def settle() -> None:
    """Let the loop carry out what is to be done now; no time passes."""
    for _ in range(5):
        await asyncio.sleep(0.0)

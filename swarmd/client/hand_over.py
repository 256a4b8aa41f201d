"""Runs the blocking work of an operator on threads, for an event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future

from swarmd.core.errors import R

HAND_OVER = "swarmd-commanding"
"""The name of the daemon threads that carry work out."""


def begin(work: Callable[[], R]) -> Future[R]:
    """Run `work` on a daemon thread; returns the future of its result.

    The program may end before the thread.
    """
    result: Future[R] = Future()
    result.set_running_or_notify_cancel()

    def run() -> None:
        try:
            result.set_result(work())
        except BaseException as error:
            result.set_exception(error)

    threading.Thread(target=run, name=HAND_OVER, daemon=True).start()
    return result


async def in_thread(work: Callable[[], R]) -> R:
    """The result of `work`, run as by `begin`; a cancelled task leaves the thread to end."""
    return await asyncio.wrap_future(begin(work))

"""Work of an operator that an event loop hands over to threads."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

R = TypeVar("R")

HAND_OVER = "swarmd-commanding"
"""The name of the daemon threads that carry work out."""


def begin(work: Callable[[], R]) -> Future[R]:
    """Do `work` on a daemon thread, which the program may end before. Gives its result."""
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
    """The result of `work`, done as `begin` does; a cancelled task leaves the thread to end."""
    return await asyncio.wrap_future(begin(work))

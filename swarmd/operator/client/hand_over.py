"""Runs the blocking work of an operator on threads, for an event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Iterator
from concurrent.futures import Future
from typing import Any

from swarmd.core.errors import R

HAND_OVER = "swarmd-commanding"
"""The name of the daemon threads that carry work out."""
MAX_WAITING = 1000
"""Items of an iterator that wait for the loop; its thread waits then."""


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


async def from_thread(
    make: Callable[[], Iterator[R]], cancelled: threading.Event
) -> AsyncGenerator[R, None]:
    """Yield the items of an iterator that runs on a thread of its own.

    `make` makes the iterator, on that thread. An error of the iterator is raised here. The end of
    this generator sets `cancelled`, by which the iterator and the thread end. While MAX_WAITING
    items wait for the reader, the thread waits.
    """
    loop = asyncio.get_running_loop()
    items: asyncio.Queue[R] = asyncio.Queue()
    room = threading.Semaphore(MAX_WAITING)  # the places in `items` that are free

    def work() -> None:
        """On the thread: put each item into `items` once a place is free, until cancelled."""
        for item in make():
            while not room.acquire(timeout=0.2):
                if cancelled.is_set():
                    return
            if cancelled.is_set():
                return
            loop.call_soon_threadsafe(items.put_nowait, item)

    thread_end = asyncio.wrap_future(begin(work))
    try:
        while True:
            next_item = asyncio.ensure_future(items.get())
            item_or_end: set[asyncio.Future[Any]] = {next_item, thread_end}
            await asyncio.wait(item_or_end, return_when=asyncio.FIRST_COMPLETED)
            if next_item.done():
                room.release()
                yield next_item.result()
                continue
            # The thread has ended, and has put all its items into `items`.
            next_item.cancel()
            while not items.empty():
                yield items.get_nowait()
            thread_end.result()  # raises the error of the iterator
            return
    finally:
        cancelled.set()
        next_item.cancel()  # else this task would wait for ever in the loop of a notebook
        thread_end.cancel()  # the thread may end after the loop, and must not call a closed loop

"""Opening a session without holding up the loop, and leaving none behind."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

import zenoh

S = TypeVar("S", bound=zenoh.Session | None)


async def opened(open_it: Callable[[], S]) -> S:
    """What `open_it` gives, called in a thread; closed at once if nobody waits for it any more.

    Even if the loop ends meanwhile: a session that is left open would keep the process alive.
    """
    opening = _Opening(open_it)
    try:
        return await asyncio.to_thread(opening.run)
    except asyncio.CancelledError:
        opening.abandon()
        raise


class _Opening(Generic[S]):
    def __init__(self, open_it: Callable[[], S]) -> None:
        self._open, self._lock = open_it, threading.Lock()
        self._found: S | None = None
        self._is_abandoned = False

    def run(self) -> S:
        found = self._open()
        with self._lock:
            self._found = found
            if self._is_abandoned:
                _close(found)
        return found

    def abandon(self) -> None:
        with self._lock:
            self._is_abandoned = True
            _close(self._found)


def _close(session: zenoh.Session | None) -> None:
    if session is not None:
        session.close()

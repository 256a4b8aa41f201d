"""Hands calls from foreign threads to the asyncio loop, and tells whether the program has ended."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TypeVarTuple, Unpack

Args = TypeVarTuple("Args")


def is_program_ended() -> bool:
    """Whether the main thread has ended, or waits for the threads of pools that are left.

    Python joins the threads of `ThreadPoolExecutor` before the main thread counts as ended. The
    module `threading` notes the begin of this wait in `_SHUTTING_DOWN` (Python 3.9 to 3.14); in a
    Python without it only the end of the main thread counts.
    """
    return getattr(threading, "_SHUTTING_DOWN", False) or not threading.main_thread().is_alive()


def hand_over(
    loop: asyncio.AbstractEventLoop, function: Callable[[Unpack[Args]], object], *args: Unpack[Args]
) -> None:
    """Call `function(*args)` on the loop's thread; dropped if the loop has closed."""
    try:
        loop.call_soon_threadsafe(function, *args)
    except RuntimeError:  # the loop has closed, while a network thread still delivers
        return

"""Where a virtual clock stands, our code reads no clock of this machine."""

from __future__ import annotations

import sys
import time
from _thread import get_ident
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

READERS = (
    *("time", "monotonic", "perf_counter", "clock_gettime"),
    *("time_ns", "monotonic_ns", "perf_counter_ns", "clock_gettime_ns"),
)
"""The functions of `time` that read a clock of this machine, CPU time apart."""
OURS = ("swarmd", "tests", "__main__")
"""The packages that may not; a library, such as hypothesis, may."""


class RealClockError(BaseException):
    """Our code has read a clock of this machine. No `except Exception` hides it."""


@contextmanager
def no_real_clock() -> Iterator[None]:
    """In this block each read of a clock of this machine by our code raises RealClockError.

    A read whose error was caught, as by an asyncio loop, is raised at the end of the block.
    """
    reads: list[str] = []
    thread = get_ident()  # another one, such as one that an earlier test left, has the real time

    def forbidden(name: str, read: Callable[..., Any]) -> Callable[..., Any]:
        def checked(*words: Any) -> Any:
            caller = sys._getframe(1)
            name_of_caller = caller.f_globals.get("__name__", "")
            if get_ident() != thread or name_of_caller.partition(".")[0] not in OURS:
                return read(*words)
            if caller.f_code.co_name == "boottime" and caller.f_back is not None:
                caller = caller.f_back
            place = f"{caller.f_code.co_filename}:{caller.f_lineno} reads time.{name}"
            reads.append(place)
            raise RealClockError(place)

        return checked

    before = {name: getattr(time, name) for name in READERS}
    try:
        for name, read in before.items():
            setattr(time, name, forbidden(name, read))
        yield
    finally:
        for name, read in before.items():
            setattr(time, name, read)
    if reads:
        raise RealClockError(reads[0])

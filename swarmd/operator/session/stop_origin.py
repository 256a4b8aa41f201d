"""The origin and the counter of an operator's stops, in a small file beside its identity."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

ORIGIN_BYTES = 4
FILE = "stops"
_MAX_COUNTER = 2**52  # a file with a greater counter is damaged


class _Record(Struct, frozen=True, array_like=True):
    origin: Annotated[bytes, Meta(min_length=ORIGIN_BYTES, max_length=ORIGIN_BYTES)]
    counter: Annotated[int, Meta(ge=0, le=_MAX_COUNTER)]


class StopOrigin:
    """Gives each stop an origin and a counter (`stop_freshness.py`); never raises or waits.

    Without a `folder`, or if the file cannot be read, locked and written: a random origin.
    """

    def __init__(self, folder: Path | None, clock: Callable[[], float] = time.time) -> None:
        self._path = None if folder is None else folder / FILE
        self._clock = clock

    def next(self, *, is_new: bool = False) -> tuple[bytes, int]:
        """The origin and counter of one stop; `is_new`: take an origin that was never used."""
        least = max(int(1000.0 * self._clock()), 1)
        fresh = _Record(os.urandom(ORIGIN_BYTES), least)
        if self._path is None:
            return fresh.origin, fresh.counter
        try:
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:
            return fresh.origin, fresh.counter
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            record = fresh if is_new else _following(os.pread(handle, 64, 0), fresh)
            content = msgspec.msgpack.encode(record)
            os.ftruncate(handle, 0)
            if os.pwrite(handle, content, 0) != len(content):
                return fresh.origin, fresh.counter
            return record.origin, record.counter
        except OSError:  # the disk is full, or another command holds the lock right now
            return os.urandom(ORIGIN_BYTES), least
        finally:
            os.close(handle)


def _following(content: bytes, fresh: _Record) -> _Record:
    """The record after the record in the file; `fresh` if the file is damaged."""
    try:
        last = msgspec.msgpack.decode(content, type=_Record)
    except msgspec.MsgspecError:
        return fresh
    return _Record(last.origin, min(max(last.counter + 1, fresh.counter), _MAX_COUNTER))

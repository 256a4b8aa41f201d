"""Writes the newest record of a file in a thread, since a disk may take seconds."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

RETRY_PERIOD = 5.0  # s between two tries to write a record that could not be written

Record = TypeVar("Record")


class RecordWriter(Generic[Record]):
    """Calls `write(record)` in a thread, one call at a time, for the newest record.

    `write` returns when the record is on the disk, and raises OSError if it cannot be written; then
    the newest record is tried again. `path` is for messages. `on_event` takes a line when records
    cannot be written, and when they can be written again. All methods are called on the loop.
    """

    def __init__(
        self, path: Path, write: Callable[[Record], None], on_event: Callable[[str], None]
    ) -> None:
        self._path = path
        self._write = write
        self._on_event = on_event
        self._newest: Record
        self._tried: asyncio.Future[str] | None = None  # of the try that is to begin
        self._last: asyncio.Future[str] | None = None  # of the try that takes the newest record
        self._task: asyncio.Task[None] | None = None
        self._asked = asyncio.Event()  # there is a newer record, or the writer closes
        self._is_closed = False
        self._fault = ""

    def store(self, record: Record) -> None:
        """Write the record soon; a later one replaces it."""
        self._begin(record)

    async def write(self, record: Record) -> str:
        """Write the record, or a later one; why it could not be written, empty if it is on disk.

        It returns after one try; later tries follow without the caller.
        """
        return await asyncio.shield(self._begin(record))

    async def is_written(self, seconds: float) -> bool:
        """True once all records are on the disk; False after `seconds`, or while writes fail."""
        if self._last is None or self._fault or not self.is_busy:
            return not self.is_busy
        with suppress(TimeoutError):
            return not await asyncio.wait_for(asyncio.shield(self._last), seconds)
        return False

    async def close(self) -> None:
        """Wait until the newest record is on the disk, or could not be written once more."""
        self._is_closed = True
        self._asked.set()
        if self._task is not None:
            await self._task

    @property
    def is_busy(self) -> bool:
        """True while the newest record is not on the disk."""
        return self._task is not None and not self._task.done()

    def _begin(self, record: Record) -> asyncio.Future[str]:
        loop = asyncio.get_running_loop()
        self._newest = record
        self._asked.set()
        if self._tried is None:
            self._tried = self._last = loop.create_future()
        if not self.is_busy:
            self._task = loop.create_task(self._run())
            self._task.add_done_callback(_raise)
        return self._tried

    async def _run(self) -> None:
        """Write until the newest record is on the disk."""
        while True:
            self._asked.clear()
            tried, self._tried = self._tried, None
            fault = await asyncio.to_thread(self._try, self._newest)
            if fault != self._fault:
                self._fault = fault
                self._on_event(
                    f"{self._path} cannot be written ({fault}): kept in memory only"
                    if fault
                    else f"{self._path} can be written again"
                )
            if tried is not None:
                tried.set_result(fault)
            if self._tried is not None:
                continue
            if not fault or self._is_closed:
                return
            with suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), RETRY_PERIOD)

    def _try(self, record: Record) -> str:
        try:
            self._write(record)
        except OSError as error:
            return error.strerror or str(error)
        return ""


def _raise(task: asyncio.Task[None]) -> None:
    """Hand what `write` raised beside OSError to the loop's handler of exceptions."""
    if not task.cancelled():
        task.result()

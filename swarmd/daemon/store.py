"""The files of a robot: latches, goals with labels, stop counters, pushed patterns.

Each file is whole or absent, also after a power cut. In the state folder of one robot::

    latches                                    emergency stops; written before their ack
    goal                                       goals and labels
    stops                                      counters of stops that were heard
    patterns/record                            the signed manifests of the swarm, and the versions
    patterns/code/<name>/<sha256>/<name>.py    a pushed pattern of one file
    patterns/code/<name>/<sha256>/code.whl     a wheel
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import shutil
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.clock import clock_id
from swarmd.core.codec import MAX_CONTROL, Decoder, encode
from swarmd.core.errors import CodecError, PluginError
from swarmd.core.files import read_regular, sync_folder, write_fault, write_whole
from swarmd.core.messages import Latch
from swarmd.core.pattern_manifest import Manifests, PatternManifest, read_table
from swarmd.pattern_host.wheel import inspect_wheel
from swarmd.plugins import IN_WHEEL
from swarmd.robot.latches import LatchRecord
from swarmd.robot.pushed_pattern import PushedPattern

log = logging.getLogger(__name__)

RETRY_PERIOD = 5.0  # s between two tries to write a record

T = TypeVar("T", bound=Struct)


class StateFile(Generic[T]):
    """A file that contains one record of the type `kind`.

    `lost`: the consequence of an unreadable file, for the log. `limit`: the most bytes to read.
    """

    def __init__(self, path: Path, kind: type[T], lost: str, limit: int = MAX_CONTROL) -> None:
        self.path = path
        self._kind = kind
        self._lost = lost
        self._decode = Decoder(kind, limit)
        self._written: T | None = None

    def read(self) -> T:
        """The record that was written last; an empty record without a file."""
        try:
            return self._decoded(read_regular(self.path))
        except FileNotFoundError:
            return self._kind()
        except (OSError, CodecError) as error:
            log.warning("%s cannot be read (%s): %s", self.path, error, self._lost)
            return self._unreadable(error)

    def write(self, record: T) -> None:
        """Write the record and wait until it is on disk. OSError if that fails.

        An unchanged record is not written again: an operator sends copies of an estop by each link.
        """
        if record != self._written:
            self._written = None  # after a failed write the content of the file is unknown
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, encode(record))
            self._written = record

    def _decoded(self, content: bytes) -> T:
        return self._decode(content)

    def _unreadable(self, error: Exception) -> T:
        return self._kind()


class LatchFile(StateFile[LatchRecord]):
    """The file `latches` in a robot's state folder, which the daemon writes on its loop.

    A latch (a held emergency stop) is on disk before the stop is acknowledged. The robot stops
    before the write, so that a slow disk delays no stop. An unreadable file counts as a latch.

    The ages of latches go on over a restart of the daemon by the clock of the machine. After a
    restart of the machine they are not known.

    `fault`: why a restart would lose the present latches; empty if a restart would keep them.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / "latches", LatchRecord, "estopped until reset")
        self._unwritten: LatchRecord | None = None
        self.fault = ""

    def read(self) -> LatchRecord:
        """The record that was written last, with its times on the present clock of the machine."""
        record = super().read()
        if record.clock != clock_id():  # the machine was restarted: its clock began anew
            record = replace(record, since={})
        return replace(record, clock="")

    def write(self, record: LatchRecord) -> None:
        """Write the record with the clock of its times. OSError if that fails."""
        super().write(replace(record, clock=clock_id()))

    def check(self) -> bool:
        """Write a record that failed before, else test the folder; True if `fault` changed."""
        before = self.fault
        if self._unwritten is not None:
            self.store(self._unwritten)
        else:
            why = write_fault(self.path.parent)
            self.fault = f"{self.path.parent} cannot be written ({why})" if why else ""
        return self.fault != before

    def store(self, record: LatchRecord) -> bool:
        """Write the record on the calling thread; False, with a log line, if that fails."""
        try:
            self.write(record)
        except OSError as error:
            if not self.fault:
                log.error("%s cannot be written (%s): latched in memory only", self.path, error)
            self._unwritten = record
            self.fault = f"{self.path.parent} cannot be written ({error.strerror})"
            return False
        self._unwritten = None
        self.fault = ""
        return True

    def _unreadable(self, error: Exception) -> LatchRecord:
        reason = f"{self.path.name} could not be read: {error}"
        latch = Latch(issuer="swarmd", scope="robots", reason=reason[:300])
        return LatchRecord(held={"unreadable": latch})


class RecordWriter(Generic[T]):
    """Writes the newest record of `file` in a thread, since a disk may take seconds.

    After a failure the newest record is written again every RETRY_PERIOD. `on_event` takes a line
    for the log at the first failure, and at the next success. Call all methods on the loop.
    """

    def __init__(self, file: StateFile[T], on_event: Callable[[str], None]) -> None:
        self._file = file
        self._on_event = on_event
        self._newest: T
        self._tried: asyncio.Future[str] | None = None  # the result of the next try
        self._last: asyncio.Future[str] | None = None  # the result of the try of the newest record
        self._task: asyncio.Task[None] | None = None
        self._asked = asyncio.Event()  # there is a newer record, or the writer closes
        self._is_closed = False
        self._fault = ""

    def store(self, record: T) -> None:
        """Write the record soon; a later record replaces it."""
        self._begin(record)

    async def write(self, record: T) -> str:
        """Write the record, or a later record; returns why the try failed, empty if it is on disk.

        Returns after one try; the writer makes later tries by itself.
        """
        return await asyncio.shield(self._begin(record))

    async def is_written(self, seconds: float) -> bool:
        """True once all records are on disk; False after `seconds`, or while writes fail."""
        if self._last is None or self._fault or not self.is_busy:
            return not self.is_busy
        with suppress(TimeoutError):
            return not await asyncio.wait_for(asyncio.shield(self._last), seconds)
        return False

    async def close(self) -> None:
        """Wait until the newest record is on disk, or one more try has failed."""
        self._is_closed = True
        self._asked.set()
        if self._task is not None:
            await self._task

    @property
    def is_busy(self) -> bool:
        """True while the newest record is not on disk."""
        return self._task is not None and not self._task.done()

    def _begin(self, record: T) -> asyncio.Future[str]:
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
        """Write until the newest record is on disk."""
        while True:
            self._asked.clear()
            tried = self._tried
            self._tried = None
            fault = await asyncio.to_thread(self._try, self._newest)
            if fault != self._fault:
                self._fault = fault
                self._on_event(
                    f"{self._file.path} cannot be written ({fault}): kept in memory only"
                    if fault
                    else f"{self._file.path} can be written again"
                )
            if tried is not None:
                tried.set_result(fault)
            if self._tried is not None:
                continue
            if not fault or self._is_closed:
                return
            with suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), RETRY_PERIOD)

    def _try(self, record: T) -> str:
        try:
            self._file.write(record)
        except OSError as error:
            return error.strerror or str(error)
        return ""


def _raise(task: asyncio.Task[None]) -> None:
    """Raise an exception of the writer task (not OSError) to the loop's exception handler."""
    if not task.cancelled():
        task.result()


CODE = "code"
WHEEL = "code.whl"

MAX_CODE_RECORD = 16 * 1024 * 1024  # bytes


class CodeRecord(Struct, frozen=True):
    """The signed manifests of the swarm, and by name the versions on this robot."""

    table: Manifests = ()
    versions: dict[str, PushedPattern] = {}


class PatternFiles(StateFile[CodeRecord]):
    """The folder of the pushed patterns of one robot; made at the first write."""

    def __init__(self, folder: Path) -> None:
        lost = "pushed patterns are pulled again"
        super().__init__(folder / "record", CodeRecord, lost, MAX_CODE_RECORD)
        self.folder = folder

    def _decoded(self, content: bytes) -> CodeRecord:
        record = super()._decoded(content)
        read_table(record.table)  # CodecError if a manifest cannot be read
        return record

    def add(self, manifest: PatternManifest, code: bytes) -> None:
        """Write the code of a manifest. PluginError if the code differs from it, OSError."""
        if len(code) != manifest.size or hashlib.sha256(code).digest() != manifest.digest:
            raise PluginError(f"{manifest.label}: the code has not the SHA-256 of its manifest")
        folder = self._folder_of(manifest.name, manifest.digest)
        partial = folder.with_name(f".{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            if manifest.kind == "file":
                write_whole(partial / f"{manifest.name}.py", code)
            else:
                found = inspect_wheel(code, manifest.label)
                if (found.name, found.value) != (manifest.name, manifest.value):
                    raise PluginError(f"{manifest.label} is a wheel of {found.name}")
                write_whole(partial / WHEEL, code)
            shutil.rmtree(folder, ignore_errors=True)
            partial.rename(folder)
            for above in (folder.parent, self.folder / CODE, self.folder):
                sync_folder(above)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise

    def code(self, name: str, digest: bytes) -> bytes | None:
        """The code of a version; None if missing or damaged."""
        folder = self._folder_of(name, digest)
        for path in (folder / f"{name}.py", folder / WHEEL):
            with suppress(OSError):
                content = read_regular(path)
                return content if hashlib.sha256(content).digest() == digest else None
        return None

    def place(self, manifest: PatternManifest) -> tuple[str, bool]:
        """The place of the code for a pattern host: path or `WHEEL//module:Class`; is a path."""
        folder = self._folder_of(manifest.name, manifest.digest)
        if manifest.kind == "file":
            return str(folder / f"{manifest.name}.py"), True
        return f"{folder / WHEEL}{IN_WHEEL}{manifest.value}", False

    def prune(self, kept: Collection[tuple[str, bytes]]) -> None:
        """Remove all code except the names and digests in `kept`."""
        folders = {self._folder_of(name, digest) for name, digest in kept}
        with suppress(OSError):
            for one in (self.folder / CODE).glob("*/*"):
                if one.is_dir() and one not in folders:
                    shutil.rmtree(one, ignore_errors=True)
                    with suppress(OSError):
                        one.parent.rmdir()

    def _folder_of(self, name: str, digest: bytes) -> Path:
        return self.folder / CODE / name / digest.hex()

"""The audit log of one robot: JSON lines in its state folder, written by a thread.

`audit.jsonl` is the newest file. At MAX_BYTES it becomes `audit.1.jsonl`, and so on; the oldest of
FILES is removed. The loop only puts entries into a bounded queue. A power cut may lose the entries
of the last seconds, since files are not synced to the disk for each.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from swarmd.core.verbs import AuditEntry, AuditQuery

MAX_BYTES = 1 << 20
FILES = 4
MAX_PENDING = 256
CLOSE_TIMEOUT = 1.0  # s that the end of the daemon waits for the disk

log = logging.getLogger(__name__)
_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder(AuditEntry)


class AuditLog:
    """The files in `folder`. `on_event` takes a line, on the thread, when the disk fails and later.

    `max_bytes` of a file.
    """

    def __init__(
        self, folder: Path, on_event: Callable[[str], None], *, max_bytes: int = MAX_BYTES
    ) -> None:
        self._folder, self._on_event, self._max_bytes = folder, on_event, max_bytes
        self._queue: queue.Queue[AuditEntry | None] = queue.Queue(MAX_PENDING)
        self._lock = threading.Lock()  # of the files
        self._thread: threading.Thread | None = None
        self._seq: int | None = None
        self._unqueued = self._unwritten = self._told = 0  # entries; counted by loop and thread
        self.fault = ""

    def add(self, entry: AuditEntry) -> None:
        """Write an entry soon, with its number; never blocks. A full queue drops it, counted."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="swarmd-audit", daemon=True)
            self._thread.start()
        try:
            self._queue.put_nowait(entry)
        except queue.Full:
            self._unqueued += 1

    def close(self) -> None:
        """Write what is queued, for CLOSE_TIMEOUT at most."""
        if self._thread is not None:
            with suppress(queue.Full):
                self._queue.put_nowait(None)
            self._thread.join(CLOSE_TIMEOUT)

    def read(
        self, query: AuditQuery, age_of: Callable[[AuditEntry], float | None]
    ) -> tuple[list[AuditEntry], bool]:
        """The entries of a query, the oldest first, and whether older ones fit; from a thread.

        `since` leaves out entries that are older, or of unknown age. Damaged lines are left out.
        """
        found: list[AuditEntry] = []
        with self._lock:
            for entry in self._newest_first():
                if query.before is not None and entry.seq >= query.before:
                    continue
                age = age_of(entry)
                if query.since is not None and (age is None or age > query.since):
                    continue
                if len(found) == query.count:
                    return found[::-1], True
                found.append(entry)
        return found[::-1], False

    # On the thread

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            with self._lock:
                self._write(entry)

    def _write(self, entry: AuditEntry) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if self._seq is None:
                self._seq = next((one.seq for one in self._newest_first()), 0)
            lost = self._unqueued + self._unwritten - self._told
            entry = replace(entry, seq=self._seq + 1, left_out=entry.left_out + lost)
            self._append(_encoder.encode(entry) + b"\n")
        except OSError as error:
            self._unwritten += 1
            if not self.fault:
                self.fault = f"audit log {self._path(0)} cannot be written ({error.strerror})"
                self._on_event(self.fault)
            return
        self._seq += 1
        self._told += lost
        if self.fault:
            self.fault = ""
            self._on_event(f"audit log is written again; {lost} entries were lost")

    def _append(self, line: bytes) -> None:
        """Append a line, whole or not at all."""
        path = self._path(0)
        if path.exists() and path.stat().st_size + len(line) > self._max_bytes:
            for number in range(FILES - 1, 0, -1):
                with suppress(FileNotFoundError):
                    self._path(number - 1).replace(self._path(number))
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            size = os.fstat(file).st_size
            if os.write(file, line) != len(line):
                os.ftruncate(file, size)
                raise OSError(28, "No space left on device")
        finally:
            os.close(file)

    def _newest_first(self) -> Iterator[AuditEntry]:
        for number in range(FILES):
            try:
                lines = self._path(number).read_bytes().splitlines()
            except OSError:
                continue
            for line in reversed(lines):
                with suppress(msgspec.MsgspecError):
                    yield _decoder.decode(line)

    def _path(self, number: int) -> Path:
        return self._folder / (f"audit.{number}.jsonl" if number else "audit.jsonl")

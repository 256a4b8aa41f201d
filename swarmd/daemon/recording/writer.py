"""Writes the recording of one robot: MCAP files that survive a kill and a power cut.

A file has chunks of CHUNK bytes. The writer writes a chunk to disk (fsync) as soon as the chunk is
full or `chunk_time` old, so that a power cut loses at most one chunk. The writer begins a new file
after a size or an age, and writes an index beside each finished file. Each file can be read alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

from mcap.writer import CompressionType, Writer

from swarmd.core.files import sync_folder, whole_file
from swarmd.daemon.recording.cdr import Message
from swarmd.daemon.recording.messages import definition
from swarmd.daemon.recording.reader import crc_of
from swarmd.settings.file_limits import FileLimits

CHUNK = 32 * 1024
"""Bytes of a chunk before compression."""
CHUNK_TIME = 2.0
"""Seconds after which a chunk is written although it is not full."""
PROFILE = "ros2"
METADATA = "swarmd"


class Channels:
    """The channels of a file; each is registered with its type at its first message."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def id_of(self, topic: str, kind: str) -> int:
        """The number of a topic's channel, whose messages are of type `kind`."""
        if topic not in self._channels:
            if kind not in self._schemas:
                schema = self._writer.register_schema(kind, "ros2msg", definition(kind))
                self._schemas[kind] = schema
            channel = self._writer.register_channel(topic, "cdr", self._schemas[kind])
            self._channels[topic] = channel
        return self._channels[topic]


class RecordingWriter:
    """Writes `<folder>/<name>-<number>.mcap`; not for several threads.

    `about`: texts on the robot, which each file repeats. `latched`: topics whose last message is
    repeated at the start of each file. `chunk_time`: s of the messages. `limits` apply to the files
    of this name in the folder: the oldest files are removed when a new file begins. After an
    OSError (the disk fails) the caller must call `abandon`.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        about: Mapping[str, str],
        *,
        limits: FileLimits = FileLimits(),  # noqa: B008
        latched: frozenset[str] = frozenset(),
        chunk_time: float = CHUNK_TIME,
    ) -> None:
        self._folder = folder
        self._name = name
        self._about = dict(about)
        self._limits = limits
        self._max_age = round(limits.file_seconds * 1e9)
        self._latched_topics = latched
        self._chunk_time = chunk_time
        self._latched: dict[str, Message] = {}
        self._number = 0
        self._file: IO[bytes] | None = None
        self.path: Path | None = None
        self.total = 0
        self.dropped = 0
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, topic: str, message: Message, at: int, sequence: int = 0) -> None:
        """Add a message at `at` ns since 1970."""
        if self._file is not None and self._is_full(at):
            self.close()
        if self._file is None:
            self._open(at)
        if topic in self._latched_topics:
            self._latched[topic] = message
        self._write(topic, message, at, sequence)
        self.flush_if_due(at)

    def flush_if_due(self, at: int) -> None:
        """Write the added messages if the chunk is full or `chunk_time` old."""
        if self._file is None or not self._pending:
            return
        if at - self._written_at >= self._chunk_time * 1e9 or self._pending >= CHUNK:
            self.flush(at)

    def flush(self, at: int) -> None:
        """Write the added messages to disk, as a chunk."""
        if self._file is None:
            return
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._file.fileno())
        self._size = self._file.tell()
        self._written_at = at
        self._pending = 0

    def close(self) -> None:
        """Finish the present file, and write its index beside it as JSON.

        Nothing without an open file. The next message begins another file.
        """
        if self._file is None or self.path is None:
            return
        file = self._file
        self._file = None
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            file.flush()
            os.fsync(file.fileno())
            size = file.tell()
        finally:
            file.close()
        self.total += size
        self._write_index(self.path, size)
        self.dropped = 0  # the count is of one file

    def _write_index(self, path: Path, size: int) -> None:
        """Write the index of the file `path`, which is on disk, and has `size` bytes."""
        index = {
            "file": path.name,
            "bytes": size,
            "crc32": crc_of(path),
            "begin_ns": self._begin,
            "end_ns": self._end,
            "messages": self._counts,
            "dropped": self.dropped,
            "about": self._about,
        }
        with whole_file(path.with_suffix(".index.json")) as partial:
            partial.write_text(json.dumps(index, indent=1) + "\n")

    def abandon(self) -> None:
        """Close the file without its end and index."""
        if self._file is not None:
            file = self._file
            self._file = None
            with suppress(OSError):
                file.close()

    @property
    def written(self) -> int:
        """The bytes of all files so far."""
        return self.total + (0 if self._file is None else self._file.tell())

    def _is_full(self, at: int) -> bool:
        size = self._size + self._pending
        return size >= self._limits.file_bytes or at - self._begin >= self._max_age

    def _open(self, at: int) -> None:
        self._remove_oldest()
        self.path = self._unused()
        self._file = self.path.open("xb")
        self._writer = Writer(self._file, chunk_size=2**31, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, "swarmd")
        self._channels = Channels(self._writer)
        self._counts: dict[str, int] = {}
        self._begin = at
        self._end = at
        self._written_at = at
        self._pending = 0
        self._size = 0
        self._writer.add_metadata(METADATA, {**self._about, "file": str(self._number)})
        sync_folder(self._folder)
        for topic, message in self._latched.items():
            self._write(topic, message, at, 0)

    def _write(self, topic: str, message: Message, at: int, sequence: int) -> None:
        kind, payload = message
        channel = self._channels.id_of(topic, kind)
        self._writer.add_message(channel, at, payload, at, sequence & 0xFFFFFFFF)
        self._counts[topic] = self._counts.get(topic, 0) + 1
        self._end = max(self._end, at)
        self._pending += len(payload) + 31

    def _remove_oldest(self) -> None:
        files = sorted(self._folder.glob(f"{self._name}-*.mcap"))
        sizes = [path.stat().st_size for path in files]
        while files and sum(sizes) + self._limits.file_bytes > self._limits.keep_bytes:
            oldest = files.pop(0)
            sizes.pop(0)
            oldest.unlink()
            oldest.with_suffix(".index.json").unlink(missing_ok=True)

    def _unused(self) -> Path:
        """The path of the next file, with a number above all present files."""
        taken = [path.stem.rpartition("-")[2] for path in self._folder.glob(f"{self._name}-*.mcap")]
        last = max((int(number) for number in taken if number.isdecimal()), default=0)
        self._number = max(self._number, last) + 1
        return self._folder / f"{self._name}-{self._number:05d}.mcap"

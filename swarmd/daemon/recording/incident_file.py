"""The file of an incident on a robot, and the recording (MCAP) that a fetched one becomes.

A file is its head as MessagePack, preceded by the size of the head, then the frames of the ring,
compressed. Robots write it without the libraries for MCAP, and without work for the daemon.

A file may come from a stolen robot. What it states is bounded before anything is made of it: the
head, the bytes of the frames, and the entries. The work of a conversion rises in proportion to the
bytes of the frames.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Seconds, Stamp, Word
from swarmd.core.errors import CodecError
from swarmd.core.files import read_regular
from swarmd.core.incident import Incident, OperatorName, Wall
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.reader import MAX_RATIO, MAX_SPARE
from swarmd.daemon.recording.ring import MAX_FILE, Left, batches_of, begin_of

SUFFIX = ".incident"
MAX_HEAD = 2**20
"""Bytes of a head; a robot writes some 7 kB."""
MAX_ENTRIES = 250_000
"""Entries of a file. A robot with a lidar at 10 Hz writes 130 a second, so 80,000 in 600 s, the
longest minute that the settings take."""
_SIZE = struct.Struct("<I")


class IncidentHead(Struct, frozen=True, kw_only=True):
    """The head of a file.

    - `at`: s of the incident on the clock `clock` of the robot that keeps the file; negative if its
      machine has booted since.
    - `begin`, `end`: s on that clock between which it has entries. `missing`: why it has no others.
    - `size`: bytes of the frames before compression.
    - `about`, `boot`, `wall`, `revision`: as in `Left`. `operator`, `source`: as in `KeptIncident`.
    """

    incident: Incident
    at: Stamp
    clock: Annotated[str, Meta(max_length=32)]
    begin: Seconds
    end: Seconds
    missing: Line = ""
    size: Annotated[int, Meta(ge=0, le=MAX_FILE)]
    about: dict[str, str]
    boot: Seconds
    wall: Wall
    revision: Count = 0
    operator: OperatorName = ""
    source: Word = ""


_DAMAGED = (ArithmeticError, IndexError, TypeError, ValueError, struct.error)
"""What values that no robot writes raise when they are converted."""
_head = msgspec.msgpack.Decoder(IncidentHead)


def pack(head: IncidentHead, content: bytes) -> bytes:
    """The bytes of a file."""
    packed = msgspec.msgpack.encode(head)
    return _SIZE.pack(len(packed)) + packed + zlib.compress(content, 1)


def read_head(data: bytes) -> IncidentHead:
    """The head of a file, from its first bytes; CodecError if it is none of this version."""
    try:
        (size,) = _SIZE.unpack_from(data)
        if size > MAX_HEAD:
            raise CodecError(f"it states a head of {size} bytes; expected {MAX_HEAD} or less")
        return _head.decode(data[_SIZE.size : _SIZE.size + size])
    except (struct.error, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise CodecError(f"no incident of this version: {error}") from error


def read(path: Path) -> tuple[IncidentHead, Left]:
    """The head and the frames of a file; CodecError or OSError if it cannot be read."""
    data = read_regular(path, MAX_FILE)
    head = read_head(data)
    most = MAX_RATIO * len(data) + MAX_SPARE
    if head.size > most:
        raise CodecError(f"{len(data)} bytes unpack to {head.size}; expected {most} or less")
    (size,) = _SIZE.unpack_from(data)
    packed = zlib.decompressobj()
    try:
        content = packed.decompress(data[_SIZE.size + size :], head.size + 1)
    except zlib.error as error:
        raise CodecError(f"damaged: {error}") from error
    if len(content) != head.size or not packed.eof:
        raise CodecError(f"it has {len(content)} bytes of frames; expected {head.size}, whole")
    return head, Left(head.about, content, head.boot, head.wall, head.revision)


def to_recording(path: Path) -> Path:
    """Write the recording of a fetched file beside it, in place of an earlier one; its path.

    CodecError or OSError if the file cannot be read or written. Needs the extra `record`.
    """
    from swarmd.daemon.recording.process import Converter  # of the extra `record`; 74 ms

    head, left = read(path)
    first = next((batch[0] for batch in batches_of(left) if batch), None)
    if first is None:
        raise CodecError("it has no entries")
    name = path.name.removesuffix(SUFFIX)
    _remove(path.parent, name)
    writer = None
    try:
        begin = begin_of(left, first.at, path.parent, name)
        converter = Converter(begin, chunk_time=math.inf)
        writer = converter.writer
        for entry in _entries(head, left):
            converter.add(entry)
        writer.close()
    except BaseException as error:
        if writer is not None:
            writer.abandon()
            _remove(path.parent, name)
        if isinstance(error, _DAMAGED):
            raise CodecError(f"damaged: {error!r:.200}") from error
        raise
    assert writer.path is not None
    return writer.path


def _entries(head: IncidentHead, left: Left) -> Iterator[frames.Entry]:
    """The entries of a file, and the incident; CodecError beyond MAX_ENTRIES.

    A robot that was killed has not noted its incident: its next daemon found it.
    """
    told = frames.TextEntry(head.at, "/incident", msgspec.json.encode(head.incident))
    is_noted = False
    count = 0
    for batch in batches_of(left):
        count += len(batch)
        if count > MAX_ENTRIES:
            raise CodecError(f"it has more than {MAX_ENTRIES} entries, which no robot writes")
        for entry in batch:
            is_noted = is_noted or (isinstance(entry, frames.TextEntry) and entry == told)
            yield entry
    if not is_noted:
        yield told


def _remove(folder: Path, name: str) -> None:
    """Remove a recording, with its index."""
    for path in folder.glob(f"{name}-*.mcap"):
        path.unlink()
        path.with_suffix(".index.json").unlink(missing_ok=True)

"""Copies the recordings of robots to this machine, and goes on where an earlier copy ended."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, NetworkError
from swarmd.core.messages import FetchQuery, FetchReply, RecordingFile, RecordingsReply

PIECE = 32768
"""Bytes of one answer."""
ASK_TIME = 10.0
"""Seconds after which a robot that does not answer is given up."""

Ask = Callable[[str, str, bytes], bytes | None]
"""Robot, name of the query and payload to the answer; None if none came."""

_recordings = Decoder(RecordingsReply, 256 * 1024)
_fetched = Decoder(FetchReply, 2 * PIECE)


class Copy(NamedTuple):
    """A file that was copied: bytes that came now, its size here, and whether it was finished."""

    path: Path
    received: int
    size: int
    is_whole: bool


def recordings_of(ask: Ask, robot: str) -> RecordingsReply:
    """The recordings of a robot; NetworkError if it does not answer."""
    answer = ask(robot, "recordings", b"")
    if answer is None:
        raise NetworkError(f"{robot} does not answer; its recordings are not known")
    try:
        return _recordings(answer)
    except CodecError as error:
        raise NetworkError(f"{robot} lists its recordings in another way: {error}") from error


def fetch(
    ask: Ask,
    robot: str,
    file: RecordingFile,
    folder: Path,
    on_progress: Callable[[int, int], None] = lambda received, size: None,
) -> Copy:
    """Copy a recording to `<folder>/<robot>/`; bytes that are there are not asked for again.

    A copy that is not whole has the ending `.partial`, and can be read as a file that was cut off.
    The recording of a robot that records on is copied up to its present end. NetworkError if the
    robot does not answer or sends damaged pieces; what came is kept.
    """
    path = folder / robot / file.name
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and path.stat().st_size >= file.size:
        return Copy(path, 0, path.stat().st_size, True)
    partial = path.with_suffix(".mcap.partial")
    received = 0
    with partial.open("ab") as copy:
        while copy.tell() < file.size:
            piece = _piece(ask, robot, file.name, copy.tell())
            if not piece:
                break
            copy.write(piece)
            received += len(piece)
            on_progress(copy.tell(), file.size)
        size = copy.tell()
    if file.is_open or size < file.size:
        return Copy(partial, received, size, False)
    partial.replace(path)
    return Copy(path, received, size, True)


def _piece(ask: Ask, robot: str, name: str, offset: int) -> bytes:
    answer = ask(robot, "fetch", encode(FetchQuery(file=name, offset=offset, length=PIECE)))
    if answer is None:
        raise NetworkError(f"{robot} does not answer; {name} has {offset} bytes here; fetch again")
    try:
        reply = _fetched(answer)
    except CodecError as error:
        raise NetworkError(f"{robot} sent a damaged piece of {name}: {error}") from error
    if reply.text:
        raise NetworkError(f"{robot}: {name}: {reply.text}")
    if (reply.file, reply.offset) != (name, offset) or zlib.crc32(reply.data) != reply.crc:
        raise NetworkError(f"{robot} sent a damaged piece of {name}; fetch again")
    return reply.data

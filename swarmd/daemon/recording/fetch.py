"""Copies the recordings of robots to this machine, and resumes incomplete copies."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import NamedTuple

import msgspec

from swarmd.core import verbs
from swarmd.core.clock import boottime, clock_id
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, NetworkError
from swarmd.core.files import read_regular
from swarmd.daemon.recording.clock_offset import Exchange
from swarmd.daemon.recording.incident_file import SUFFIX
from swarmd.daemon.recording.reader import MAX_RECORDING, crc_of
from swarmd.daemon.recording.ring import MAX_FILE

CLOCKS_FILE = "clocks.jsonl"
"""Beside fetched recordings: exchanges between the operator and the robots."""
PIECE = 32768
"""Bytes of one answer."""
MAX_NAME = 200
"""Bytes of the name of a file: file systems take 255, and `.partial` or `-other1` is added."""

Ask = Callable[[str, str, bytes], bytes | None]
"""Robot, name of the query and payload to the answer; None if none came."""

AskPiece = Callable[[int, int], verbs.FetchReply]
"""Offset and length of a piece of one file to its bytes; NetworkError without them."""


class Source(NamedTuple):
    """A kind of file on robots: the verb that gives pieces of it, and how its names end.

    `most`: bytes of a file at most; a robot that states more is not believed.
    """

    verb: str
    suffix: str
    most: int


RECORDING = Source(verbs.FETCH.name, ".mcap", MAX_RECORDING)
INCIDENT = Source(verbs.INCIDENT.name, SUFFIX, MAX_FILE)

_recordings = Decoder(verbs.RecordingsReply, 256 * 1024)
_fetched = Decoder(verbs.FetchReply, 2 * PIECE)


class Copy(NamedTuple):
    """A file that was copied from a robot."""

    path: Path
    received: int  # bytes received in this call
    size: int  # bytes of the copy
    is_whole: bool
    fault: str = ""  # why the robot refused the file, for instance a file that was removed


def recordings_of(ask: Ask, robot: str) -> verbs.RecordingsReply:
    """The recordings of a robot; NetworkError if it does not answer."""
    answer = ask(robot, verbs.RECORDINGS.name, b"")
    if answer is None:
        raise NetworkError(f"{robot} does not answer; its recordings are not known")
    try:
        return _recordings(answer)
    except CodecError as error:
        raise NetworkError(f"{robot} lists its recordings in another way: {error}") from error


def check_sizes(
    robot: str, files: Iterable[verbs.RecordingFile], folder: Path, source: Source = RECORDING
) -> None:
    """NetworkError if a robot states a size that no file of this kind has, or the disk lacks room.

    What `folder` has of the files already needs no further room.
    """
    needed = 0
    for file in files:
        if file.size > source.most:
            raise NetworkError(
                f"{robot} states {file.size} bytes for {file.name}; expected {source.most} or"
                " less; nothing of it is fetched"
            )
        needed += max(file.size - _present(folder / robot, file.name), 0)
    room = shutil.disk_usage(_existing(folder)).free
    if needed > room:
        raise NetworkError(
            f"{robot} states files of {needed} bytes; the disk of {folder} has room for {room};"
            " nothing of it is fetched; make room, or name another --folder"
        )


def _present(folder: Path, name: str) -> int:
    """The bytes that a file or its incomplete copy has in a folder."""
    sizes = [0]
    for path in (folder / name, folder / f"{name}.partial"):
        with suppress(OSError, ValueError):  # a name with a zero byte
            sizes.append(path.stat().st_size)
    return max(sizes)


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    absolute = folder.absolute()
    return next(one for one in (absolute, *absolute.parents) if one.is_dir())


def note_clock(ask: Ask, robot: str, folder: Path) -> None:
    """Append an exchange between the clocks of operator and robot to `<folder>/clocks.jsonl`.

    `record merge` uses these exchanges for robots that did not hear each other. NetworkError
    without an answer.
    """
    sent = boottime()
    reply = recordings_of(ask, robot)
    exchange = Exchange(clock_id(), reply.clock, sent, reply.now, boottime())
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / CLOCKS_FILE).open("ab") as file:
        file.write(msgspec.json.encode(exchange) + b"\n")


def read_exchanges(path: Path) -> list[Exchange]:
    """The exchanges in a file of `note_clock`; damaged lines are left out."""
    exchanges = []
    with suppress(OSError):
        for line in read_regular(path).splitlines():
            with suppress(ValueError, RecursionError):
                exchanges.append(msgspec.json.decode(line, type=Exchange))
    return exchanges


def fetch(
    ask: Ask,
    robot: str,
    file: verbs.RecordingFile,
    folder: Path,
    on_progress: Callable[[int, int], None] = lambda received, size: None,
    *,
    source: Source = RECORDING,
) -> Copy:
    """Copy a file of a robot to `<folder>/<robot>/`; present bytes are not copied again.

    `ask` queries the robot. `source`: the kind of file. `on_progress` gets the copied bytes and the
    size. An incomplete copy ends in `.partial`, and can be read like a truncated file. A file that
    the robot still writes is copied up to the size that the robot listed. NetworkError if the robot
    does not answer, sends damaged pieces or states a size that is not possible (`check_sizes`);
    OSError if the disk fails; received bytes are kept.
    """
    if not _is_name(file.name, source.suffix):
        raise NetworkError(f"{robot} lists {file.name!r}; expected the name of a recording")
    check_sizes(robot, [file], folder, source)
    ask_piece = partial(_piece, ask, source.verb, robot, file.name)
    path = folder / robot / file.name
    path.parent.mkdir(parents=True, exist_ok=True)
    incomplete = path.with_name(f"{path.name}.partial")
    for present in (path, incomplete):
        if present.exists() and not _is_part_of(present, ask_piece, file):
            present.rename(_unused(present))  # of another recording with the same name
    if path.exists():
        present_size = path.stat().st_size
        # A copy with a checksum got its name `path` only after its checksum had been compared. When
        # a daemon is killed its recorder, a process of its own, writes on for a moment. The next
        # daemon lists this file as not open and without a checksum: it may grow after its copy.
        has_grown = file.crc is None and present_size < file.size
        if not has_grown:
            return Copy(path, received=0, size=present_size, is_whole=True)
        path.rename(incomplete)
    copied = _append(ask_piece, file, incomplete, on_progress)
    if file.is_open or copied.fault:
        return copied
    if file.crc is not None and crc_of(incomplete) != file.crc:
        incomplete.unlink()
        raise NetworkError(f"{robot}: the copy of {file.name} was damaged; fetch again")
    incomplete.replace(path)
    return copied._replace(path=path, is_whole=True)


def _append(
    ask_piece: AskPiece,
    file: verbs.RecordingFile,
    incomplete: Path,
    on_progress: Callable[[int, int], None],
) -> Copy:
    """Append the missing pieces of a file to its incomplete copy."""
    received_bytes = 0
    fault = ""
    with incomplete.open("ab") as copy:
        while copy.tell() < file.size and not fault:
            length = min(PIECE, file.size - copy.tell())
            reply = ask_piece(copy.tell(), length)
            if reply.text:
                fault = reply.text
            elif len(reply.data) < length:  # also one byte an answer, which would never end
                fault = "it has become shorter"
            copy.write(reply.data)
            received_bytes += len(reply.data)
            on_progress(copy.tell(), file.size)
        size = copy.tell()
    return Copy(incomplete, received_bytes, size, is_whole=False, fault=fault)


def _is_name(name: str, suffix: str) -> bool:
    """True if the name is a plain file name here, without control characters for a terminal."""
    is_alone = Path(name).name == name and name.isprintable()
    return is_alone and name.endswith(suffix) and len(name.encode()) <= MAX_NAME


def _is_part_of(here: Path, ask_piece: AskPiece, file: verbs.RecordingFile) -> bool:
    """True if the file `here` equals the robot's file, or its beginning."""
    size = here.stat().st_size
    if size > file.size:
        return False
    if size == file.size and file.crc is not None:
        return crc_of(here) == file.crc
    length = min(size, PIECE)
    if not length:
        return True
    reply = ask_piece(0, length)
    with here.open("rb") as copy:
        return bool(reply.text) or copy.read(length) == reply.data


def _unused(path: Path) -> Path:
    name, ending = path.name.split(".", 1)
    numbers = (path.with_name(f"{name}-other{n}.{ending}") for n in count(1))
    return next(candidate for candidate in numbers if not candidate.exists())


def _piece(
    ask: Ask, verb: str, robot: str, name: str, offset: int, length: int
) -> verbs.FetchReply:
    query = verbs.FetchQuery(file=name, offset=offset, length=length)
    answer = ask(robot, verb, encode(query))
    if answer is None:
        raise NetworkError(f"{robot} does not answer; {name} has {offset} bytes here; fetch again")
    try:
        reply = _fetched(answer)
    except CodecError as error:
        raise NetworkError(f"{robot} sent a damaged piece of {name}: {error}") from error
    is_asked = (reply.file, reply.offset) == (name, offset) and len(reply.data) <= length
    if not is_asked or zlib.crc32(reply.data) != reply.crc:
        raise NetworkError(f"{robot} sent a damaged piece of {name}; fetch again")
    return reply

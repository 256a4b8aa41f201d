"""The ring of the black box: a file in RAM with the last frames of one robot.

The ring outlives its process, also one that was killed: the file is on a file system in RAM.
After a power cut nothing is left. A frame is a batch of entries, see `daemon/recording/frames.py`.

The file has a header, then `capacity` bytes, which are written in a circle, then the texts on the
robot. The header has the counts of all bytes written (`head`) and dropped (`tail`) when the header
was written. The place of a frame is the count of bytes before it. A frame is preceded by its size
and by a checksum of its place and content. So one write adds a frame, and a reader finds the frames
that no header counts: it reads on from `tail` while checksums are right. An old frame, whose bytes
are not written over yet, has another place, and so a checksum that is wrong for this one.

The ring writes the header before it writes over dropped bytes, and with the next frame after a
change of `revision` or of the clocks. So whole frames begin at `tail` at every instant.

Frames are dropped in segments. A segment begins with the memory of the robot, so that a replay can
begin there. The calls are `write`, not a mapping: if the RAM of the file system is used up, a
write fails, while a mapping would end the process.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec

from swarmd.core.errors import CodecError
from swarmd.core.files import lock_file
from swarmd.daemon.recording.frames import Begin, Entry, decode_batch
from swarmd.settings.file_limits import FileLimits

_MAGIC = b"swarmd2\0"
_MAGIC_1 = b"swarmd1\0"
"""Of a ring whose frames have no checksum: its header counts each frame."""
_HEADER = struct.Struct("<8sQQddQI")  # magic, tail, head, boot, wall, revision, capacity
_SIZE = struct.Struct("<I")
_FRAME = struct.Struct("<II")  # size of a frame, and its checksum
_PLACE = struct.Struct("<Q")
_HEADER_SIZE = 64
OLD = 86400.0
"""Seconds after which the ring of a process that does not come back is removed."""
FOREVER = 1e11
"""Seconds: more than the times of messages have, which are ns since 1970 in 64 bits."""
MAX_FILE = 1 << 26
"""Bytes of a file that are read, at most."""


class Left(msgspec.Struct, frozen=True):
    """What the ring of an earlier process has, which did not end in order.

    `frames`: whole frames, each with its size before it. `boot`, `wall`: one instant on the clock
    of the robot, and in s since 1970. `revision`: the last one noted.
    """

    about: dict[str, str]
    frames: bytes
    boot: float
    wall: float
    revision: int


class Ring:
    """Keeps the last `seconds` s of frames, within `capacity` bytes; one process writes a file.

    `about`: texts on the robot. `boot`, `wall`: the present time on the clock of the robot, and in
    s since 1970. `begin`: s at which the oldest segment begins. OSError if the file cannot be
    written, or if another process uses it.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        *,
        capacity: int,
        seconds: float,
        boot: float,
        wall: float,
    ) -> None:
        self._path = path
        self._file = _open(path)
        try:
            packed = msgspec.msgpack.encode(dict(about))
            os.ftruncate(self._file, 0)
            # The memory is taken now, so that it is not missing in the last minute.
            os.posix_fallocate(self._file, 0, _HEADER_SIZE + capacity + _SIZE.size + len(packed))
            os.pwrite(self._file, _SIZE.pack(len(packed)) + packed, _HEADER_SIZE + capacity)
        except OSError:
            os.close(self._file)
            raise
        self._capacity = capacity
        self._seconds = seconds
        self._tail = 0
        self._head = 0
        self._segments = deque[tuple[int, float]]()  # begin of each: its place, and s
        self.revision = 0
        self._written_revision = 0  # the one in the header
        self._is_header_old = True
        self.set_clock(boot, wall)
        self._write_header()

    def set_clock(self, boot: float, wall: float) -> None:
        """Note, with the next frame, what the wall clock shows at `boot` s on the robot's clock."""
        self._boot = boot
        self._wall = wall
        self._is_header_old = True

    @property
    def begin(self) -> float | None:
        """The time in s at which the oldest segment begins; None without a segment."""
        return self._segments[0][1] if self._segments else None

    @property
    def is_long(self) -> bool:
        """True if the present segment takes a third of the ring: begin another one."""
        return not self._segments or self._head - self._segments[-1][0] > self._capacity // 3

    def begin_segment(self, now: float) -> None:
        """The next frame begins a segment; drops segments that end before the last `seconds` s."""
        self._segments.append((self._head, now))
        while len(self._segments) > 1 and self._segments[1][1] <= now - self._seconds:
            self._segments.popleft()
        self._drop_to(self._segments[0][0])

    def write(self, frame: bytes) -> None:
        """Add a frame; without room, drop the oldest segments. OSError if the write fails.

        A frame without a segment is ignored.
        """
        size = _FRAME.size + len(frame)
        end = self._head + size
        while self._segments and end - self._segments[0][0] > self._capacity:
            self._segments.popleft()
        self._drop_to(self._segments[0][0] if self._segments else self._head)
        if self._is_header_old or self.revision != self._written_revision:
            self._write_header()
        if not self._segments:
            return
        data = _FRAME.pack(len(frame), _checksum(frame, self._head)) + frame
        at = self._head % self._capacity
        room = self._capacity - at
        os.pwrite(self._file, data[:room], _HEADER_SIZE + at)
        if size > room:
            os.pwrite(self._file, data[room:], _HEADER_SIZE)
        self._head = end

    def left(self) -> Left:
        """A copy of all frames; OSError, CodecError."""
        return self.reader()()

    def reader(self) -> Callable[[], Left]:
        """`left`, to be called once, in a thread: while the ring is written, or after its end."""
        return partial(_left_once, os.dup(self._file))

    def close(self, *, keeps_file: bool = True) -> None:
        """Close the file; without `keeps_file` remove it, so that a later process finds nothing."""
        if not keeps_file:
            with suppress(OSError):
                self._path.unlink()
        os.close(self._file)

    def _drop_to(self, place: int) -> None:
        """Let the frames begin at `place`, as the header says before the next frame is written."""
        self._is_header_old |= place != self._tail
        self._tail = place

    def _write_header(self) -> None:
        header = _HEADER.pack(
            _MAGIC, self._tail, self._head, self._boot, self._wall, self.revision, self._capacity
        )
        os.pwrite(self._file, header, 0)
        self._written_revision = self.revision
        self._is_header_old = False


def read_left(path: Path) -> Left | None:
    """What an earlier process has left; None without a file, and while a process uses it.

    CodecError if the file is no ring of this version.
    """
    try:
        file = _open(path, os.O_RDONLY)
    except OSError:
        return None
    return _left_once(file)


def entries_of(left: Left) -> list[Entry]:
    """The entries of all frames, up to the first one that is damaged."""
    return [entry for batch in batches_of(left) for entry in batch]


def batches_of(left: Left) -> Iterator[list[Entry]]:
    """The entries of each frame, up to the first one that is damaged."""
    data = left.frames
    at = 0
    with suppress(msgspec.MsgspecError, ValueError, RecursionError, struct.error):
        while at < len(data):
            (size,) = _SIZE.unpack_from(data, at)
            at += _SIZE.size + size
            yield decode_batch(data[at - size : at])


def begin_of(left: Left, at: float, folder: Path, name: str) -> Begin:
    """The begin of a recording of these frames in one file, whose first entry is at `at` s."""
    wall = left.wall + at - left.boot
    return Begin(at, str(folder), name, left.about, wall, FileLimits(file_seconds=FOREVER))


def ring_folder(given: str | None, environ: Mapping[str, str]) -> Path:
    """The folder for this user's rings, made if it is absent; OSError if it is not safe.

    `given`, else systemd's `RuntimeDirectory`, else `/dev/shm/swarmd-<uid>`.
    """
    service = environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    folder = Path(given or service or f"/dev/shm/swarmd-{os.geteuid()}")  # checked below
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    is_ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    if not is_ours or found.st_mode & 0o022:
        raise OSError(f"{folder} is not a folder of this user alone")
    return folder


def remove_old(folder: Path, wall: float) -> None:
    """Remove the rings in `folder` that no process has written for OLD s; `wall`: s since 1970.

    Other files stay: an operator may name any folder.
    """
    for path in folder.iterdir():
        with suppress(OSError):
            found = path.lstat()
            if not stat.S_ISREG(found.st_mode) or wall - found.st_mtime <= OLD:
                continue
            file = _open(path, os.O_RDONLY)  # no process uses it
            is_ring = os.pread(file, len(_MAGIC), 0) in (_MAGIC, _MAGIC_1)
            os.close(file)
            if is_ring:
                path.unlink()


def _open(path: Path, flags: int = os.O_RDWR | os.O_CREAT) -> int:
    """A locked file; OSError with its path if another process has locked it, or without locks."""
    # A pipe in its place is refused later, and not waited for.
    file = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
    try:
        if not lock_file(file, waits=False):
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK), str(path))
    except BlockingIOError as error:
        os.close(file)
        raise BlockingIOError(error.errno, "another process uses it", str(path)) from error
    except OSError:
        os.close(file)
        raise
    return file


def _left_once(file: int) -> Left:
    try:
        return _left(file)
    finally:
        os.close(file)


def _left(file: int) -> Left:
    data = os.pread(file, min(os.fstat(file).st_size, MAX_FILE), 0)
    try:
        magic, tail, head, boot, wall, revision, capacity = _HEADER.unpack_from(data)
        (size,) = _SIZE.unpack_from(data, _HEADER_SIZE + capacity)
        about_at = _HEADER_SIZE + capacity + _SIZE.size
        about = msgspec.msgpack.decode(data[about_at : about_at + size], type=dict[str, str])
    except (struct.error, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise CodecError(f"the black box cannot be read: {error}") from error
    if magic not in (_MAGIC, _MAGIC_1) or not 0 <= head - tail <= capacity:
        raise CodecError("the black box is of another version, or damaged")
    if _HEADER.unpack(os.pread(file, _HEADER.size, 0))[1] != tail:
        return _left(file)  # frames were written over meanwhile
    circle = memoryview(data)[_HEADER_SIZE : _HEADER_SIZE + capacity]
    begin = tail % max(capacity, 1)
    line = memoryview(b"".join((circle[begin:], circle[:begin])))  # the place of its begin: `tail`
    frames = _whole_frames(line, tail) if magic == _MAGIC else bytes(line[: head - tail])
    return Left(about, frames, boot, wall, revision)


def _whole_frames(line: memoryview, place: int) -> bytes:
    """The frames from the begin of `line` on, up to the first one that is not whole.

    `place`: that of the first byte. In the result each frame has its size before it.
    """
    frames = bytearray()
    at = 0
    while at + _FRAME.size <= len(line):
        size, checksum = _FRAME.unpack_from(line, at)
        frame = line[at + _FRAME.size : at + _FRAME.size + size]
        if len(frame) < size or _checksum(frame, place + at) != checksum:
            break
        frames += _SIZE.pack(size)
        frames += frame
        at += _FRAME.size + size
    return bytes(frames)


def _checksum(frame: bytes | memoryview, place: int) -> int:
    """A checksum of a frame and its place: equal frames at two places have two checksums."""
    return zlib.crc32(frame, zlib.crc32(_PLACE.pack(place)))

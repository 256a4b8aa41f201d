"""Reads a recording, also if it was cut off or damaged.

The MCAP library gives up at the first bad record, or reads on in a damaged one. This reader takes
each chunk whose checksum is right, and leaves out the others. It never needs the index or the
summary at the end of a file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from swarmd.core.errors import ConfigError

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 2, 3, 4, 5, 6, 12, 15
_CODES = range(1, 16)
_MAX_CHUNK = 64 * 2**20  # bytes; a chunk of ours has some 32 KiB


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message: its topic, type, time in ns since 1970, sequence and bytes."""

    topic: str
    kind: str
    at: int
    sequence: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """What a file holds. `fault`: what is missing or damaged, with its place; empty if whole.

    `about`: texts on its robot, or of a merged file on all; then `robots` are those on each robot.
    """

    path: Path
    about: Mapping[str, str]
    robots: Mapping[str, Mapping[str, str]]
    messages: list[RecordedMessage]
    fault: str


def read_file(path: Path) -> RecordedFile:
    """All that can be read of a file; ConfigError if it is no recording."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; expected a recording (.mcap)"
        ) from error
    if data[: len(MAGIC)] != MAGIC[: len(data)]:
        raise ConfigError(f"{path}: not a recording; expected an MCAP file")
    reader = _Reader(data)
    reader.read()
    return RecordedFile(path, reader.about, reader.robots, reader.messages(), reader.fault)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, int]] = {}
        self._found: list[tuple[int, int, int, bytes]] = []
        self.about: dict[str, str] = {}
        self.robots: dict[str, dict[str, str]] = {}
        self.fault = ""

    def read(self) -> None:
        """Take each record; after a damaged one go on with the next chunk that is whole."""
        data, at, is_over = self._data, len(MAGIC), False
        while at + 9 <= len(data):
            code, size = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
            end = at + 9 + size
            if code not in _CODES or end > len(data) or not self._take(code, data[at + 9 : end]):
                self._note(f"damaged or cut off at byte {at} of {len(data)}")
                at = self._next_chunk(at + 1)
                continue
            is_over = is_over or code == _DATA_END
            at = end
            if code == _FOOTER and data[at:] == MAGIC:
                return
        self._note(f"cut off at byte {len(data)}, {'with' if is_over else 'before'} its summary")

    def messages(self) -> list[RecordedMessage]:
        """The messages whose topic is known."""
        found = []
        for channel, sequence, at, payload in self._found:
            topic, schema = self._channels.get(channel, ("", 0))
            kind = self._schemas.get(schema)
            if kind is None:
                self._note(f"messages of channel {channel} without its description")
            else:
                found.append(RecordedMessage(topic, kind, at, sequence, payload))
        return found

    def _take(self, code: int, body: bytes) -> bool:
        """One record; False if it is damaged."""
        try:
            if code == _CHUNK:
                return self._take_chunk(body)
            self._record(code, body)
        except (struct.error, IndexError, UnicodeDecodeError):
            return False
        return True

    def _take_chunk(self, body: bytes) -> bool:
        data = _chunk_data(body)
        if data is None:
            return False
        place = 0
        while place + 9 <= len(data):
            size = int.from_bytes(data[place + 1 : place + 9], "little")
            self._record(data[place], data[place + 9 : place + 9 + size])
            place += 9 + size
        return True

    def _record(self, code: int, body: bytes) -> None:
        if code == _MESSAGE:
            channel, sequence, at, _ = struct.unpack_from("<HIQQ", body)
            self._found.append((channel, sequence, at, body[22:]))
        elif code == _SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            # The first one wins: those of chunks have a checksum, those of the summary have none.
            self._schemas.setdefault(number, _string(body, 2)[0])
        elif code == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, _ = _string(body, 4)
            self._channels.setdefault(number, (topic, schema))
        elif code == _METADATA:
            name, place = _string(body, 0)
            if name == "swarmd":
                self.about.update(_map(body, place))
            elif name.startswith("swarmd/"):
                self.robots.setdefault(name.partition("/")[2], {}).update(_map(body, place))

    def _next_chunk(self, at: int) -> int:
        """The first byte from `at` on where a whole chunk begins; the end if there is none."""
        data = self._data
        while (at := data.find(_CHUNK, at)) >= 0:
            size = int.from_bytes(data[at + 1 : at + 9], "little")
            if 40 <= size <= _MAX_CHUNK and at + 9 + size <= len(data):
                with suppress(struct.error, UnicodeDecodeError):
                    if _chunk_data(data[at + 9 : at + 9 + size]):
                        return at
            at += 1
        return len(data)

    def _note(self, fault: str) -> None:
        self.fault = self.fault or fault


def _chunk_data(body: bytes) -> bytes | None:
    """The records of a chunk; None if it is damaged. Its checksum is that of the records."""
    size, crc, length = struct.unpack_from("<QII", body, 16)
    compression = body[32 : 32 + length].decode()
    packed = body[40 + length :]
    if size > _MAX_CHUNK or compression not in ("", "zstd"):
        return None
    data = _decompressed(packed, size) if compression else packed
    if data is None or len(data) != size or zlib.crc32(data) != crc:
        return None
    return data


def _decompressed(packed: bytes, size: int) -> bytes | None:
    """The bytes; None if they are damaged, or not `size` by their own head.

    The library would take memory for whatever size the head states.
    """
    import zstandard  # of the extra `record`, which a daemon may lack

    try:
        stated = zstandard.get_frame_parameters(packed).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            return None
        return zstandard.decompress(packed, size)
    except zstandard.ZstdError:
        return None


def _string(body: bytes, place: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, place)
    end = place + 4 + size
    if end > len(body):
        raise IndexError("a text beyond its record")
    return body[place + 4 : end].decode(), end


def _map(body: bytes, place: int) -> Mapping[str, str]:
    (size,) = struct.unpack_from("<I", body, place)
    place, end, found = place + 4, place + 4 + size, {}
    while place < end:
        key, place = _string(body, place)
        found[key], place = _string(body, place)
    return found


def clock_of(about: Mapping[str, str], at: int) -> float:
    """The time on the robot's clock in s of a time `at` in ns of its recording.

    To the bit what `boottime` gave: a deadline of the robot falls into the same tick again.
    ConfigError if the recording does not tell its clock: these texts have no checksum.
    """
    try:
        return (at - int(about["wall_ns"]) + int(about["boot_ns"])) / 1e9
    except (KeyError, ValueError) as error:
        raise ConfigError(
            f"the recording does not tell its clock ({error!r}); expected wall_ns and boot_ns in"
            " its metadata, which may be damaged"
        ) from error


def crc_of(path: Path) -> int:
    """The CRC-32 of a file; OSError if it cannot be read."""
    crc = 0
    with path.open("rb") as file:
        while part := file.read(2**20):
            crc = zlib.crc32(part, crc)
    return crc

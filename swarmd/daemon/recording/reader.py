"""Reads a recording (MCAP), also if the file was cut off or damaged.

The MCAP library gives up at the first bad record, or reads on inside a damaged record. This reader
takes each chunk whose checksum is right or absent, and leaves out all other chunks. It never needs
the index or the summary at the end of a file. A recording may come from a stolen robot: chunks are
unpacked one by one, up to MAX_RATIO times the size of the file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from swarmd.core.errors import ConfigError
from swarmd.core.files import open_regular, read_regular

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORDING = 1 << 32
"""Bytes of the largest file that is read; a robot writes 64 MiB unless told otherwise."""
MAX_RATIO = 50
"""Bytes of a file's records, and of the objects made of them, to those of the file. A recording has
a ratio of 9 to 20, the highest at rest."""
MAX_SPARE = 2**20
"""Bytes beyond this ratio, for a file of a few bytes."""
# Record codes.
_FOOTER = 2
_SCHEMA = 3
_CHANNEL = 4
_MESSAGE = 5
_CHUNK = 6
_STATISTICS = 11
_METADATA = 12
_DATA_END = 15
_ABOUT = struct.Struct("<HIQQ")  # channel, sequence and times of a message
_HEAD = struct.Struct("<BQ")  # the code of a record and the size of its content
_CHUNK_HEAD = struct.Struct("<QQQI")  # times of a chunk; size and checksum of its records
_KNOWN = range(1, 16)  # record codes; greater codes are permitted and skipped, 0 is not
_COMPRESSIONS = ("", "lz4", "zstd")
_OBJECT = 200  # bytes of the Python objects for a record


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message: its topic, type, time in ns since 1970, sequence and bytes.

    `kind`: the message type; empty without a schema. The name of an encoding other than CDR is
    appended. `follows_gap`: messages between the message before and this one may be missing.
    """

    topic: str
    kind: str
    at: int
    sequence: int
    payload: bytes
    follows_gap: bool = field(default=False, compare=False)


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """The content of a recording file. `fault`: what is missing or damaged; empty if nothing is.

    `about`: texts on the robot. In a merged file `about` concerns all robots, and `robots` has the
    texts on each robot.
    """

    path: Path
    about: Mapping[str, str]
    robots: Mapping[str, Mapping[str, str]]
    messages: list[RecordedMessage]
    fault: str


def read_file(path: Path) -> RecordedFile:
    """Read the undamaged content of a file.

    ConfigError if the file is no recording, or unpacks to more than MAX_RATIO times its size.
    """
    try:
        data = read_regular(path, MAX_RECORDING)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; expected a recording (.mcap)"
        ) from error
    if data[: len(MAGIC)] != MAGIC[: len(data)]:
        raise ConfigError(f"{path}: not a recording; expected an MCAP file")
    reader = _Reader(data)
    try:
        reader.read()
    except _BeyondRatioError as error:
        raise ConfigError(
            f"{path}: {error}; expected a recording, of which {len(data)} bytes unpack to"
            f" {MAX_RATIO * len(data) + MAX_SPARE} or less"
        ) from error
    return RecordedFile(path, reader.about, reader.robots, reader.messages(), reader.fault)


class _BeyondRatioError(Exception):
    """A file unpacks to more than MAX_RATIO times its size."""


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self._whole = data
        self._left = MAX_RATIO * len(data) + MAX_SPARE
        self._work = 4 * self._left  # budget of bytes to examine, also in false chunks
        self._schemas: dict[int, str] = {0: ""}
        self._channels: dict[int, tuple[str, int, str]] = {}
        # Channel, sequence, time, bytes, and whether damaged bytes are before the message.
        self._found: list[tuple[int, int, int, bytes, bool]] = []
        self._is_behind_gap = False
        self._count: int | None = None  # count of messages, as the summary states
        self.about: dict[str, str] = {}
        self.robots: dict[str, dict[str, str]] = {}
        self.fault = ""

    def read(self) -> None:
        """Take each record; after a damaged record continue at the next whole chunk."""
        data = self._data
        at = len(MAGIC)
        is_over = False
        while at + _HEAD.size <= len(data):
            code, end = self._record_at(at)
            if not code or not self._take(code, data[at + _HEAD.size : end]):
                self._note(f"damaged or cut off at byte {at} of {len(data)}")
                at = self._next_chunk(at + 1)
                self._is_behind_gap = True
                continue
            is_over = is_over or code == _DATA_END
            at = end
            if code == _FOOTER and data[at:] == MAGIC:
                if self._count not in (None, len(self._found)):
                    self._note(f"it states {self._count} messages and has {len(self._found)}")
                return
        self._note(f"cut off at byte {len(data)}, {'with' if is_over else 'before'} its summary")

    def messages(self) -> list[RecordedMessage]:
        """The messages whose topic is known."""
        messages = []
        for channel, sequence, at, payload, gap in self._found:
            topic, schema, encoding = self._channels.get(channel, ("", -1, ""))
            kind = self._schemas.get(schema)
            if kind is None:
                self._note(f"messages of channel {channel} without its description")
            else:
                kind += "" if encoding in ("cdr", "") else f" in {encoding}"
                messages.append(RecordedMessage(topic, kind, at, sequence, payload, gap))
        return messages

    def _record_at(self, at: int) -> tuple[int, int]:
        """The code and the end of the record at the byte `at`; code 0 if no record is there."""
        data = self._data
        code, _, end = next(_records(data, at), (0, 0, 0))
        # In a damaged file arbitrary bytes may look like a record of an unknown code.
        is_known = code in _KNOWN or data[end:] == MAGIC or any(_records(data, end))
        return (code, end) if is_known else (0, 0)

    def _keep(self, size: int) -> None:
        """Count bytes that are kept in memory."""
        self._left -= size
        if self._left < 0:
            raise _BeyondRatioError("it unpacks to more bytes than a file of its size may")

    def _take(self, code: int, body: memoryview) -> bool:
        """One record; False if it is damaged."""
        try:
            if code == _CHUNK:
                return self._take_chunk(body)
            self._keep(_OBJECT)
            self._record(code, body)
        except (struct.error, IndexError, UnicodeDecodeError):
            return False
        return True

    def _take_chunk(self, body: memoryview) -> bool:
        compression = _string(body, _CHUNK_HEAD.size)[0]
        if compression not in _COMPRESSIONS:
            self._note(f"chunks are compressed by {compression[:40]!r}; expected none, lz4 or zstd")
            return True
        records = self._chunk_data(body)
        if records is None:
            return False
        self._keep(len(records) + _OBJECT * sum(1 for _ in _records(records)))
        for code, begin, end in _records(records):
            self._record(code, records[begin:end])
        return True

    def _record(self, code: int, body: memoryview) -> None:
        if code == _MESSAGE:
            channel, sequence, at, _ = _ABOUT.unpack_from(body)
            self._found.append(
                (channel, sequence, at, bytes(body[_ABOUT.size :]), self._is_behind_gap)
            )
            self._is_behind_gap = False
        elif code == _SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            # The first record counts: records in chunks have a checksum, the summary's have none.
            self._schemas.setdefault(number, _string(body, 2)[0])
        elif code == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, place = _string(body, 4)
            self._channels.setdefault(number, (topic, schema, _string(body, place)[0]))
        elif code == _STATISTICS:
            (self._count,) = struct.unpack_from("<Q", body)
        elif code == _METADATA:
            name, place = _string(body, 0)
            if name == "swarmd":
                self.about.update(_map(body, place))
            elif name.startswith("swarmd/"):
                self.robots.setdefault(name.partition("/")[2], {}).update(_map(body, place))

    def _next_chunk(self, at: int) -> int:
        """The first byte from `at` on at which a whole chunk begins; the end of file without."""
        data = self._data
        while (at := self._whole.find(_CHUNK, at)) >= 0:
            begin = at + _HEAD.size  # of the content of the record, if a chunk begins at `at`
            size = int.from_bytes(data[at + 1 : begin], "little")
            if size >= 40 and begin + size <= len(data):
                with suppress(struct.error, IndexError, UnicodeDecodeError):
                    records = self._chunk_data(data[begin : begin + size])
                    if records and all(code in _KNOWN for code, *_ in _records(records)):
                        return at
            at += 1
        return len(data)

    def _chunk_data(self, body: memoryview) -> memoryview | None:
        """The unpacked records of a chunk, checked by the checksum; None if damaged."""
        _, _, size, crc = _CHUNK_HEAD.unpack_from(body)
        compression, place = _string(body, _CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", body, place)
        packed = body[place + 8 :]
        if len(packed) != length or compression not in _COMPRESSIONS:
            return None
        if _stated_size(packed, compression) not in (size, None):
            return None
        self._work -= size
        if size > self._left or self._work < 0:
            raise _BeyondRatioError("it unpacks to more bytes than a file of its size may")
        data = _unpacked(packed, compression, size)
        if data is None or len(data) != size or (crc and zlib.crc32(data) != crc):
            return None
        records = memoryview(data)
        whole = max((end for *_, end in _records(records)), default=0)
        return records if whole == size else None

    def _note(self, fault: str) -> None:
        self.fault = self.fault or fault


def _records(data: memoryview, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """(code, begin, end of content) of each record, up to the first truncated record."""
    size = len(data)
    while at + 9 <= size:
        code, length = _HEAD.unpack_from(data, at)
        begin = at + 9
        at = at + 9 + length
        if at > size or not code:
            return
        yield code, begin, at


def _stated_size(packed: memoryview, compression: str) -> int | None:
    """The unpacked size in bytes that a chunk states; None: unknown, -1: damaged.

    The decompression libraries would allocate any stated size.
    """
    if compression == "zstd":
        import zstandard  # in the extra `record`, which a daemon may lack

        with suppress(zstandard.ZstdError):
            size = int(zstandard.get_frame_parameters(packed).content_size)
            return None if size == zstandard.CONTENTSIZE_UNKNOWN else size
        return -1
    if compression == "lz4":
        from lz4.frame import get_frame_info

        with suppress(RuntimeError):
            return int(get_frame_info(packed)["content_size"]) or None
        return -1
    return len(packed)


def _unpacked(packed: memoryview, compression: str, size: int) -> bytes | memoryview | None:
    """At most `size` unpacked bytes of a chunk; None if the chunk is damaged."""
    if compression == "zstd":
        import zstandard  # as in `_stated_size`

        with suppress(zstandard.ZstdError):
            return zstandard.decompress(packed, size)
        return None
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # as in `_stated_size`

        with suppress(RuntimeError):
            return bytes(LZ4FrameDecompressor().decompress(packed, size))
        return None
    return packed


def _string(body: memoryview, place: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, place)
    end = place + 4 + size
    if end > len(body):
        raise IndexError("a text beyond its record")
    return str(body[place + 4 : end], "utf-8"), end


def _map(body: memoryview, place: int) -> Mapping[str, str]:
    (size,) = struct.unpack_from("<I", body, place)
    place += 4
    end = place + size
    texts = {}
    while place < end:
        key, place = _string(body, place)
        texts[key], place = _string(body, place)
    return texts


def clock_of(about: Mapping[str, str], at: int) -> float:
    """The time on the robot's clock in s for the time `at` (ns) in its recording.

    The result is within 1 ns of the value of `boottime` in the run; an input has the value itself
    (`inputs.TimedInput`). `about`: the texts of the file. ConfigError if these texts do not give
    the clock; texts have no checksum.
    """
    try:
        return (at - int(about["wall_ns"]) + int(about["boot_ns"])) / 1e9
    except (KeyError, ValueError, OverflowError) as error:
        raise ConfigError(
            f"the recording does not tell its clock ({error!r}); expected wall_ns and boot_ns in"
            " its metadata, which may be damaged"
        ) from error


def crc_of(path: Path) -> int:
    """The CRC-32 of a file; OSError if it cannot be read."""
    crc = 0
    with open_regular(path) as file:
        while part := file.read(2**20):
            crc = zlib.crc32(part, crc)
    return crc

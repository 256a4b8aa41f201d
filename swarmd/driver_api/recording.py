"""Recordings: a driver's inputs and commands, in order and with their times, in one file.

The file is a line of text, then frames: four bytes of length (little-endian) and a struct encoded
as on the wire. The first frame is the header. A truncated recording is read up to the cut.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Literal, TypeVar

from msgspec import Meta, Struct

from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_SENSOR_PAYLOAD, Decoder, encode
from swarmd.core.errors import CodecError, ConfigError, DriverError
from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Scan, SharedPose, Twist
from swarmd.driver_api.driver import Driver, Finding, Sink
from swarmd.driver_api.hw_codec import (
    decode_neighbors,
    decode_odometry,
    decode_pose,
    decode_readings,
    encode_command,
    encode_neighbors,
    encode_odometry,
    encode_pose,
    encode_readings,
    encode_scan,
)

log = logging.getLogger(__name__)

MAGIC = b"swarmd recording 1\n"
MAX_FRAME = MAX_SENSOR_PAYLOAD + 1024
T = TypeVar("T")
EntryKind = Literal["scan", "odometry", "neighbors", "pose", "readings", "state", "command"]


class Header(Struct, frozen=True, kw_only=True):
    """Which driver recorded which robot, and its platform."""

    robot: str = ""
    platform: str = ""
    driver: str = ""


class Entry(Struct, frozen=True, array_like=True):
    """One input or command, `at` s after the recording began.

    `payload` is encoded as in `hw_codec.py`; of `state` it is `1` or `0`, then the text.
    """

    at: Annotated[float, Meta(ge=0.0, le=1e9)]
    kind: EntryKind
    payload: bytes


@dataclass(frozen=True, slots=True)
class Recording:
    """One recording. `cut` describes where the file is truncated; empty if it is whole."""

    header: Header
    entries: tuple[Entry, ...]
    cut: str

    @property
    def duration(self) -> float:
        """Seconds from the beginning to the last entry."""
        return self.entries[-1].at if self.entries else 0.0


def named_file(name: str, what: str) -> Path:
    """The file that option `what` names; ConfigError if no file can have that name."""
    try:
        path = Path(name).expanduser()
    except RuntimeError:
        raise ConfigError(f"{what} is {name!r}: there is no such user; expected a file") from None
    if not path.name or "\0" in name:
        raise ConfigError(f"{what} is {name!r}; expected a file")
    return path


_header = Decoder(Header)
_entry = Decoder(Entry, MAX_FRAME)


def read_recording(path: Path) -> Recording:
    """The recording of a file; ConfigError if it is unreadable, no recording, or damaged."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; expected a recording, as option record of a"
            " driver writes it"
        ) from error
    if not data.startswith(MAGIC):
        raise ConfigError(f"{path}: not a recording; expected a file that option record wrote")
    frames, at = [], len(MAGIC)
    while at + 4 <= len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        if size > MAX_FRAME:
            raise _damaged(path, at, f"a frame of {size} bytes")
        if at + 4 + size > len(data):
            break
        frames.append((at, data[at + 4 : at + 4 + size]))
        at += 4 + size
    if not frames:
        raise ConfigError(f"{path}: cut off before its first frame; record it again")
    entries = tuple(_entries(path, frames[1:]))
    cut = ""
    if at < len(data):
        last = entries[-1].at if entries else 0.0
        cut = f"cut off at byte {at} of {len(data)}, {last:.1f} s after it began"
    return Recording(_decoded(path, _header, *frames[0]), entries, cut)


def _entries(path: Path, frames: list[tuple[int, bytes]]) -> Iterator[Entry]:
    before = 0.0
    for at, frame in frames:
        entry = _decoded(path, _entry, at, frame)
        if entry.at < before:
            raise _damaged(path, at, "times that go back")
        before = entry.at
        yield entry


def _decoded(path: Path, decode: Callable[[bytes], T], at: int, frame: bytes) -> T:
    try:
        return decode(frame)
    except CodecError as error:
        raise _damaged(path, at, str(error)) from error


def _damaged(path: Path, at: int, what: str) -> ConfigError:
    return ConfigError(f"{path}: damaged at byte {at}: {what}; record it again")


class Recorder:
    """Appends to a new file, frame by frame; after a failure it logs that and stops recording."""

    def __init__(self, path: Path, header: Mapping[str, str]) -> None:
        """Open the file; DriverError if that fails. An earlier recording of that name is kept."""
        try:
            self._path = _unused(path)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] | None = self._path.open("xb", buffering=0)
        except OSError as error:
            raise DriverError(
                f"record: {path} cannot be written: {error.strerror}; give another file"
            ) from error
        self._begin = boottime()
        self._write(MAGIC, _framed(Header(**header)))
        log.info("recording to %s", self._path)

    def add(self, kind: EntryKind, payload: bytes, at: float | None = None) -> None:
        """One entry: now, or `at` s after the beginning."""
        since = boottime() - self._begin if at is None else at
        self._write(_framed(Entry(since, kind, payload)))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, *parts: bytes) -> None:
        if self._file is None:
            return
        data = b"".join(parts)
        try:
            is_whole = self._file.write(data) == len(data)
            fault = "" if is_whole else "no space left"
        except OSError as error:
            fault = str(error.strerror)
        if fault:
            log.error("recording to %s ends here: %s", self._path, fault)
            self.close()


class RecordingSink:
    """Passes everything on to `sink` and records what can be decoded again.

    A single value beyond the codec's bounds, a battery of 1e38 V, would damage the recording.
    """

    def __init__(self, sink: Sink, recorder: Recorder) -> None:
        self._sink, self._recorder = sink, recorder

    def scan(self, scan: Scan) -> None:
        """A scan."""
        self._sink.scan(scan)
        payload = encode_scan(scan)
        if len(payload) <= MAX_SENSOR_PAYLOAD:
            self._recorder.add("scan", payload)
        else:
            self._sink.dropped("record/scan")

    def odometry(self, odometry: Odometry) -> None:
        """A pose and twist."""
        self._sink.odometry(odometry)
        self._add("odometry", encode_odometry(odometry), decode_odometry)

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """The robots within radio range."""
        self._sink.neighbors(neighbors)
        self._add("neighbors", encode_neighbors(neighbors), decode_neighbors)

    def pose(self, pose: SharedPose) -> None:
        """A pose in a shared frame."""
        self._sink.pose(pose)
        self._add("pose", encode_pose(pose), decode_pose)

    def readings(self, values: Mapping[str, float]) -> None:
        """Scalar sensors."""
        self._sink.readings(values)
        self._add("readings", encode_readings(values), decode_readings)

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """Passed on, not recorded."""
        self._sink.message(sender, channel, payload)

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """The state of the base."""
        self._sink.state(is_up, text, hold=hold, gets_zero=gets_zero)
        self._recorder.add("state", f"{int(is_up)}{text}".encode()[:1000])

    def dropped(self, what: str) -> None:
        """Passed on, not recorded."""
        self._sink.dropped(what)

    def _add(self, kind: EntryKind, payload: bytes, decode: Callable[[bytes], object]) -> None:
        try:
            decode(payload)
        except CodecError:
            self._sink.dropped(f"record/{kind}")
        else:
            self._recorder.add(kind, payload)


class RecordedDriver:
    """A driver whose inputs and commands are recorded while it runs."""

    def __init__(self, driver: Driver, path: Path, header: Mapping[str, str]) -> None:
        self.is_simulated = driver.is_simulated
        self.wrapped, self._path, self._header = driver, path, header
        self._recorder: Recorder | None = None

    async def run(self, sink: Sink) -> None:
        """Run the driver, recording."""
        self._recorder = Recorder(self._path, self._header)
        try:
            await self.wrapped.run(RecordingSink(sink, self._recorder))
        finally:
            self._recorder.close()
            self._recorder = None

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Pass a command on and record it."""
        self.wrapped.send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)
        if self._recorder is not None:
            self._recorder.add("command", encode_command(twist, scan_seq, requested_scan_seq))

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """The driver's findings; records nothing."""
        return await self.wrapped.check(seconds)


def _framed(message: Struct) -> bytes:
    frame = encode(message)
    return len(frame).to_bytes(4, "little") + frame


def _unused(path: Path) -> Path:
    """The path, or the first of `<stem>-2`, `<stem>-3` ... that does not exist."""
    candidate, number = path, 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return candidate

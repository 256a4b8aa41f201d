"""What a daemon sends to its recorder process: batches of entries, as MessagePack.

Each entry has the time `at` in s on the robot's clock (CLOCK_BOOTTIME) at which the daemon handled
it. Numpy arrays travel as bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias, cast

import msgspec
import numpy as np
from msgspec import Struct

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import (
    HostDied,
    HostEvent,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    Stepped,
    TrialDone,
)
from swarmd.core.values import Array, Neighbor, Odometry, Scan, SharedPose, Twist, Value
from swarmd.protection.decision import Decision
from swarmd.recording.limits import FileLimits

MAX_ENTRY = 130_000
"""Bytes of an entry; a batch above about 212 kB does not fit into the socket's buffer."""


class Begin(Struct, frozen=True, array_like=True, tag="begin"):
    """The first entry: where to write, and texts on the robot.

    `wall` in s since 1970 is the wall clock at `at`.
    """

    at: float
    folder: str
    name: str
    about: dict[str, str]
    wall: float
    limits: FileLimits


class ScanEntry(Struct, frozen=True, array_like=True, tag="scan"):
    """A scan as the driver gave it, on topic `/scan`, or `/ranges` for the ring's."""

    at: float
    seq: int
    stamp: float
    ranges: bytes
    geometry: ScanGeometry | None
    topic: str = "/scan"


class ScanGeometry(Struct, frozen=True, array_like=True):
    """Directions and ages of the rays, as float64; None in an entry: as in the last scan."""

    bearings: bytes
    ages: bytes | None
    range_min: float
    range_max: float


class OdometryEntry(Struct, frozen=True, array_like=True, tag="odometry"):
    """A pose and twist."""

    at: float
    value: Odometry


class NeighborsEntry(Struct, frozen=True, array_like=True, tag="neighbors"):
    """The robots within radio range, from the driver or all members."""

    at: float
    value: tuple[Neighbor, ...]


class PoseEntry(Struct, frozen=True, array_like=True, tag="pose"):
    """A pose in a shared frame."""

    at: float
    value: SharedPose


class ReadingsEntry(Struct, frozen=True, array_like=True, tag="readings"):
    """Scalar sensors."""

    at: float
    value: dict[str, float]


class DriverEntry(Struct, frozen=True, array_like=True, tag="driver"):
    """The base is connected or lost."""

    at: float
    is_up: bool
    text: str
    hold: str
    gets_zero: bool


class HostEntry(Struct, frozen=True, array_like=True, tag="host"):
    """An event of the pattern host, as `encode_host` gives it: a replay hands it to the robot."""

    at: float
    data: bytes


class RequestedEntry(Struct, frozen=True, array_like=True, tag="requested"):
    """The command that the pattern requested, by the scan `scan_seq` (-1: none)."""

    at: float
    twist: Twist
    scan_seq: int


class DecisionEntry(Struct, frozen=True, array_like=True, tag="decision"):
    """A decision of protection. `cause`: the input that was handled then."""

    at: float
    cause: str
    state: str
    reason: str
    decision: Decision


class MessageEntry(Struct, frozen=True, array_like=True, tag="message"):
    """A message of a pattern, from `sender`; of this robot where it sent it."""

    at: float
    sender: str
    channel: str
    value: Value


class TextEntry(Struct, frozen=True, array_like=True, tag="text"):
    """A value as JSON on `topic`, such as a status or a request."""

    at: float
    topic: str
    json: bytes


class EventEntry(Struct, frozen=True, array_like=True, tag="event"):
    """A line of the robot's log."""

    at: float
    text: str


class ClockEntry(Struct, frozen=True, array_like=True, tag="clock"):
    """An exchange with a peer, as in `ClockSample`."""

    at: float
    peer: str
    clock: str
    sent: float
    answered: float
    returned: float


class DroppedEntry(Struct, frozen=True, array_like=True, tag="dropped"):
    """So many entries before this one were dropped: the disk was slow."""

    at: float
    count: int


Entry: TypeAlias = (
    Begin
    | ScanEntry
    | OdometryEntry
    | NeighborsEntry
    | PoseEntry
    | ReadingsEntry
    | DriverEntry
    | HostEntry
    | RequestedEntry
    | DecisionEntry
    | MessageEntry
    | TextEntry
    | EventEntry
    | ClockEntry
    | DroppedEntry
)


class RecorderReport(Struct, frozen=True, array_like=True):
    """What the recorder process tells: the file in work, bytes so far, and why it has ended."""

    path: str
    bytes: int
    fault: str = ""


_encoder = msgspec.msgpack.Encoder()
_batches = msgspec.msgpack.Decoder(list[Entry])
_reports = msgspec.msgpack.Decoder(RecorderReport)


def encode_entry(entry: Entry) -> bytes:
    """The bytes of one entry of a batch."""
    return _encoder.encode(entry)


def batch(entries: list[bytes]) -> bytes:
    """A frame of encoded entries, at most 65,535 of them."""
    return b"\xdc" + len(entries).to_bytes(2, "big") + b"".join(entries)


def decode_batch(frame: bytes) -> list[Entry]:
    """The entries of a frame."""
    return _batches.decode(frame)


def encode_report(report: RecorderReport) -> bytes:
    """The frame of a report."""
    return _encoder.encode(report)


def decode_report(frame: bytes) -> RecorderReport:
    """The report of the recorder process; CodecError if it is malformed."""
    try:
        return _reports.decode(frame)
    except msgspec.MsgspecError as error:
        raise CodecError(str(error)) from error


_HOST_EVENTS: Mapping[str, type[Struct]] = {
    kind.__name__: kind
    for kind in (Loaded, LoadRefused, Stepped, ParamsSet, PatternFailed, HostDied, TrialDone)
}


def encode_host(event: HostEvent) -> bytes:
    """The bytes of an event of the pattern host."""
    return _encoder.encode([type(event).__name__, event])


def decode_host(data: bytes) -> HostEvent:
    """The event of a pattern host; CodecError if it is malformed."""
    try:
        name, raw = msgspec.msgpack.decode(data, type=tuple[str, msgspec.Raw])
        return cast(HostEvent, msgspec.msgpack.decode(raw, type=_HOST_EVENTS[name]))
    except (msgspec.MsgspecError, KeyError) as error:
        raise CodecError(f"not an event of a pattern host: {error}") from error


def scan_entry(scan: Scan, at: float, last: Scan | None, topic: str = "/scan") -> ScanEntry:
    """The entry of a scan; `last`: that before it on the topic, whose geometry may still hold."""
    same = last is not None and has_geometry_of(scan, last)
    geometry = None if same else _geometry(scan)
    return ScanEntry(at, scan.seq, scan.stamp, scan.ranges.tobytes(), geometry, topic)


def has_geometry_of(scan: Scan, other: Scan) -> bool:
    """True if both have the same directions, ages and limits of their rays."""
    if (scan.range_min, scan.range_max) != (other.range_min, other.range_max):
        return False
    return _equal(scan.bearings, other.bearings) and _equal(scan.ages, other.ages)


def scan_of(entry: ScanEntry, geometry: ScanGeometry) -> Scan:
    """The scan of an entry."""
    ages = None if geometry.ages is None else np.frombuffer(geometry.ages)
    return Scan(
        entry.seq,
        entry.stamp,
        np.frombuffer(entry.ranges),
        np.frombuffer(geometry.bearings),
        geometry.range_min,
        geometry.range_max,
        ages,
    )


def _geometry(scan: Scan) -> ScanGeometry:
    ages = None if scan.ages is None else scan.ages.tobytes()
    return ScanGeometry(scan.bearings.tobytes(), ages, scan.range_min, scan.range_max)


def _equal(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return one is other or np.array_equal(one, other)


def as_json(value: Any) -> bytes:
    """A struct as JSON; NaN and infinities become null."""
    return msgspec.json.encode(value)

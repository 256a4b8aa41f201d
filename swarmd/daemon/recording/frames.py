"""The messages from a daemon to its recorder process: batches of entries, as MessagePack.

`at` of each entry is the time in s, on the robot's clock (CLOCK_BOOTTIME), at which the daemon
handled the entry. Numpy arrays are encoded as bytes.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.codec import decode
from swarmd.core.events import Input, encode_input
from swarmd.core.values import Array, Scan, Value
from swarmd.robot.protection.decision import Decision
from swarmd.settings.file_limits import FileLimits

MAX_ENTRY = 130_000
"""Bytes of an entry; a batch above about 212 kB does not fit into the socket's buffer."""


MAX_BATCH = 65_535
"""Entries of a frame."""
MAX_PARTS = 64
"""Parts of the memory of a robot; the recorder writes ten at most (`MAX_MEMORY` there)."""


class Begin(Struct, frozen=True, array_like=True, tag="begin"):
    """The first entry of a recording: folder and name of its files, texts on the robot (`about`).

    `wall`: the wall clock in s since 1970 at the time `at` of the robot's clock.
    """

    at: float
    folder: str
    name: str
    about: dict[str, str]
    wall: float
    limits: FileLimits


class InputEntry(Struct, frozen=True, array_like=True, tag="input"):
    """An input of the robot, as `encode_input` gives it.

    A scan in `data` omits bearings and ages that equal those of the last scan of its kind.
    """

    at: float
    data: bytes


class MemoryEntry(Struct, frozen=True, array_like=True, tag="memory"):
    """Part `part` of `parts` of the robot's memory before its next input (`robot/memory.py`)."""

    at: float
    data: bytes
    part: int = 0
    parts: int = 1


class DecisionEntry(Struct, frozen=True, array_like=True, tag="decision"):
    """A decision of protection. `cause`: the kind of the input that led to the decision."""

    at: float
    cause: str
    state: str
    reason: str
    decision: Decision


class SentEntry(Struct, frozen=True, array_like=True, tag="sent"):
    """A message that the robot's pattern sent."""

    at: float
    channel: str
    value: Value


class TextEntry(Struct, frozen=True, array_like=True, tag="text"):
    """A value as JSON on `topic`, such as a status."""

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
    """`count` entries before this entry were dropped, since the disk was slow."""

    at: float
    count: int


Entry: TypeAlias = (
    Begin
    | InputEntry
    | MemoryEntry
    | DecisionEntry
    | SentEntry
    | TextEntry
    | EventEntry
    | ClockEntry
    | DroppedEntry
)


class RecorderReport(Struct, frozen=True, array_like=True):
    """A report of the recorder process: present file, bytes so far; `fault`: why it has ended."""

    path: str
    bytes: int
    fault: str = ""


_EMPTY: Array = np.zeros(0)
_reports = msgspec.msgpack.Decoder(RecorderReport)

encode = msgspec.msgpack.Encoder().encode
"""The bytes of one entry of a batch, or the frame of a report."""
decode_batch = msgspec.msgpack.Decoder(Annotated[list[Entry], Meta(max_length=MAX_BATCH)]).decode
"""The entries of a frame."""
as_json = msgspec.json.encode
"""A struct as JSON; NaN and infinities become null."""


def input_entry(input: Input, at: float) -> InputEntry:
    """The entry of an input at `at`."""
    return InputEntry(at, encode_input(input))


def batch(entries: list[bytes]) -> bytes:
    """A frame of encoded entries, at most 65,535 of them."""
    return b"\xdc" + len(entries).to_bytes(2, "big") + b"".join(entries)


def decode_report(frame: bytes) -> RecorderReport:
    """The report of the recorder process; CodecError if it is malformed."""
    return decode(_reports, frame, "a report of the recorder")


def has_geometry_of(scan: Scan, reference: Scan) -> bool:
    """True if both have the same directions, ages and limits of their rays."""
    if (scan.range_min, scan.range_max) != (reference.range_min, reference.range_max):
        return False
    return _equal(scan.bearings, reference.bearings) and _equal(scan.ages, reference.ages)


def without_geometry(scan: Scan) -> Scan:
    """The scan without its bearings and ages."""
    return replace(scan, bearings=_EMPTY, ages=None)


def with_geometry(scan: Scan, last: Scan | None) -> Scan | None:
    """The scan, completed by bearings and ages of `last`; None if these are unknown."""
    if len(scan.bearings) or not len(scan.ranges):
        return scan
    return None if last is None else replace(scan, bearings=last.bearings, ages=last.ages)


def _equal(left: Array | None, right: Array | None) -> bool:
    if left is None or right is None:
        return left is right
    return left is right or np.array_equal(left, right)

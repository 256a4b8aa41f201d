"""Decodes the recorded inputs of a robot, for a replay."""

from __future__ import annotations

from typing import NamedTuple

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.errors import CodecError
from swarmd.core.events import Input, RangesInput, ScanInput, decode_input, tag_of
from swarmd.core.values import Scan
from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.reader import RecordedMessage

INPUT = "/input"
"""The topic of the bytes of all inputs, in their order."""
MEMORY = "/memory"
"""The topic of what the robot knew at the start of a file and after a loss, see robot/memory.py."""
GEOMETRY = "/geometry"
"""Ends the topic of the directions and ages of a scan's rays, after that of the scan."""


class TimedInput(NamedTuple):
    """An input, and the time `now` that the robot got with it, in s on the robot's clock."""

    input: Input
    now: float


class InputReader:
    """Decodes the inputs of one recording: each message must pass through `read`, in order."""

    def __init__(self) -> None:
        self._scans: dict[str, Scan] = {}  # by topic of the scan: the last geometry

    def has_geometry(self, topic: str) -> bool:
        """True if the directions of the rays of scans on `topic` are known."""
        return topic in self._scans

    def read(self, message: RecordedMessage) -> TimedInput | None:
        """The input in a message; None if the message has no input. CodecError if malformed."""
        if message.topic.endswith(GEOMETRY):
            geometry = messages.message_on(message.topic, message.kind, message.payload)
            self._scans[message.topic.removesuffix(GEOMETRY)] = messages.geometry_of(geometry)
        if message.topic != INPUT:
            return None
        recorded = messages.message_on(message.topic, message.kind, message.payload)
        if not 0.0 <= recorded.now <= MAX_SECONDS:
            raise CodecError(f"an input at {recorded.now} s; expected 0 to {MAX_SECONDS:g} s")
        input = decode_input(bytes(recorded.data))
        if not isinstance(input, ScanInput | RangesInput):
            return TimedInput(input, recorded.now)
        scan = frames.with_geometry(input.scan, self._scans.get(f"/{tag_of(input)}"))
        if scan is None:
            raise CodecError("a scan without the directions of its rays")
        return TimedInput(type(input)(scan), recorded.now)

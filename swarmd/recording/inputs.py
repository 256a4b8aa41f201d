"""Decodes the recorded inputs of a robot, for a replay."""

from __future__ import annotations

from swarmd.core.errors import CodecError
from swarmd.core.events import Input, RangesInput, ScanInput, decode_input, tag_of
from swarmd.core.values import Scan
from swarmd.recording import frames, messages
from swarmd.recording.reader import RecordedMessage

INPUT = "/input"
"""The topic of the bytes of all inputs, in their order."""
MEMORY = "/memory"
"""The topic of what the robot knew at the start of a file and after a loss, see robot/memory.py."""
GEOMETRY = "/geometry"
"""Ends the topic of the directions and ages of a scan's rays, after that of the scan."""


class InputReader:
    """Decodes the inputs of one recording: each message must pass through `read`, in order."""

    def __init__(self) -> None:
        self._scans: dict[str, Scan] = {}  # by topic of the scan: the last geometry

    def has_geometry(self, topic: str) -> bool:
        """True if the directions of the rays of scans on `topic` are known."""
        return topic in self._scans

    def read(self, message: RecordedMessage) -> Input | None:
        """The input in a message; None if the message has no input. CodecError if malformed."""
        if message.topic.endswith(GEOMETRY):
            geometry = messages.message_on(message.topic, message.kind, message.payload)
            self._scans[message.topic.removesuffix(GEOMETRY)] = messages.geometry_of(geometry)
        if message.topic != INPUT:
            return None
        input = decode_input(
            bytes(messages.message_on(message.topic, message.kind, message.payload).data)
        )
        if not isinstance(input, ScanInput | RangesInput):
            return input
        scan = frames.with_geometry(input.scan, self._scans.get(f"/{tag_of(input)}"))
        if scan is None:
            raise CodecError("a scan without the directions of its rays")
        return type(input)(scan)

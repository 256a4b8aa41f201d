"""A recording in place of a robot: its inputs in their order and at their pace.

Commands are counted and move nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.values import ZERO, Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, Sink
from swarmd.driver_api.hw_codec import INPUTS, decode_input, deliver
from swarmd.driver_api.recording import Entry, Recording, named_file, read_recording
from swarmd.settings.layered import Layered

log = logging.getLogger(__name__)

START_DELAY = 0.5
"""Seconds before the first entry, in which the base counts as lost."""
LOOP_PAUSE = 1.0
"""Seconds between two rounds of a loop, in which the base counts as lost: its pose jumps."""
MAX_COMMANDS = 100


class ReplayOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`file`: a recording. `speed`: 1 is real time. `loop`: play it again and again."""

    file: str
    speed: Annotated[float, Meta(ge=0.05, le=100.0)] = 1.0
    loop: bool = False


class ReplayDriver:
    """Plays a recording to the sink. `taken`: the last commands."""

    is_simulated = True  # no base moves

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not playing yet; ConfigError if an option or the recording is wrong."""
        self._options = Layered(("driver replay", options)).build(ReplayOptions)
        self._path = named_file(self._options.file, "driver replay: file")
        self._spec = platform.scan
        self._recording = read_recording(self._path)
        self._after, self._span = _extent(self._path, self._recording, platform)
        self._gate = CommandGate()
        self._commands: Counter[str] = Counter()
        self.taken: deque[Twist] = deque(maxlen=MAX_COMMANDS)

    async def run(self, sink: Sink) -> None:
        """Play it, once or in a loop, until cancelled."""
        if self._recording.cut:
            log.warning(
                "%s is %s; what came before that is played", self._path, self._recording.cut
            )
        try:
            sink.state(False, f"{self._path.name} is about to begin")
            await asyncio.sleep(START_DELAY)
            rounds = 0
            while True:
                await self._play(sink, rounds)
                rounds += 1
                if not self._options.loop:
                    break
                self._lose(sink, f"{self._path.name} has ended and begins again")
                await asyncio.sleep(LOOP_PAUSE)
            self._lose(sink, f"{self._path.name} has ended; option loop=true plays it again")
            await asyncio.Event().wait()
        finally:
            if self._gate.end():
                self._take(ZERO)
            moving = self._commands["moving"]
            log.info("took %d commands, %d to move", self._commands.total(), moving)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Take a command; dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._take(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """The recording's length and the inputs in it."""
        recording, header = self._recording, self._recording.header
        kinds = Counter[str](entry.kind for entry in recording.entries)
        length = max(recording.duration, 1e-9)
        text = f"{recording.duration:.1f} s of {header.robot} ({header.platform}, {header.driver})"
        findings = [Finding("recording", True, f"{text}, {recording.cut or 'whole'}")]
        for kind, is_needed in (("scan", True), ("odometry", True), ("neighbors", False)):
            count = kinds[kind]
            rate = f"{count} at {count / length:.1f} Hz"
            missing = f"none in {self._path}; record a robot that has it"
            if count or is_needed:
                findings.append(Finding(kind, bool(count), rate if count else missing))
        return tuple(findings)

    async def _play(self, sink: Sink, rounds: int) -> None:
        """One round; stamps and sequences of later rounds continue those of the one before."""
        loop, speed = asyncio.get_running_loop(), self._options.speed
        begin, shift = loop.time(), rounds * (self._span + LOOP_PAUSE)
        if not any(entry.kind == "state" for entry in self._recording.entries):
            self._connect(sink)
        for entry in self._recording.entries:
            # Also when late: playback that is behind must not block the loop.
            await asyncio.sleep(max(begin + entry.at / speed - loop.time(), 0.0))
            self._deliver(sink, entry, shift, rounds * self._after)

    def _deliver(self, sink: Sink, entry: Entry, shift: float, ahead: int) -> None:
        if entry.kind in INPUTS:
            value = decode_input(entry.kind, entry.payload, self._spec)
            if isinstance(value, Scan):
                value = replace(value, seq=value.seq + ahead, stamp=value.stamp + shift)
            elif isinstance(value, Odometry):
                value = Odometry(value.stamp + shift, value.pose, value.twist)
            deliver(sink, value)
        elif entry.kind == "state":
            text = entry.payload[1:].decode(errors="replace")
            if entry.payload[:1] == b"1":
                self._connect(sink)
            else:
                self._lose(sink, f"as recorded: {text}")

    def _connect(self, sink: Sink) -> None:
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"plays {self._path}")

    def _lose(self, sink: Sink, text: str) -> None:
        if self._gate.close(asyncio.get_running_loop().time()):
            self._take(ZERO)
        sink.state(False, text)

    def _take(self, twist: Twist) -> None:
        self._commands["zero" if twist.is_zero else "moving"] += 1
        self.taken.append(twist)


def _extent(path: Path, recording: Recording, platform: Platform) -> tuple[int, float]:
    """The sequence after its last scan's, and the span of its stamps in s.

    ConfigError if an entry cannot be read, before the playback begins.
    """
    sequences, stamps = [0], []
    for entry in recording.entries:
        if entry.kind not in INPUTS:
            continue
        try:
            value = decode_input(entry.kind, entry.payload, platform.scan)
        except CodecError as error:
            raise ConfigError(
                f"{path}: damaged {entry.at:.1f} s after it began: {error}; record it again"
            ) from error
        if isinstance(value, Scan):
            sequences.append(value.seq + 1)
        if isinstance(value, Scan | Odometry):
            stamps.append(value.stamp)
    return max(sequences), max(stamps, default=0.0) - min(stamps, default=0.0)

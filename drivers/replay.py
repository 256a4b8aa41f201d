"""A recording in place of a robot: its inputs in their order and at their pace.

Commands are counted and move nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.finding import Finding
from swarmd.core.hazard import Hazard
from swarmd.core.values import (
    ZERO,
    Detection,
    Neighbor,
    Odometry,
    Platform,
    Scan,
    SharedPose,
    Twist,
    Value,
)
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Sink
from swarmd.driver_api.hw_codec import deliver
from swarmd.recording import messages
from swarmd.recording.reader import RecordedMessage, read_file
from swarmd.settings.layered import Layered

log = logging.getLogger(__name__)

START_DELAY = 0.5
"""Seconds before the first entry, in which the base counts as lost."""
LOOP_PAUSE = 1.0
"""Seconds between two rounds of a loop, in which the base counts as lost: its pose jumps."""
MAX_COMMANDS = 100


@dataclass(frozen=True, slots=True)
class _BaseState:
    """The base was connected or lost."""

    is_up: bool
    text: str


@dataclass(frozen=True, slots=True)
class _Told:
    """The hazards that the base sensed, or the objects that the robot recognised."""

    kind: str
    value: tuple[Hazard, ...] | tuple[Detection, ...] | None


@dataclass(frozen=True, slots=True)
class _Ring:
    """A scan of the ring of range sensors."""

    scan: Scan


_Entry: TypeAlias = (
    Scan
    | Odometry
    | tuple[Neighbor, ...]
    | SharedPose
    | Mapping[str, float]
    | _BaseState
    | _Told
    | _Ring
)


@dataclass(frozen=True, slots=True)
class _Recording:
    """Inputs with their times in s since the first one. `fault`: what is missing or damaged."""

    about: Mapping[str, str]
    entries: tuple[tuple[float, _Entry], ...]
    fault: str

    @property
    def duration(self) -> float:
        """Seconds from the first to the last input."""
        return self.entries[-1][0] if self.entries else 0.0


class ReplayOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`file`: a recording (.mcap). `speed`: 1 is real time. `loop`: play it again and again."""

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
        self._path = _named(self._options.file)
        self._recording = _read(self._path)
        self._after, self._span = _extent(self._recording)
        self._gate = CommandGate()
        self._commands: Counter[str] = Counter()
        self.taken: deque[Twist] = deque(maxlen=MAX_COMMANDS)

    async def run(self, sink: Sink) -> None:
        """Play it, once or in a loop, until cancelled."""
        if self._recording.fault:
            log.warning("%s: %s; what is whole is played", self._path, self._recording.fault)
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
        recording, about = self._recording, self._recording.about
        kinds = Counter[type](type(value) for _, value in recording.entries)
        length = max(recording.duration, 1e-9)
        names = ", ".join(about.get(key, "unknown") for key in ("platform", "driver"))
        text = f"{recording.duration:.1f} s of {about.get('robot', 'an unknown robot')} ({names})"
        findings = [Finding("recording", True, f"{text}, {recording.fault or 'whole'}")]
        needed = (
            ("scan", Scan, True),
            ("ranges", _Ring, False),
            ("odometry", Odometry, True),
            ("neighbors", tuple, False),
        )
        for name, kind, is_needed in needed:
            count = kinds[kind]
            rate = f"{count} at {count / length:.1f} Hz"
            missing = f"none in {self._path}; record a robot that has it"
            if count or is_needed:
                findings.append(Finding(name, bool(count), rate if count else missing))
        return tuple(findings)

    async def _play(self, sink: Sink, rounds: int) -> None:
        """One round; stamps and sequences of later rounds continue those of the one before."""
        loop, speed = asyncio.get_running_loop(), self._options.speed
        begin, shift = loop.time(), rounds * (self._span + LOOP_PAUSE)
        for at, value in self._recording.entries:
            # Also when late: playback that is behind must not block the loop.
            await asyncio.sleep(max(begin + at / speed - loop.time(), 0.0))
            self._deliver(sink, value, shift, rounds * self._after)

    def _deliver(self, sink: Sink, value: _Entry, shift: float, ahead: int) -> None:
        if isinstance(value, _Told):
            deliver(sink, value.kind, value.value)
            return
        if isinstance(value, _BaseState):
            if value.is_up:
                self._connect(sink)
            else:
                self._lose(sink, f"as recorded: {value.text}")
            return
        if isinstance(value, _Ring):
            sink.ranges(_shifted(value.scan, shift, ahead))
            return
        if isinstance(value, Scan):
            value = _shifted(value, shift, ahead)
        elif isinstance(value, Odometry):
            value = Odometry(value.stamp + shift, value.pose, value.twist)
        deliver(sink, _METHODS.get(type(value), "readings"), value)

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


def _shifted(scan: Scan, shift: float, ahead: int) -> Scan:
    return replace(scan, seq=scan.seq + ahead, stamp=scan.stamp + shift)


def _named(name: str) -> Path:
    """The file that option `file` names; ConfigError if no file can have that name."""
    try:
        path = Path(name).expanduser()
    except RuntimeError:
        raise ConfigError(
            f"driver replay: file is {name!r}: there is no such user; expected a recording (.mcap)"
        ) from None
    if not path.name or "\0" in name:
        raise ConfigError(f"driver replay: file is {name!r}; expected a recording (.mcap)")
    return path


def _read(path: Path) -> _Recording:
    """The inputs of a recording; ConfigError if there are none, before the playback begins."""
    found = read_file(path)
    timed = [(one.at, value) for one, value in _inputs(path, found.messages)]
    if not timed:
        raise ConfigError(
            f"{path}: no inputs of a driver are in it ({found.fault or 'whole'}); record it again"
        )
    # A robot whose driver measures no neighbors was given all members, which are no measurement.
    neighbors = (one for _, value in timed if isinstance(value, tuple) for one in value)
    is_measured = any(one.distance is not None for one in neighbors)
    begin = min(at for at, _ in timed)
    entries = [
        ((at - begin) * 1e-9, value)
        for at, value in sorted(timed, key=lambda one: one[0])
        if is_measured or not isinstance(value, tuple)
    ]
    first = next((n for n, (_, value) in enumerate(entries) if isinstance(value, Scan)), 0)
    if not any(isinstance(value, _BaseState) for _, value in entries[:first]):
        entries.insert(0, (0.0, _BaseState(True, "")))  # it was connected before
    return _Recording(found.about, tuple(entries), found.fault)


def _inputs(
    path: Path, recorded: list[RecordedMessage]
) -> Iterator[tuple[RecordedMessage, _Entry]]:
    geometry: dict[str, Any] = {}
    for one in recorded:
        topic = one.topic.removesuffix("/geometry")
        if topic not in (*_READERS, "/scan", "/ranges"):
            continue
        try:
            message = messages.message_on(one.topic, one.kind, one.payload)
            read = _READERS[one.topic](message) if one.topic in _READERS else None
        except CodecError as error:
            raise ConfigError(f"{path}: {one.topic}: {error}; record it again") from error
        if one.topic != topic:
            geometry[topic] = message
        elif topic in ("/scan", "/ranges"):
            scan = messages.scan_of(message, one.sequence, geometry.get(topic))
            yield one, scan if topic == "/scan" else _Ring(scan)
        elif read is not None:
            yield one, read


def _told(kind: str, of: Any, json: str) -> _Told:
    try:
        return _Told(kind, msgspec.json.decode(json, type=of))
    except msgspec.MsgspecError as error:
        raise CodecError(f"no {kind}: {error}") from error


_METHODS: Mapping[type, str] = {
    Scan: "scan",
    Odometry: "odometry",
    SharedPose: "pose",
    tuple: "neighbors",
}
_READERS: Mapping[str, Callable[[Any], _Entry]] = {
    "/odometry": messages.odometry_of,
    "/neighbors": messages.neighbors_of,
    "/pose": messages.pose_of,
    "/readings": messages.readings_of,
    "/hazards": lambda message: _told("hazards", tuple[Hazard, ...], message.json),
    "/detections": lambda message: _told("detections", tuple[Detection, ...] | None, message.json),
    "/driver": lambda message: _BaseState(message.is_up, message.text),
}


def _extent(recording: _Recording) -> tuple[int, float]:
    """The sequence after its last scan's, and the span of its stamps in s."""
    sequences, stamps = [0], []
    for _, value in recording.entries:
        if isinstance(value, _Ring):
            value = value.scan
        if isinstance(value, Scan):
            sequences.append(value.seq + 1)
        if isinstance(value, Scan | Odometry):
            stamps.append(value.stamp)
    return max(sequences), max(stamps, default=0.0) - min(stamps, default=0.0)

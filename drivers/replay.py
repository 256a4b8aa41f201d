"""Driver `replay`: plays the inputs of a recording, in their order and at their pace.

Of a recording of other programs, such as rosbag2, it plays the scans and the odometry. Commands are
counted and move nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

from msgspec import Meta, Struct
from msgspec.structs import astuple, replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.events import (
    DriverInput,
    NeighborsInput,
    OdometryInput,
    RangesInput,
    ScanInput,
    SensorInput,
    tag_of,
)
from swarmd.core.finding import Finding
from swarmd.core.values import ZERO, Platform, Twist, Value
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.inputs import InputReader
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Sink
from swarmd.settings.layered import Layered

log = logging.getLogger(__name__)

START_DELAY = 0.5
"""Seconds before the first entry, in which the base counts as lost."""
LOOP_PAUSE = 1.0
"""Seconds between two rounds of a loop, in which the base counts as lost: its pose jumps."""
MAX_COMMANDS = 100


_Played: TypeAlias = SensorInput | DriverInput
_SCANS: Mapping[str, type[ScanInput | RangesInput]] = MappingProxyType(
    {"/scan": ScanInput, "/ranges": RangesInput}
)


@dataclass(frozen=True, slots=True)
class _Recording:
    """The inputs of a recording."""

    about: Mapping[str, str]
    entries: tuple[tuple[float, _Played], ...]  # s since the first input, and the input
    fault: str  # what is missing or damaged; empty if the recording is whole

    @property
    def duration(self) -> float:
        """Seconds from the first to the last input."""
        return self.entries[-1][0] if self.entries else 0.0


class ReplayOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The options of driver `replay`.

    - `file`: a recording (.mcap).
    - `speed`: 1 is real time.
    - `loop`: play the recording again and again.
    """

    file: str
    speed: Annotated[float, Meta(ge=0.05, le=100.0)] = 1.0
    loop: bool = False


class ReplayDriver:
    """Plays a recording to the sink. `taken`: the last commands."""

    is_simulated = True  # no base moves

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Read the recording; ConfigError if an option or the recording is wrong."""
        self._options = Layered(("driver replay", options)).build(ReplayOptions)
        self._path = _named(self._options.file)
        self._recording = _read(self._path)
        self._after, self._span = _extent(self._recording)
        self._gate = CommandGate()
        self._commands: Counter[str] = Counter()
        self.taken: deque[Twist] = deque(maxlen=MAX_COMMANDS)

    async def run(self, sink: Sink) -> None:
        """Play the recording, once or in a loop, until cancelled."""
        if self._recording.fault:
            log.warning("%s: %s; what is whole is played", self._path, self._recording.fault)
        try:
            self._lose(sink, f"{self._path.name} is about to begin")
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
        recording = self._recording
        about = self._recording.about
        kinds = Counter(tag_of(input) for _, input in recording.entries)
        length = max(recording.duration, 1e-9)
        names = ", ".join(about.get(key, "unknown") for key in ("platform", "driver"))
        text = f"{recording.duration:.1f} s of {about.get('robot', 'an unknown robot')} ({names})"
        findings = [Finding("recording", True, f"{text}, {recording.fault or 'whole'}")]
        needed = {"scan": True, "ranges": False, "odometry": True, "neighbors": False}
        for name, is_needed in needed.items():
            count = kinds[name]
            rate = f"{count} at {count / length:.1f} Hz"
            missing = f"none in {self._path}; record a robot that has it"
            if count or is_needed:
                findings.append(Finding(name, bool(count), rate if count else missing))
        return tuple(findings)

    async def _play(self, sink: Sink, rounds: int) -> None:
        """Play one round; stamps and sequences continue those of the round before."""
        loop = asyncio.get_running_loop()
        speed = self._options.speed
        begin = loop.time()
        shift = rounds * (self._span + LOOP_PAUSE)
        for at, input in self._recording.entries:
            # Sleep even for 0 s: playback that is late must not block the loop.
            await asyncio.sleep(max(begin + at / speed - loop.time(), 0.0))
            if not isinstance(input, DriverInput):
                sink.take(_moved(input, shift, rounds * self._after))
            elif input.is_up:
                self._connect(sink)
            else:
                self._lose(sink, f"as recorded: {input.text}")

    def _connect(self, sink: Sink) -> None:
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"plays {self._path}")

    def _lose(self, sink: Sink, text: str) -> None:
        if self._gate.close(asyncio.get_running_loop().time()):
            self._take(ZERO)
        sink.state(False, text, gets_zero=True)  # no base moves

    def _take(self, twist: Twist) -> None:
        self._commands["zero" if twist.is_zero else "moving"] += 1
        self.taken.append(twist)


def _moved(input: SensorInput, shift: float, ahead: int) -> SensorInput:
    """The input with its stamp moved by `shift` s, and its sequence by `ahead`."""
    value = _value(input)
    changes: dict[str, Any] = {}
    if hasattr(value, "stamp"):
        changes["stamp"] = value.stamp + shift
    if hasattr(value, "seq"):
        changes["seq"] = value.seq + ahead
    return type(input)(replace(value, **changes)) if changes else input


def _value(input: SensorInput) -> Any:
    (value,) = astuple(input)
    return value


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
    recorded = read_file(path)
    timed = list(_inputs(path, recorded)) or list(_inputs_of_ros(recorded))
    if not timed:
        raise ConfigError(
            f"{path}: no inputs of a driver are in it ({recorded.fault or 'whole'});"
            " record it again"
        )
    # A driver that measures no neighbors has recorded all members without distances: these inputs
    # are not played.
    lists = [input.neighbors for _, input in timed if isinstance(input, NeighborsInput)]
    is_measured = any(robot.distance is not None for robots in lists for robot in robots)
    begin = min(at for at, _ in timed)
    entries = [
        ((at - begin) * 1e-9, input)
        for at, input in sorted(timed, key=itemgetter(0))
        if is_measured or not isinstance(input, NeighborsInput)
    ]
    first = next((n for n, (_, input) in enumerate(entries) if isinstance(input, ScanInput)), 0)
    if not any(isinstance(input, DriverInput) for _, input in entries[:first]):
        entries.insert(0, (0.0, DriverInput(True, "")))  # the base was connected before
    return _Recording(recorded.about, tuple(entries), recorded.fault)


def _inputs(path: Path, recorded: RecordedFile) -> Iterator[tuple[int, _Played]]:
    """The time in ns and the input of each message that holds an input of a driver.

    Messages of a damaged recording that cannot be read are left out. The exact bearings of scans
    are recorded once; if that message is lost, a scan gets the rounded bearings of the ROS message
    that is recorded for viewers.
    """
    reader = InputReader()
    for message in recorded.messages:
        kind = _SCANS.get(message.topic)
        try:
            recorded_input = reader.read(message)
            input = None if recorded_input is None else recorded_input.input
            if recorded.fault and kind is not None and not reader.has_geometry(message.topic):
                rounded = messages.message_on(message.topic, message.kind, message.payload)
                input = kind(messages.scan_of(rounded, message.sequence, None))
        except CodecError as error:
            if recorded.fault:
                continue
            raise ConfigError(f"{path}: {message.topic}: {error}; record it again") from error
        if isinstance(input, _Played):
            yield message.at, input


def _inputs_of_ros(recorded: RecordedFile) -> Iterator[tuple[int, _Played]]:
    """The time in ns and the input of each scan and each odometry; CodecError if malformed.

    For a recording without inputs of swarmd. If several topics have a type, the first is played.
    Scans are numbered anew, since rosbag2 may number no message.
    """
    topics: dict[str, str] = {}
    for number, message in enumerate(recorded.messages):
        convert = _OF_ROS.get(message.kind)
        if convert and topics.setdefault(message.kind, message.topic) == message.topic:
            decoded = messages.deserialize(message.kind, message.payload)
            yield message.at, convert(decoded, number)


_OF_ROS: Mapping[str, Callable[[Any, int], SensorInput]] = MappingProxyType(
    {
        messages.LASER_SCAN: lambda scan, seq: ScanInput(messages.scan_of(scan, seq, None)),
        messages.ODOMETRY: lambda odometry, _: OdometryInput(messages.odometry_of(odometry)),
    }
)


def _extent(recording: _Recording) -> tuple[int, float]:
    """What a repeat of the recording must add to sequence numbers, and to stamps in s.

    With these additions numbers and stamps rise from one repeat to the next, too. Numbers get the
    greatest number plus 1. Stamps get the span of the stamps. Each kind of input may have a clock
    of its own, so the longest span of all kinds counts.
    """
    sequences = [0]
    stamps = defaultdict[str, list[float]](list)
    for _, input in recording.entries:
        if isinstance(input, DriverInput):
            continue
        value = _value(input)
        sequences.append(getattr(value, "seq", -1) + 1)
        if hasattr(value, "stamp"):
            stamps[tag_of(input)].append(value.stamp)
    return max(sequences), max((max(own) - min(own) for own in stamps.values()), default=0.0)

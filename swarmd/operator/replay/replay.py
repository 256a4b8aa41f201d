"""Replays a recorded run: the same inputs at the same times, through the same `Robot`.

The replayed robot gets the recorded sensor data, and the recorded commands of the pattern. So a
difference of the replayed pattern causes no difference of protection. The replayed pattern gets the
sensor data from the replayed robot, and no commands of protection. So a difference of protection
causes no difference of the pattern.

The replay begins with the recorded memory of the robot. Without a usable memory, or on another
platform, the replay begins with a new robot, and the recording must begin outside a run.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from platform import machine
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np

from swarmd.core.errors import CodecError, ConfigError, SwarmError
from swarmd.core.events import HostInput, Input, RequestInput
from swarmd.core.host_messages import KillHost, Load, LoadRefused, StartTrial, Stepped
from swarmd.core.incident import Incident
from swarmd.core.kernels import describe_kernels
from swarmd.core.libm import digest_of_libm
from swarmd.core.messages import State
from swarmd.core.pin import how_made
from swarmd.core.values import ZERO, Platform, Twist
from swarmd.core.verbs import StopRequest
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.frames import DecisionEntry
from swarmd.daemon.recording.head import RecordingHead, head_of
from swarmd.daemon.recording.inputs import MEMORY, InputReader, TimedInput
from swarmd.daemon.recording.reader import RecordedFile, RecordedMessage, clock_of
from swarmd.make_robot import make_robot
from swarmd.operator.replay.changes import Changes
from swarmd.operator.texts.why import protection_word
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.robot.actions import Actions
from swarmd.robot.memory import recall
from swarmd.robot.robot import Robot

STAMP_END = 12
"""Bytes of the encoding and of the stamp, at the begin of a message with a header."""
LAST = 100
"""Inputs and decisions before a difference, or before an incident, that `replay -v` names."""
INCIDENT = "/incident"
"""The topic of the incidents of which the robot keeps its last minute."""
EVENT = "/event"
"""The topic of the lines of the robot's log."""
_FACTS: Mapping[str, str] = {"simd": "instructions of numpy", "libc": "C library"}
"""Words for what `how_made` tells; the others are words."""
Last: TypeAlias = tuple[tuple[Any, float], ...]
"""Inputs, and messages of decisions, each with its time in s on the timeline."""


@dataclass(slots=True)
class Compared:
    """The comparison of commands of the replay with recorded commands."""

    count: int = 0
    equal: int = 0  # commands that are equal to the bit
    largest: float = 0.0  # the largest difference, in m/s or rad/s
    first: float | None = None  # the time of the first difference, in s on the timeline

    def add(self, replayed: Twist, recorded: Twist, at: float) -> None:
        """Compare two commands at `at` s."""
        own, other = (
            (twist.linear, twist.angular, twist.lateral) for twist in (replayed, recorded)
        )
        self.count += 1
        differences = (abs(a - b) for a, b in zip(own, other, strict=True))
        self.largest = max(self.largest, *differences)
        if struct.pack("<3d", *own) == struct.pack("<3d", *other):
            self.equal += 1
        elif self.first is None:
            self.first = at

    def include(self, more: Compared) -> None:
        """Add the numbers of another comparison."""
        self.count += more.count
        self.equal += more.equal
        self.largest = max(self.largest, more.largest)
        self.first = more.first if self.first is None else self.first

    @property
    def share(self) -> float:
        """The share of equal commands; 1 without commands."""
        return self.equal / self.count if self.count else 1.0

    @property
    def is_equal(self) -> bool:
        """Whether all commands are equal."""
        return self.equal == self.count


class Difference(NamedTuple):
    """The first field of a decision, or of a pattern's command, that the replay makes otherwise."""

    at: float  # s on the timeline
    field: str  # such as safe
    recorded: str
    replayed: str
    last: Last  # before it


class Noted(NamedTuple):
    """An incident in a recording, at `at` s on the timeline, and what came before it."""

    incident: Incident
    at: float
    last: Last


@dataclass(frozen=True, slots=True)
class Parity:
    """The comparison of a replay with its recording."""

    safe: Compared  # commands of protection
    requested: Compared  # commands of the pattern
    seconds: float  # of the recording
    notes: tuple[str, ...]  # lines on what the comparison leaves out
    difference: Difference | None = None  # the first one


class Replay:
    """A robot that replays a recording, from its recorded memory or from the recording's head.

    `safe` and `requested`: the comparison of the commands of protection, and of the pattern.
    """

    def __init__(
        self,
        head: RecordingHead,
        about: Mapping[str, str],
        origins: Mapping[str, tuple[str, bool]],
        platform: Platform | None = None,
        *,
        recalls: bool = False,
    ) -> None:
        """Prepare the replay; `take` makes the robot, or takes it from the recorded memory.

        - `head`, `about`: the head of the recording, and the texts of its files on the robot.
        - `origins`: by pattern, its `module:Class` or path, and True for a path.
        - `platform`: replaces the recorded platform.
        - `recalls`: begin with the recorded memory (the serialised robot), which the caller has
          found readable; else with a new robot by the head.
        """
        self._head = head
        self._about = about
        self._platform = platform or head.identity.platform
        self._origins = origins
        self._recalls = recalls
        self._robot: Robot
        self._actions: Actions | None = None  # the last actions of the replayed robot
        # True: inputs are skipped until the next recorded memory.
        self._awaits_memory = recalls
        # Whether the running pattern is replayed. False after a memory: the memory holds the robot,
        # but not its pattern, so the pattern is replayed from its next load on.
        self._steps_pattern = not recalls
        self._loader = PatternLoader({})
        self._executor = PatternExecutor(self._loader)
        self._steps: deque[Stepped] = deque()  # answers of the replayed pattern, oldest first
        self._inputs = InputReader()
        self._begin: float | None = None  # time of the first message, s on the robot's clock
        self.begin = 0.0  # the same in s on the timeline of all robots
        self.safe = Compared()
        self.requested = Compared()
        self.difference: Difference | None = None
        self.last: deque[tuple[Any, float]] = deque(maxlen=LAST)
        self.incidents: list[Noted] = []
        self.changes: Changes | None = None  # None: nobody asks what changed
        self._last = 0.0  # time of the last message, s after the first
        self._notes: dict[str, None] = {}  # in their order, each once

    def _place(self, now: float) -> float:
        """A time of the robot's clock in s on the timeline."""
        return self.begin + now - (self._begin or now)

    def _make_robot(self, now: float) -> Robot:
        identity = msgspec.structs.replace(self._head.identity, platform=self._platform)
        return make_robot(identity, now, self._head.earlier)

    @property
    def parity(self) -> Parity:
        """The comparison so far."""
        notes = tuple(self._notes)
        return Parity(self.safe, self.requested, self._last, notes, self.difference)

    def take(self, message: RecordedMessage) -> None:
        """Replay the next message; ConfigError if the recorded robot cannot continue."""
        now = clock_of(self._about, message.at)
        if self._begin is None:
            self._begin = now
            if not self._recalls:
                self._robot = self._make_robot(now)
        self._last = max(self._last, now - self._begin)
        try:
            self._take(message, now)
        except (CodecError, msgspec.MsgspecError) as error:
            self._lose(f"{message.topic} cannot be read: {error}")
        except Exception as error:  # a damaged memory may give fields of any value
            if not self._recalls or isinstance(error, SwarmError):
                raise
            raise ConfigError(
                f"the robot of the recorded memory fails at {self._place(now):.3f} s"
                f" ({error!r:.200}); expected the recording of a robot, whole and unchanged"
            ) from error

    def _take(self, message: RecordedMessage, now: float) -> None:
        if message.topic == "/dropped" or message.follows_gap:
            before = f"before {self._place(now):.3f} s"
            self._lose(f"{before} entries were dropped or are damaged or missing")
        # Also while inputs are skipped: the ray directions of a scan are needed for later scans.
        input = self._inputs.read(message)
        if self.changes is not None:
            self._note_change(self.changes, message, input)
        if message.topic == INCIDENT:
            self._take_incident(message)
        elif message.topic == MEMORY and self._awaits_memory:
            self._robot = recall(memory_in(message), self._head.identity.setup)
            self._actions = None
            self._awaits_memory = False
            self._steps_pattern = False
        elif self._awaits_memory:
            pass
        elif message.topic == "/decision":
            self._compare(message, now)
        elif input is not None:
            self._step(*input)

    def _take_incident(self, message: RecordedMessage) -> None:
        """Keep an incident with what came before it; one that cannot be read is left out."""
        with suppress(CodecError, msgspec.MsgspecError, ValueError, RecursionError):
            text = messages.message_on(message.topic, message.kind, message.payload)
            incident = msgspec.json.decode(text.json, type=Incident)
            # A robot may hear of it later; the stamp is the time of the incident itself.
            at = clock_of(self._about, round(1e9 * messages.stamp_of(text)))
            self.incidents.append(Noted(incident, self._place(at), tuple(self.last)))
            if self.changes is not None:
                self.changes.take_mark(
                    f"incident {incident.id} of {incident.robot}", self._place(at)
                )

    def _note_change(
        self, changes: Changes, message: RecordedMessage, input: TimedInput | None
    ) -> None:
        """Hand a message to the changes of the robot, also while a memory is awaited."""
        if input is not None:
            changes.take_input(input.input, self._place(input.now))
        elif message.topic in ("/decision", EVENT):
            with suppress(CodecError):  # `_take` tells a decision that cannot be read
                read = messages.message_on(message.topic, message.kind, message.payload)
                if message.topic == EVENT:
                    at = 10**9 * read.stamp.sec + read.stamp.nanosec
                    changes.take_event(read.msg, self._place(clock_of(self._about, at)))
                else:
                    changes.take_decision(read, self._place(clock_of(self._about, message.at)))

    def _lose(self, what: str) -> None:
        """Note that an input is lost, so that the robot here knows less than the recorded one."""
        self._awaits_memory = self._recalls
        after = "are compared from the next memory on" if self._awaits_memory else "may differ"
        self._note(f"{what}; later commands {after}")

    def _step(self, input: Input, now: float) -> None:
        if isinstance(input, RequestInput) and not self._recalls:
            request = input.request
            if isinstance(request, StopRequest) and now - request.age < (self._begin or 0.0):
                return  # a new robot does not know which requests were executed before
        if isinstance(input, HostInput) and isinstance(input.event, Stepped):
            self._compare_requested(input.event, now)
        self.last.append((input, self._place(now)))
        with np.errstate(all="ignore"):  # a damaged memory may contain any numbers
            actions = self._robot.step(input, now)
        if actions is not None:
            self._carry_out(actions)

    def _compare_requested(self, event: Stepped, now: float) -> None:
        """Compare the answer of the pattern here with the recorded answer `event`."""
        if not self._steps_pattern:
            self._note(
                "a recording has no memory of the pattern that runs when it begins or goes on after"
                " a loss: what patterns request is compared from the next run on"
            )
            return
        # A step of an earlier load that the recorded host never answered, since it was killed.
        while self._steps and self._steps[0].generation < event.generation:
            self._steps.popleft()
        if self._steps and self._steps[0].generation == event.generation:
            own = self._steps.popleft()
            replayed = own.outputs.twist or ZERO
            recorded = event.outputs.twist or ZERO
            self.requested.add(replayed, recorded, self._place(now))
            self._differ("command of the pattern", recorded, replayed, now)
        else:
            self._note("the pattern of the replay did not step where the recorded one did")

    def _carry_out(self, actions: Actions) -> None:
        """Hand the robot's host command to the executor of the pattern here."""
        self._actions = actions
        command = actions.host
        if command is None or isinstance(command, KillHost | StartTrial):
            return
        self._steps_pattern |= isinstance(command, Load)
        if not self._steps_pattern:
            return
        if isinstance(command, Load):
            self._loader.begin(self._origins)
        event = self._executor.handle(command)  # type: ignore[arg-type]
        if isinstance(command, Load) and isinstance(event, LoadRefused):
            self._note(
                f"the pattern {command.pattern} does not load here; a file of your own needs"
                f" --plugin-dir: {event.text}"
            )
        if isinstance(event, Stepped):
            self._steps.append(event)

    def _compare(self, recorded: RecordedMessage, now: float) -> None:
        message = messages.message_on(recorded.topic, recorded.kind, recorded.payload)
        self.last.append((message, self._place(now)))
        if self._actions is None:
            return
        decision = self._actions.decision
        self.safe.add(decision.safe, messages.twist_of(message.safe), self._place(now))
        reason = decision.reason or ""
        entry = DecisionEntry(0.0, message.cause, self._robot.state, reason, decision)
        own = messages.decision_message(entry, 0.0)
        if own.payload[STAMP_END:] != recorded.payload[STAMP_END:]:
            replayed = _fields_of(messages.deserialize(*own))
            for field, value in _fields_of(message).items():
                self._differ(field, value, replayed[field], now)

    def _differ(self, field: str, recorded: Any, replayed: Any, now: float) -> None:
        """Note a difference, unless there is an earlier one."""
        if self.difference is None and repr(recorded) != repr(replayed):
            self.difference = Difference(
                at=self._place(now),
                field=field,
                recorded=repr(recorded),
                replayed=repr(replayed),
                last=tuple(self.last),
            )

    def _note(self, text: str) -> None:
        if len(self._notes) < 20:
            self._notes.setdefault(" ".join(text.split())[:500])


def recordings_of(files: Iterable[RecordedFile]) -> list[list[RecordedFile]]:
    """The files grouped by recording; a restart of the daemon, or a stop, ends a recording."""
    recordings: dict[tuple[str | None, ...], list[RecordedFile]] = {}
    for file in files:
        key = tuple(file.about.get(name) for name in ("head", "wall_ns", "boot_ns"))
        recordings.setdefault(key, []).append(file)
    return list(recordings.values())


@dataclass(slots=True)
class Life:
    """The recording of one life of a robot's daemon, and the robot that repeats it.

    The last fields place it on the timeline of a swarm (`swarm.py`).
    """

    where: str  # the path of its first file
    head: RecordingHead
    about: Mapping[str, str]
    messages: list[RecordedMessage]
    replay: Replay
    notes: list[str]
    fault: str = ""  # why the robot of its memory could not continue
    place: Callable[[int], int] = int  # from the time of a message to the timeline, both in ns
    error: float = 0.0  # s, the largest error of `place`; inf: not known

    def take(self, message: RecordedMessage) -> None:
        """Replay the next message, unless the robot could not continue before."""
        try:
            if not self.fault:
                self.replay.take(message)
        except ConfigError as error:
            self.fault = str(error)

    def parity(self) -> Parity:
        """The comparison; ConfigError if the robot could not continue, or nothing was compared."""
        parity = self.replay.parity
        fault = self.fault
        if not fault and not parity.safe.count:
            fault = "no decision follows a memory; nothing can be compared"
        if fault:
            raise ConfigError(f"{self.where}: {fault}")
        return replace(parity, notes=(*self.notes, *parity.notes))


def prepare(
    files: list[RecordedFile],
    origins: Mapping[str, tuple[str, bool]],
    platform: Platform | None = None,
) -> Life:
    """Prepare to replay the files of one recording; ConfigError if the replay is impossible."""
    where = str(files[0].path)
    about = files[0].about
    if about.get("kind") == "merged":
        raise ConfigError(f"{where}: merged; expected the robot's own recording")
    head = head_of(about, where)
    recorded = _joined(files)
    notes = [_other_program(head)]
    fault = "another platform has no memory" if platform else _fault_of_memory(recorded, head)
    check_beginning(recorded, where, "; ".join(filter(None, (fault, fault and notes[0]))))
    if fault and not platform:
        notes.append(f"{fault}; what the robot learned before is not repeated")
    replayed = Replay(head, about, origins, platform, recalls=not fault)
    return Life(where, head, about, recorded, replayed, [*filter(None, notes)])


def _joined(files: Iterable[RecordedFile]) -> list[RecordedMessage]:
    """The messages of a recording's parts in the order of their numbers, with gaps marked.

    Of several copies of a part a whole one counts, else the longest.
    """
    copies = sorted(files, key=lambda file: (not file.fault, len(file.messages)))
    parts = {
        int(text): file
        for file in copies
        if file.messages and (text := file.about.get("file", "")[:9]).isdecimal()
    }
    recorded: list[RecordedMessage] = []
    expected = min(parts, default=0)
    for number, part in sorted(parts.items()):
        first, *others = part.messages
        recorded += [
            replace(first, follows_gap=first.follows_gap or number != expected),
            *others,
        ]
        expected = -1 if part.fault else number + 1
    return recorded


def memory_in(message: RecordedMessage) -> bytes:
    """The bytes of a message on the topic MEMORY; CodecError if it is malformed."""
    return bytes(messages.message_on(message.topic, message.kind, message.payload).data)


def _fault_of_memory(recorded: Iterable[RecordedMessage], head: RecordingHead) -> str:
    """Why the first memory of a recording cannot be read; empty if it can."""
    first = next((message for message in recorded if message.topic == MEMORY), None)
    if first is None:
        return "it has no memory of the robot"
    try:
        recall(memory_in(first), head.identity.setup)
    except CodecError as error:
        return f"its memory of the robot cannot be read here ({error})"
    return ""


def are_pinned(recordings: Iterable[Sequence[RecordedFile]]) -> bool:
    """Whether pinned processes made all these recordings; False for none, or without their heads.

    The robot of a daemon, which is not pinned, computes with the functions of its processor.
    """
    found = [_made_in(files[0]).get("pinned") == "yes" for files in recordings]
    return bool(found) and all(found)


def _made_in(file: RecordedFile) -> Mapping[str, str]:
    with suppress(ConfigError):  # `prepare` tells it
        return head_of(file.about, str(file.path)).made
    return {}


def _other_program(head: RecordingHead) -> str:
    """The differences between the recording program and this program that may change last bits."""
    setup = head.identity.setup
    libm = digest_of_libm()
    pairs = {
        "version": (setup.version, version("swarmd")),
        "kernels": (setup.kernels, describe_kernels()),
        "machine": (head.machine, machine()),
        "functions of the C library (libm)": (head.libm or libm, libm),
    }
    here = how_made()
    # An earlier version tells nothing of these. Pinned processes compute alike on any processor.
    names = [name for name in here if name in head.made]
    if here["pinned"] == head.made.get("pinned") == "yes":
        names = [name for name in names if name not in ("processor", "simd")]
    pairs |= {_FACTS.get(name, name): (head.made[name], here[name]) for name in names}
    texts = [f"{name} {there}, here {own}" for name, (there, own) in pairs.items() if there != own]
    return f"recorded with {'; '.join(texts)}: commands may differ by rounding" if texts else ""


def total(parities: Iterable[Parity]) -> Parity:
    """The sum of several parities; `first`: of the first recording with a difference."""
    safe = Compared()
    requested = Compared()
    seconds = 0.0
    notes: dict[str, None] = {}
    difference = None
    for parity in parities:
        difference = difference or parity.difference
        safe.include(parity.safe)
        requested.include(parity.requested)
        seconds += parity.seconds
        notes |= dict.fromkeys(parity.notes)
    return Parity(safe, requested, seconds, tuple(notes), difference)


def decision_text(decision: Any) -> str:
    """The message of a decision in a line, with the bound that decided: the tightest obstacle."""
    requested, safe = (
        f"{twist.linear:.3f} m/s {twist.angular:.3f} rad/s"
        for twist in (messages.twist_of(decision.requested), messages.twist_of(decision.safe))
    )
    state = " ".join(filter(None, (decision.state, decision.reason)))
    word = protection_word(
        is_active=decision.is_active,
        is_recovering=decision.is_recovering,
        avoiding=decision.avoiding,
    )
    by = " ".join(filter(None, (decision.mode, word)))
    text = f"{state}, {by}: {requested} -> {safe}"
    columns = decision.bearings, decision.gaps, decision.caps
    if not all(len(column) for column in columns):
        return text
    bearing, gap, cap = (float(column[0]) for column in columns)
    return f"{text}, an obstacle at {math.degrees(bearing):.0f} deg, {gap:.2f} m, cap {cap:.3f} m/s"


def _fields_of(decision: Any) -> dict[str, Any]:
    """The fields of a decision's message by name, except its header."""
    return {
        **{name: getattr(decision, name) for name in ("state", "reason", "mode", "scan_seq")},
        **{name: messages.twist_of(getattr(decision, name)) for name in ("requested", "safe")},
        **{name: getattr(decision, name).tolist() for name in ("bearings", "gaps", "caps")},
        **{name: getattr(decision, name) for name in ("gap", "scan_age", "speed_share")},
        **{name: getattr(decision, name) for name in ("is_active", "is_recovering", "avoiding")},
    }


def _state_in(decision: RecordedMessage, where: str) -> str:
    try:
        return str(messages.message_on(decision.topic, decision.kind, decision.payload).state)
    except CodecError as error:
        raise ConfigError(f"{where}: its first decision cannot be read: {error}") from error


def check_beginning(recorded: list[RecordedMessage], where: str, fault: str) -> None:
    """ConfigError if the recording cannot be replayed from its beginning.

    1. Without a decision there is nothing to compare.
    2. Without a usable memory (`fault`: the reason) the replay begins with a new robot, which does
       not run. So the recorded robot must not run in its first decision.
    """
    first = next((message for message in recorded if message.topic == "/decision"), None)
    if first is None:
        raise ConfigError(f"{where}: no decision was recorded; nothing can be compared")
    if fault and _state_in(first, where) == State.RUNNING:
        raise ConfigError(
            f"{where}: the recording begins in a run, and {fault}; expected the version of"
            " swarmd that recorded it, or a recording that was started before `run`"
        )

"""What changed for a robot in a recording, as lines: its state, its sensors, requests, its log.

Each source of changes is a track, such as the decision or the base. A line tells a change of a
track; what stays equal has no line. Sensors have lines when they fall silent, and when their scans
repeat.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.events import (
    CodeInput,
    DriverInput,
    DuplicateInput,
    GoalInput,
    HazardsInput,
    HostInput,
    Input,
    LeaveInput,
    NeighborsInput,
    NetworkInput,
    NoteInput,
    OdometryInput,
    RangesInput,
    RequestInput,
    RosterInput,
    ScanInput,
    TickInput,
    tag_of,
)
from swarmd.core.host_messages import (
    HostDied,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    Stepped,
    TrialDone,
)
from swarmd.core.messages import State
from swarmd.core.values import Scan
from swarmd.operator.texts.values import seconds
from swarmd.operator.texts.why import protection_word, standing_of
from swarmd.robot.sensing.conditioning import COMPARED_SCANS, MIN_DISTINCT_RETURNS

MAX_LINES = 200
"""Changes that are told: the last ones."""
MAX_CHANGES = 20_000
"""Changes that are kept; a recording may come from a stolen robot."""
BRIEF = 1.0
"""Seconds: changes of what protection does that follow each other so soon are one line."""
SILENT = 1.0
"""Seconds without an input that came regularly, after which it counts as missing."""
SILENT_PERIODS = 5.0
"""The same in periods of the input, for slow sensors."""
REPEATS = 3
"""Scans in a row that repeat earlier ones, from which they are told."""
_ORDINARY = frozenset({"", "no_requested_command", "protection"})
"""Reasons in a run that are no fault: they may change many times a second."""
_REGULAR = (ScanInput, RangesInput, OdometryInput, TickInput)
_FIGURES = re.compile(r"( at)? -?\d+ deg|, -?\d+(\.\d+)? m\b")
"""Directions and distances in the words of avoidance, which change with each decision."""
_WORDS = {"tick": "tick of the daemon", "host": "pattern host", "note": "log"}


class Change(NamedTuple):
    """A line at `at` s on the timeline."""

    at: float
    text: str


class _Decided(NamedTuple):
    """A change of the decision; `is_ordinary`: in a run, without a fault before or after it."""

    at: float
    before: str
    after: str
    bound: str  # the obstacle that limits the command, in words
    is_ordinary: bool


class _Repeats:
    """The scans of one sensor: from which one on they repeat earlier ones."""

    def __init__(self, word: str) -> None:
        self._word = word
        self._recent: deque[bytes] = deque(maxlen=COMPARED_SCANS)
        self._since = 0.0
        self._count = 0

    def take(self, scan: Scan, at: float) -> Iterator[Change]:
        """Take the next scan; the lines that it completes."""
        returns = scan.ranges[np.isfinite(scan.ranges)]
        if len(np.unique(returns)) < MIN_DISTINCT_RETURNS:
            return
        ranges = scan.ranges.tobytes()
        if ranges in self._recent:
            self._since = self._since if self._count else at
            self._count += 1
            if self._count == REPEATS:
                yield Change(self._since, f"{self._word}: its ranges repeat from here on")
            return
        self._recent.append(ranges)
        if self._count >= REPEATS:
            yield Change(at, f"{self._word}: its ranges differ again, after {self._count} repeats")
        self._count = 0


class Changes:
    """Takes the inputs, decisions and events of one robot in their order, and gives the lines."""

    def __init__(self) -> None:
        self._changes: list[Change] = []
        self._decided: list[_Decided] = []
        self._state: tuple[str, bool] | None = None  # the last decision: words, whether ordinary
        self._tracks: dict[str, str] = {}  # by track: its last text
        self._repeats: dict[type[Input], _Repeats] = {}
        self._regular: dict[type[Input], tuple[float, float]] = {}  # the last time, and the period
        self._noted: set[str] = set()
        self._requests: set[str] = set()  # the ids of those that were told
        self._end = 0.0

    def take_input(self, input: Input, at: float) -> None:
        """Take an input at `at` s."""
        self._end = max(self._end, at)
        kind = type(input)
        if kind in _REGULAR:
            self._arrived(kind, tag_of(input), at)
        if isinstance(input, ScanInput | RangesInput):
            repeats = self._repeats.setdefault(kind, _Repeats(tag_of(input)))
            for change in repeats.take(input.scan, at):
                self._add(change)
            return
        if isinstance(input, NoteInput):
            self._noted.add(input.text)
        if isinstance(input, RequestInput):
            if input.request.id in self._requests:  # robots repeat a stop for a minute
                return
            self._requests.add(input.request.id)
        fact = _fact_of(input)
        if fact is not None and self._tracks.get(fact[0]) != fact[1]:
            self._tracks[fact[0]] = fact[1]
            self._add(Change(at, f"{fact[0]}: {fact[1]}"))
        elif _is_event(input):
            self._add(Change(at, input_text(input)))

    def take_decision(self, decision: Any, at: float) -> None:
        """Take the message of a decision at `at` s."""
        self._end = max(self._end, at)
        words = _decision_words(decision)
        is_ordinary = decision.state == State.RUNNING and decision.reason in _ORDINARY
        before = self._state
        self._state = (words, is_ordinary)
        if before is None:
            self._add(Change(at, words))
        elif before[0] != words and len(self._decided) < MAX_CHANGES:
            both = is_ordinary and before[1]
            self._decided.append(_Decided(at, before[0], words, _bound(decision), both))

    def take_event(self, text: str, at: float) -> None:
        """Take a line of the robot's log; a line that the daemon noted is told once."""
        if text not in self._noted:
            self._add(Change(at, f"log: {text}"))

    def take_mark(self, text: str, at: float) -> None:
        """Take a line of its own, such as the incident itself."""
        self._add(Change(at, text))

    def lines(self, until: float = np.inf) -> list[Change]:
        """The changes until `until` s in the order of time: the last MAX_LINES."""
        found = [*self._changes, *_folded(self._decided), *self._missing()]
        told = sorted((one for one in found if one.at <= until), key=lambda one: one.at)
        left_out = len(told) - MAX_LINES
        if left_out <= 0:
            return told
        first = Change(told[0].at, f"{left_out} earlier changes are left out")
        return [first, *told[left_out:]]

    def _add(self, change: Change) -> None:
        if len(self._changes) < MAX_CHANGES:
            self._changes.append(change)

    def _arrived(self, kind: type[Input], tag: str, at: float) -> None:
        """Note the arrival of an input that comes regularly, and the silence before it."""
        last, period = self._regular.get(kind, (at, 0.0))
        gap = at - last
        if period and gap > max(SILENT, SILENT_PERIODS * period):
            self._add(Change(last, f"{_word(tag)}: the last one for {seconds(gap)}"))
        else:
            period = gap
        self._regular[kind] = at, period

    def _missing(self) -> Iterator[Change]:
        """The inputs that came regularly and have not come until the end."""
        for kind, (last, period) in self._regular.items():
            if self._end - last > max(SILENT, SILENT_PERIODS * period):
                word = _word(str(kind.__struct_config__.tag))
                yield Change(last, f"{word}: the last one in the recording")


def input_text(input: Input) -> str:
    """An input in words, such as `pattern host: stepped` or `log: a chair fell`."""
    tag = tag_of(input)
    detail = _detail_of(input)
    return f"{_word(tag)}: {detail}" if detail else _word(tag)


def _word(tag: str) -> str:
    return _WORDS.get(tag, tag)


def _detail_of(input: Input) -> str:
    """What an input says, in a few words; empty if its kind says all."""
    match input:
        case ScanInput() | RangesInput():
            return f"{len(input.scan.ranges)} rays, sequence {input.scan.seq}"
        case RequestInput():
            return f"{input.request.verb} by {input.request.operator}"
        case HostInput():
            return _host_text(input.event)
        case NoteInput() | NetworkInput() | RosterInput():
            return input.text
    fact = _fact_of(input)
    return "" if fact is None else fact[1]


def _host_text(event: Any) -> str:
    """An event of the pattern host, in words."""
    match event:
        case Stepped():
            twist = event.outputs.twist
            if twist is None:
                return "stepped, requests no motion"
            return f"stepped, requests {twist.linear:.3f} m/s {twist.angular:.3f} rad/s"
        case Loaded():
            return "loaded the pattern"
        case LoadRefused():
            return f"refused to load the pattern: {event.text}"
        case ParamsSet():
            return f"refused parameters: {event.text}" if not event.params else "set parameters"
        case PatternFailed():
            return f"the pattern failed: {event.text}"
        case HostDied():
            return f"ended by itself: {event.text}"
        case TrialDone():
            return f"tried a pattern: {event.text or 'it can be loaded'}"
    return str(type(event).__name__)


def _fact_of(input: Input) -> tuple[str, str] | None:
    """The track of an input that holds until the next one, and its text; None for other inputs."""
    match input:
        case DriverInput():
            state = "connected" if input.is_up else "lost"
            hold = f"hold {input.hold}" if input.hold else ""
            return "base", ", ".join(filter(None, (state, hold, input.text)))
        case HazardsInput():
            return "hazards", ", ".join(one.text for one in input.hazards) or "none"
        case NeighborsInput():
            names = sorted(one.id for one in input.neighbors if one.in_reach)
            return "neighbors in reach", ", ".join(names) or "none"
        case DuplicateInput():
            return "daemons with its id", input.holder or "itself alone"
        case GoalInput():
            return "goal that a peer holds", input.goal.text
    return None


def _is_event(input: Input) -> bool:
    """True for an input that has a line of its own each time."""
    if isinstance(input, HostInput):
        return not isinstance(input.event, Stepped)
    kinds = RequestInput, NoteInput, NetworkInput, RosterInput, LeaveInput, CodeInput
    return isinstance(input, kinds)


def _decision_words(decision: Any) -> str:
    """State and reason of a decision, and what protection does if that is not the reason."""
    standing = standing_of(decision.state, decision.reason)
    words = " ".join(filter(None, (standing or decision.state, decision.reason)))
    protection = protection_word(
        is_active=decision.is_active,
        is_recovering=decision.is_recovering,
        avoiding=_FIGURES.sub("", decision.avoiding),
    )
    has_word = decision.state == State.RUNNING and decision.reason in ("", "no_requested_command")
    return f"{words}, {protection}" if has_word and protection != "clear" else words


def _bound(decision: Any) -> str:
    """The tightest obstacle of a decision, in words; empty without one."""
    if not (len(decision.bearings) and len(decision.gaps)):
        return ""
    bearing = float(decision.bearings[0])
    gap = float(decision.gaps[0])
    return f", an obstacle at {np.degrees(bearing):.0f} deg, {gap:.2f} m"


def _folded(decided: list[_Decided]) -> Iterator[Change]:
    """The lines of changed decisions; ordinary ones that follow each other soon are one line."""
    group: list[_Decided] = []
    for one in decided:
        if group and not (one.is_ordinary and one.at - group[-1].at <= BRIEF):
            yield from _lines_of(group)
            group = []
        if one.is_ordinary:
            group.append(one)
        else:
            yield Change(one.at, f"{one.before} -> {one.after}{one.bound}")
    yield from _lines_of(group)


def _lines_of(group: list[_Decided]) -> Iterator[Change]:
    """One line for a group of more than two ordinary changes, else a line for each."""
    if len(group) <= 2:
        yield from (Change(one.at, f"{one.before} -> {one.after}{one.bound}") for one in group)
        return
    words = dict.fromkeys([group[0].before, *(one.after for one in group)])
    text = f"{len(group)} changes until {group[-1].at:.3f} s among {'; '.join(words)}"
    yield Change(group[0].at, text)

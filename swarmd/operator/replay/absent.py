"""What the recordings of others tell of a robot of which no recording is here.

A robot that was killed writes its minute when its daemon has started again, so at first only its
peers have recordings. Each line has whose words it is, and how old it was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from swarmd.core.errors import CodecError
from swarmd.core.events import KinInput, MessageInput, NeighborsInput, PlaceInput
from swarmd.core.goal import GoalStatus
from swarmd.core.incident import Incident
from swarmd.core.values import Neighbor
from swarmd.core.verbs import shortened
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.inputs import InputReader
from swarmd.daemon.recording.lost_member import LOST, LostMember
from swarmd.daemon.recording.reader import RecordedMessage
from swarmd.operator.replay.replay import INCIDENT, Life
from swarmd.operator.texts.values import counted, seconds


class Word(NamedTuple):
    """What the robot `by` knew at `at` s on the timeline."""

    at: float
    by: str
    text: str


class ToldIncident(NamedTuple):
    """An incident in a recording, at `at` s on the timeline."""

    incident: Incident
    at: float


class _StatusGoal(msgspec.Struct):
    """The goals in a status."""

    goal: GoalStatus | None = None


@dataclass(frozen=True, slots=True)
class Absent:
    """A robot without a recording, as others knew it.

    - `incidents`: those of this robot, each once. `others`: the ids of other incidents.
    - `words`: by robot with a recording, what it knew last, the latest first; it may be empty.
    - `end`: s on the timeline of its first incident, else of the end of all recordings.
    - `is_here`: a recording of the robot is here, and is not repeated.
    """

    robot: str
    incidents: Sequence[ToldIncident]
    others: Sequence[str]
    words: dict[str, list[Word]]
    end: float
    is_here: bool

    def lines(self, folder: str = "FOLDER") -> Iterator[str]:
        """The lines for a user; `folder`: where the recordings are, as the user typed it."""
        for told in self.incidents:
            yield f"{told.incident.line(told.at)} (told by {told.incident.by})"
        here = shortened(", ".join(sorted(self.words)), 200)
        if self.is_here:
            yield (
                f"{self.robot}: its recording is here, and is not repeated; a warning, or the"
                f" option --life, says why. Repeated: {here}"
            )
        else:
            yield f"{self.robot}: no recording of it is here. Here: {here}"
            yield f"  {self._when(folder)}"
        since = "its incident" if self.incidents else "the end of the recordings"
        yield f"what others last knew of {self.robot}, before {since}:"
        for by, words in sorted(self.words.items()):
            if not words:
                yield f"  {by}: nothing of it is in its recording"
            for word in words:
                age = self.end - word.at
                when = f"{seconds(age)} before" if age >= 0.0 else f"{seconds(-age)} after"
                yield f"  {by}, {when}: {word.text}"

    def _when(self, folder: str) -> str:
        """When its minute comes, as far as is known, and what to do then."""
        ids = [told.incident.id for told in self.incidents] or list(self.others)
        fetch = f"`swarmctl incidents fetch {ids[0]} -d {folder}`" if ids else "fetch it again"
        return (
            "A daemon that was killed or has crashed writes its minute when it has started again, a"
            f" daemon that lives 10 s after the incident: then {fetch}. A reboot or a power cut"
            " before that loses the minute."
        )


def absent(robot: str, lives: Sequence[Life], *, is_here: bool) -> Absent | None:
    """What the recordings `lives` of others tell of a robot; None if none names it."""
    begin = min(life.place(life.messages[0].at) for life in lives)
    own: dict[str, tuple[tuple[bool, float], ToldIncident]] = {}
    others: dict[str, None] = {}
    words: dict[str, list[Word]] = {}
    end = 0.0
    for life in lives:
        reader = _Reader(life, robot, begin)
        for message in life.messages:
            reader.take(message)
        for told in reader.incidents:
            if told.incident.robot == robot:
                # A robot that heard of it has its time by the delay of the way: the teller counts.
                rank = told.incident.by != reader.by, told.at
                if told.incident.id not in own or rank < own[told.incident.id][0]:
                    own[told.incident.id] = rank, told
            else:
                others[told.incident.id] = None
        found = sorted(reader.last.values(), reverse=True)
        words.setdefault(reader.by, []).extend(found)
        end = max(end, reader.end)
    incidents = sorted((told for _, told in own.values()), key=lambda told: told.at)
    if not incidents and not any(words.values()):
        return None
    end = incidents[0].at if incidents else end
    return Absent(robot, incidents, list(others), words, end, is_here)


class _Reader:
    """Reads the recording of one life for what it tells of `robot`.

    `last`: by kind of word the last one. `begin`: ns, of the timeline.
    """

    def __init__(self, life: Life, robot: str, begin: int) -> None:
        self._life = life
        self._robot = robot
        self._begin = begin
        self._inputs = InputReader()
        self._knows_goal = False  # that of `robot`, by its last beacon
        self._is_told = False  # its incident, which ends what others knew of it before
        self.by = life.head.identity.robot
        self.last: dict[str, Word] = {}
        self.incidents: list[ToldIncident] = []
        self.end = 0.0

    def take(self, message: RecordedMessage) -> None:
        """Take the next message; one that cannot be read is left out."""
        at = self._time(message.at)
        self.end = max(self.end, at)
        with suppress(CodecError, msgspec.MsgspecError, ValueError, RecursionError):
            self._take(message, at)

    def _time(self, at: int) -> float:
        return 1e-9 * (self._life.place(at) - self._begin)

    def _take(self, message: RecordedMessage, at: float) -> None:
        timed = self._inputs.read(message)
        if timed is not None:
            for kind, text in _words_of(timed.input, self._robot):
                self.last[kind] = Word(at, self.by, text)
            return
        if message.topic not in (INCIDENT, LOST, "/clock/pair", "/status"):
            return
        read = messages.message_on(message.topic, message.kind, message.payload)
        if message.topic == INCIDENT:
            incident = msgspec.json.decode(read.json, type=Incident)
            stamp = round(1e9 * messages.stamp_of(read))
            self.incidents.append(ToldIncident(incident, self._time(stamp)))
            self._is_told = self._is_told or incident.robot == self._robot
        elif message.topic == LOST:
            lost = msgspec.json.decode(read.json, type=LostMember)
            if lost.robot == self._robot:
                self.last["lost"] = Word(at, self.by, _lost_text(lost))
                self._knows_goal = bool(lost.goal)
                if lost.goal:
                    self.last.pop("goal", None)
        elif message.topic == "/clock/pair":
            if read.peer == self._robot:
                text = f"answered a query of its clock, round trip {_ms(read.returned - read.sent)}"
                self.last["clock"] = Word(at, self.by, text)
        elif self.last and not (self._knows_goal or self._is_told):
            goal = msgspec.json.decode(read.json, type=_StatusGoal).goal
            if goal is not None and goal.held is not None:
                text = f"{self.by} held {goal.held.goal.text}; which goal {self._robot} held is not"
                self.last["goal"] = Word(at, self.by, f"{text} recorded")


def _words_of(input: object, robot: str) -> Iterator[tuple[str, str]]:
    """What an input tells of a robot: the kind of the word, and its text."""
    match input:
        case NeighborsInput():
            for neighbor in input.neighbors:
                if neighbor.id == robot:
                    yield "neighbor", _neighbor_text(neighbor)
        case PlaceInput():
            place = input.place
            if place.robot == robot:
                yield (
                    "place",
                    f"at {place.x:.2f}, {place.y:.2f} m in frame {place.frame}, within"
                    f" {place.error:.2f} m; measured {seconds(place.age)} earlier",
                )
        case KinInput():
            if input.robot == robot:
                yield "kin", "told its motion by odometry"
        case MessageInput():
            if input.sender == robot and not input.is_program:
                yield "message", f"its pattern sent {input.channel}"


def _neighbor_text(neighbor: Neighbor) -> str:
    """A neighbor in words, and where it was.

    An age of 0 may be that of a member of the list, which was heard within the time after which a
    silent one counts as failed; so it tells nothing.
    """
    parts = ["in its list of neighbors"]
    if neighbor.age:
        parts.append(f"heard or sensed {seconds(neighbor.age)} earlier, to within 0.5 s")
    if neighbor.distance is not None:
        parts.append(f"{neighbor.distance:.2f} m away")
    if neighbor.bearing is not None:
        parts.append(f"at {math.degrees(neighbor.bearing):.0f} deg")
    if neighbor.distance is None:
        parts.append("its place not known")
    if not neighbor.in_reach:
        parts.append("out of reach by range or link")
    return ", ".join(parts)


def _lost_text(lost: LostMember) -> str:
    """The last beacon of a robot that has failed, and the link to it."""
    parts = ["declared failed"]
    age = "" if lost.age is None else f" {seconds(lost.age)} earlier"
    parts.append(f"its last beacon{age}: {' '.join(filter(None, (lost.state, lost.platform)))}")
    if lost.received + lost.lost:
        beacons = counted(lost.received + lost.lost, "last beacon")
        parts.append(f"{lost.lost} of {beacons} lost, the overdue ones included")
    if lost.round_trip is not None:
        parts.append(f"round trip {_ms(lost.round_trip)}")
    parts.append(lost.goal or "its goal is not known")
    return "; ".join(parts)


def _ms(value: float) -> str:
    return f"{1e3 * value:.1f} ms"

"""Puts recordings of one robot or several, or a merged file, on one timeline.

A message is decoded only when it is read, so that an hour of recording opens at once.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.incident import Incident
from swarmd.core.messages import Status
from swarmd.core.values import Platform, Pose, Scan
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.merge import messages_of, place, survey
from swarmd.daemon.recording.reader import read_file
from swarmd.settings.platforms import load_platform

SILENCE = 3.0
"""Seconds without any message after which a robot counts as not recorded."""
APART = 1.0
"""Metres between the start poses of robots without a shared frame: these are not known."""
MAX_DECODED = 4
"""Messages of a topic that stay decoded: the last ones before and after the present time."""
MAX_STEP = 1.0
"""Seconds between two poses up to which the poses between them are interpolated."""
TimedMessage = tuple[int, str, str, bytes]
"""The time in ns, the topic `/robot/...`, the type and the content of a message."""
_TOPICS = frozenset(
    (
        *("odometry", "pose", "scan", "scan/geometry", "decision", "status", "readings"),
        *("event", "incident"),
    )
)


class Topic:
    """The messages of a topic by time in s; each is decoded when it is read."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.times: list[float] = []
        self._payloads: list[tuple[str, bytes]] = []
        self._decoded: dict[int, Any] = {}

    def add(self, at: float, kind: str, payload: bytes) -> None:
        """Add a message; in order of time."""
        self.times.append(at)
        self._payloads.append((kind, payload))

    def index(self, now: float) -> int:
        """The index of the last message until a time; -1 before the first message."""
        return bisect_right(self.times, now) - 1

    def get(self, index: int) -> Any | None:
        """The message with this index; None for an unknown index or a malformed message."""
        if not 0 <= index < len(self._payloads):
            return None
        if index not in self._decoded:
            while len(self._decoded) >= MAX_DECODED:
                del self._decoded[next(iter(self._decoded))]
            message = None
            with suppress(CodecError):
                message = messages.message_on(self._name, *self._payloads[index])
            self._decoded[index] = message
        return self._decoded[index]

    def at(self, now: float) -> Any | None:
        """The last message until a time."""
        return self.get(self.index(now))


class Track:
    """The recording of one robot: `about` as texts, topics by name, and the number of losses."""

    def __init__(self, about: Mapping[str, str], platform: Platform) -> None:
        self.about = about
        self.platform = platform
        self.topics = {topic: Topic(topic) for topic in _TOPICS}
        self.dropped = 0  # how often the recorder noted that it had dropped entries
        self.end = 0.0
        self._heard: list[float] = []

    def add(self, at: float, topic: str, kind: str, payload: bytes) -> None:
        """Add a message; in order of time."""
        if not self._heard or at - self._heard[-1] > 0.1 * SILENCE:
            self._heard.append(at)
        self.end = at
        self.dropped += topic == "dropped"
        if topic in _TOPICS:
            self.topics[topic].add(at, kind, payload)

    @property
    def begin(self) -> float:
        """The time of the first message in s; 0 without a message."""
        return self._heard[0] if self._heard else 0.0

    def is_heard(self, now: float) -> bool:
        """True if a message was recorded within SILENCE before a time."""
        last = bisect_right(self._heard, now) - 1
        return last >= 0 and now - self._heard[last] < SILENCE

    def pose(self, topic: str, now: float) -> Pose | None:
        """The pose at a time, interpolated; None before the first one, or if not recorded."""
        poses = self.topics[topic]
        index = poses.index(now)
        message = poses.get(index)
        after = poses.get(index + 1)
        if message is None or not self.is_heard(now):
            return None
        pose = _pose_of(topic, message)
        at = poses.times[index]
        if after is None or not 0.0 < poses.times[index + 1] - at < MAX_STEP:
            return pose
        next_pose = _pose_of(topic, after)
        share = (now - at) / (poses.times[index + 1] - at)
        turn = math.remainder(next_pose.yaw - pose.yaw, 2.0 * math.pi)
        x = pose.x + share * (next_pose.x - pose.x)
        y = pose.y + share * (next_pose.y - pose.y)
        return Pose(x, y, pose.yaw + share * turn)

    def scan(self, now: float) -> Scan | None:
        """The last scan until a time; None without a scan, or if its bearings are missing."""
        message = self.topics["scan"].at(now)
        if message is None or not self.is_heard(now):
            return None
        scan = messages.scan_of(message, 0, self.topics["scan/geometry"].at(now))
        return scan if len(scan.ranges) == len(scan.bearings) else None

    def status(self, now: float) -> Status | None:
        """The last status until a time."""
        message = self.topics["status"].at(now)
        with suppress(ValueError, RecursionError):
            return None if message is None else msgspec.json.decode(message.json, type=Status)
        return None

    def decision(self, now: float) -> Any | None:
        """The message of the last decision until a time; None without such a message."""
        return self.topics["decision"].at(now) if self.is_heard(now) else None

    def incidents(self) -> Iterator[tuple[float, Incident]]:
        """The incidents that the robot knew of, with the time in s at which it noted each."""
        topic = self.topics["incident"]
        for index, at in enumerate(topic.times):
            message = topic.get(index)
            with suppress(ValueError, RecursionError):
                if message is not None:
                    yield at, msgspec.json.decode(message.json, type=Incident)

    def events(self, now: float, most: int | None = None) -> list[tuple[float, str]]:
        """The last events until a time, as time in s and text; the latest comes first."""
        events = self.topics["event"]
        shown = range(events.index(now), -1, -1)[:most]
        found = [(events.times[i], events.get(i)) for i in shown]
        return [(at, str(one.msg)) for at, one in found if one is not None]


@dataclass(frozen=True, slots=True)
class Timeline:
    """The tracks of robots by name; times in s from the first odometry.

    Messages before the first odometry have negative times.
    """

    tracks: Mapping[str, Track]
    about: Mapping[str, str]  # texts of a merged file; otherwise empty
    notes: Sequence[str]  # lines on damaged parts, and on messages without a time
    is_shared: bool
    """All robots recorded poses in one shared frame. Otherwise each robot's pose is by its own
    odometry, and the robots are moved along y, APART m from one another."""

    @property
    def duration(self) -> float:
        """The time of the last message in s."""
        return max(track.end for track in self.tracks.values())

    def incident(self, name: str) -> tuple[float, Incident] | None:
        """The incident of the files whose name begins with its id, else the last; its time in s.

        Robots that hear of it later note it later: the earliest time counts. `name`: of a file.
        """
        found: dict[str, tuple[float, Incident]] = {}
        for track in self.tracks.values():
            for at, one in track.incidents():
                found[one.id] = min(found.get(one.id, (at, one)), (at, one), key=itemgetter(0))
        return max(
            found.values(), key=lambda one: (name.startswith(one[1].id), one[0]), default=None
        )

    def pose(self, robot: str, now: float) -> tuple[float, float, float] | None:
        """x, y in m and yaw in rad at a time; None before the first pose, or if not recorded."""
        pose = self.tracks[robot].pose("pose" if self.is_shared else "odometry", now)
        if pose is None:
            return None
        if self.is_shared:
            return pose.x, pose.y, pose.yaw
        place = list(self.tracks).index(robot) - (len(self.tracks) - 1) / 2.0
        return pose.x, pose.y + APART * place, pose.yaw


def read_timeline(paths: Sequence[Path]) -> Timeline:
    """Read recordings into the tracks of their robots, in the order of the robots' names.

    `paths`: recordings of robots, or a single merged recording. Times are in s from the first
    odometry. ConfigError if a file is no recording, if no file has a message, or if one of several
    files is a merged file.
    """
    first_file = read_file(paths[0])
    if first_file.about.get("kind") != "merged":
        notes: list[str] = []
        abouts, placed_messages = _placed(paths, notes)
        return _timeline(paths[0], {}, abouts, placed_messages, notes)
    if len(paths) > 1:
        raise ConfigError(f"{paths[0]}: merged already; expected it alone")
    fault = first_file.fault
    notes = [f"{paths[0]}: {fault}; what is whole is shown"] if fault else []
    merged_messages = (
        (message.at, message.topic, message.kind, message.payload)
        for message in first_file.messages
    )
    return _timeline(paths[0], first_file.about, first_file.robots, merged_messages, notes)


def _timeline(
    first_path: Path,
    about_merged: Mapping[str, str],
    abouts: Mapping[str, Mapping[str, str]],
    messages_of_all: Iterable[TimedMessage],
    notes: list[str],
) -> Timeline:
    """The messages of all robots as tracks; ConfigError without a message.

    `about_merged`: texts on a merged file, else empty. `abouts`: texts on each robot.
    """
    timed = sorted(messages_of_all, key=lambda message: message[0])
    if not timed:
        raise ConfigError(f"{first_path}: no messages in this recording")
    # Times count from the first odometry, from which on a robot has a place. Earlier messages have
    # negative times.
    odometry_times = (at for at, topic, *_ in timed if topic.endswith("/odometry"))
    start = next(odometry_times, timed[0][0])
    tracks: dict[str, Track] = {}
    for at, topic, kind, payload in timed:
        robot, _, robot_topic = topic[1:].partition("/")
        if robot not in tracks:
            about = abouts.get(robot, {})
            tracks[robot] = Track(about, _platform(about, f"the recording of {robot}"))
        tracks[robot].add(1e-9 * (at - start), robot_topic, kind, payload)
    tracks = dict(sorted(tracks.items()))
    return Timeline(tracks, about_merged, notes, is_shared=_is_shared(tracks.values()))


def _placed(
    paths: Sequence[Path], notes: list[str]
) -> tuple[Mapping[str, Mapping[str, str]], list[TimedMessage]]:
    """The texts on each robot, and the messages of all robots. Adds lines on faults to `notes`."""
    found = survey(paths)
    notes += [fault.replace("is merged", "is shown") for fault in found.faults]
    placed = place(found) if found.sources else []
    for one in placed:
        if one.alignment is None:
            notes.append(
                f"{one.source.robot}: no exchange with the clock of {placed[0].source.robot} was"
                " recorded; it is shown by its own wall clock"
            )
    timed = [
        (at, topic, kind, payload)
        for one in placed
        for at, topic, kind, _, payload in messages_of(one, placed[0].source.about)
    ]
    return {one.source.robot: one.source.about for one in placed}, timed


def _platform(about: Mapping[str, str], where: str) -> Platform:
    """The robot's platform as recorded; in another format, the installed one of its name."""
    try:
        return head_of(about, where).identity.platform
    except ConfigError:
        if "platform" not in about:
            raise
        return load_platform(about["platform"])


def _is_shared(tracks: Iterable[Track]) -> bool:
    """True if each robot recorded shared poses, whose first and last have one common frame."""
    topics = [track.topics["pose"] for track in tracks]
    ends = [topic.get(i) for topic in topics for i in (0, len(topic.times) - 1)]
    return None not in ends and len({messages.pose_of(one).frame for one in ends}) == 1


def _pose_of(topic: str, message: Any) -> Pose:
    if topic == "pose":
        return messages.pose_of(message).pose
    return messages.odometry_of(message).pose

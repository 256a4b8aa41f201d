"""Recordings of robots on the page: one timeline of one or several of them, or of a merged file.

Messages are decoded when they are shown, so that an hour of recording begins at once.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.messages import Member, Presence, Status
from swarmd.core.values import Array, Platform, Pose, Twist
from swarmd.recording import messages
from swarmd.recording.head import head_of
from swarmd.recording.merge import messages_of, place, survey
from swarmd.recording.reader import read_file
from swarmd.texts.status import sections
from swarmd.texts.why import protection_word
from swarmd.view.playback import Playback
from swarmd.view.source import ShownArena, ShownRobot, points_of, row_of

SILENCE = 3.0
"""Seconds without any message after which a robot counts as not recorded."""
MAX_EVENTS = 20
MAX_DECODED = 4
"""Messages of a topic that stay decoded: the last ones before and after the present time."""
MAX_STEP = 1.0
"""Seconds between two poses within which the page shows those in between."""
_TOPICS = frozenset(
    ("odometry", "pose", "scan", "scan/geometry", "decision", "status", "readings", "event")
)


class _Topic:
    """The messages of one topic by time in s; each is decoded when it is asked for."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self._payloads: list[tuple[str, bytes]] = []
        self._decoded: dict[int, Any] = {}

    def add(self, at: float, kind: str, payload: bytes) -> None:
        """Add a message; in order of time."""
        self.times.append(at)
        self._payloads.append((kind, payload))

    def index(self, now: float) -> int:
        """The number of the last message until a time; -1 before the first one."""
        return bisect_right(self.times, now) - 1

    def get(self, index: int) -> Any | None:
        """A message; None without one, or if it is malformed."""
        if not 0 <= index < len(self._payloads):
            return None
        if index not in self._decoded:
            while len(self._decoded) >= MAX_DECODED:
                del self._decoded[next(iter(self._decoded))]
            message = None
            with suppress(CodecError):
                message = messages.deserialize(*self._payloads[index])
            self._decoded[index] = message
        return self._decoded[index]

    def at(self, now: float) -> Any | None:
        """The last message until a time."""
        return self.get(self.index(now))


class _Recorded:
    """One robot: its topics, and when anything of it was recorded."""

    def __init__(self, name: str, platform: Platform) -> None:
        self.name, self.platform = name, platform
        self.topics = {topic: _Topic() for topic in _TOPICS}
        self.heard: list[float] = []
        self.end = 0.0

    def add(self, at: float, topic: str, kind: str, payload: bytes) -> None:
        """Add a message; in order of time."""
        if not self.heard or at - self.heard[-1] > 0.1 * SILENCE:
            self.heard.append(at)
        self.end = at
        if topic in _TOPICS:
            self.topics[topic].add(at, kind, payload)

    def is_heard(self, now: float) -> bool:
        """True if something was recorded within SILENCE before a time."""
        last = bisect_right(self.heard, now) - 1
        return last >= 0 and now - self.heard[last] < SILENCE

    def pose(self, topic: str, now: float) -> tuple[float, float, float] | None:
        """The pose at a time, between two messages interpolated."""
        found = self.topics[topic]
        index = found.index(now)
        message, after = found.get(index), found.get(index + 1)
        if message is None:
            return None
        one, at = _pose_of(topic, message), found.times[index]
        if after is None or not 0.0 < found.times[index + 1] - at < MAX_STEP:
            return one.x, one.y, one.yaw
        other, share = _pose_of(topic, after), (now - at) / (found.times[index + 1] - at)
        turn = math.remainder(other.yaw - one.yaw, 2.0 * math.pi)
        x, y = one.x + share * (other.x - one.x), one.y + share * (other.y - one.y)
        return x, y, one.yaw + share * turn

    def status(self, now: float) -> Status | None:
        """The last status until a time."""
        message = self.topics["status"].at(now)
        if message is None:
            return None
        with suppress(msgspec.MsgspecError):
            return msgspec.json.decode(message.json, type=Status)
        return None


class RecordingSource:
    """See `swarmd.view.source.Source`. Times count from the first message of all robots.

    Positions are those in the shared frame if every robot has recorded some, else those of each
    robot's own odometry. `notes`: lines on what is damaged, or could not be placed in time.
    """

    kind = "recording"
    arena: ShownArena | None = None
    patterns: Sequence[str] = ()
    revision = 0

    def __init__(self, paths: Sequence[Path], clock: Callable[[], float] = time.monotonic) -> None:
        """ConfigError if a file is no recording, or none has a message."""
        self.notes: list[str] = []
        found = _read(paths, self.notes)
        if not found:
            raise ConfigError(f"{paths[0]}: no messages in this recording")
        start = min(robot.heard[0] for robot in found)
        self._start = start
        self._recorded = {robot.name: robot for robot in found}
        self.robots = [
            ShownRobot(one.name, i, one.platform.name, one.platform.footprint)
            for i, one in enumerate(found)
        ]
        has_shared = all(one.topics["pose"].times for one in found)
        self._topic = "pose" if has_shared else "odometry"
        names = list(self._recorded)
        self.swarm = f"recording of {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}"
        run = paths[0].name
        self.playback = Playback([run], lambda _: None, clock)
        self.playback.load(run, max(robot.end for robot in found) - start)

    @property
    def _now(self) -> float:
        return self._start + self.playback.time

    def frame(self) -> tuple[float, Array]:
        """The pose of each robot that is recorded at the present time."""
        now = self._now
        found = []
        for shown in self.robots:
            robot = self._recorded[shown.name]
            pose = robot.pose(self._topic, now) if robot.is_heard(now) else None
            if pose is not None:
                found.append((shown.index, *pose))
        return now - self._start, np.array(found, dtype=np.float64).reshape(-1, 4)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The last status and decision of each robot."""
        now = self._now
        return {name: _row(robot, now) for name, robot in self._recorded.items()}

    def scan(self, name: str) -> Array | None:
        """The returns of the last scan."""
        robot, now = self._recorded.get(name), self._now
        if robot is None or not robot.is_heard(now):
            return None
        message = robot.topics["scan"].at(now)
        if message is None:
            return None
        geometry = robot.topics["scan/geometry"].at(now)
        scan = messages.scan_of(message, 0, geometry)
        if len(scan.ranges) != len(scan.bearings):
            return None
        return points_of(scan.ranges, scan.bearings, robot.platform.scan.offset)

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """Not known of a real room."""
        return ()

    def links(self) -> Sequence[tuple[int, int]]:
        """Not known."""
        return ()

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """What `describe` told, and the last lines of the robot's log."""
        robot, now = self._recorded.get(name), self._now
        if robot is None:
            return None
        status, log = robot.status(now), robot.topics["event"]
        last = log.index(now)
        lines = [(log.times[i], log.get(i)) for i in range(last, max(last - MAX_EVENTS, -1), -1)]
        titled: list[Any] = []
        if status is not None:
            alive = Presence.ALIVE
            member = Member(robot=name, instance=status.instance, presence=alive, age=0.0)
            titled = [[title, rows] for title, rows in sections(member, status)[:-1] if rows]
        events = [[f"{at - self._start:.1f} s", one.msg] for at, one in lines if one is not None]
        return {"sections": titled, "events": events}

    def select(self, names: Sequence[str]) -> None:
        """All is known of each robot already."""


def _read(paths: Sequence[Path], notes: list[str]) -> list[_Recorded]:
    """The robots of all files, in the order of their names."""
    robots: dict[str, _Recorded] = {}
    for about, at, topic, kind, payload in _timeline(paths, notes):
        name, _, rest = topic[1:].partition("/")
        if name not in robots:
            texts = about.get(name, {})
            robots[name] = _Recorded(name, head_of(texts, f"the recording of {name}").platform)
        robots[name].add(1e-9 * at, rest, kind, payload)
    return [robots[name] for name in sorted(robots)]


_About = Mapping[str, Mapping[str, str]]


def _timeline(
    paths: Sequence[Path], notes: list[str]
) -> Iterator[tuple[_About, int, str, str, bytes]]:
    """Texts on the robots, time in ns, topic with the robot's name, type and bytes."""
    first = read_file(paths[0])
    if first.about.get("kind") == "merged":
        if len(paths) > 1:
            raise ConfigError(f"{paths[0]}: merged already; expected it alone")
        if first.fault:
            notes.append(f"{paths[0]}: {first.fault}; what is whole is shown")
        for one in first.messages:
            yield first.robots, one.at, one.topic, one.kind, one.payload
        return
    found = survey(paths)
    notes += [fault.replace("is merged", "is shown") for fault in found.faults]
    placed = place(found) if found.sources else []
    abouts = {one.source.robot: one.source.about for one in placed}
    for source in placed:
        if source.alignment is None:
            notes.append(
                f"{source.source.robot}: no exchange with the clock of {placed[0].source.robot} was"
                " recorded; it is shown by its own wall clock"
            )
    every = [timed for one in placed for timed in messages_of(one, placed[0].source.about)]
    for at, topic, kind, _, payload in sorted(every, key=lambda timed: timed[0]):
        yield abouts, at, topic, kind, payload


def _row(robot: _Recorded, now: float) -> dict[str, Any]:
    if not robot.is_heard(now):
        return {"presence": "absent", "state": "", "why": "nothing is recorded at this time"}
    status, decision = robot.status(now), robot.topics["decision"].at(now)
    row: dict[str, Any] = {"presence": "alive"} if status is None else row_of(status)
    if decision is not None:
        row |= _decided(decision, row)
    limits = robot.platform.limits
    row["limits"] = [limits.linear, limits.angular, limits.lateral]
    readings = robot.topics["readings"].at(now)
    if readings is not None:
        row["readings"] = messages.readings_of(readings)
    return row


def _decided(decision: Any, row: Mapping[str, Any]) -> dict[str, Any]:
    """What a decision tells, which comes more often than a status."""
    is_running = decision.state == "running"
    protection = protection_word(is_active=decision.is_active, is_recovering=decision.is_recovering)
    reason = decision.reason.replace("_", " ")
    is_same = decision.state == row.get("state") and row.get("why", "").startswith(reason)
    columns = (decision.bearings, decision.gaps, decision.caps)
    return {
        "state": decision.state,
        "why": row["why"] if reason and is_same else reason,
        "protection": protection * is_running,
        "requested": _plain(messages.twist_of(decision.requested)),
        "safe": _plain(messages.twist_of(decision.safe)),
        "near": None if math.isnan(decision.gap) else decision.gap,
        "rows": [list(one) for one in zip(*(c.tolist() for c in columns), strict=True)],
    }


def _pose_of(topic: str, message: Any) -> Pose:
    if topic == "pose":
        return messages.pose_of(message).pose
    return messages.odometry_of(message).pose


def _plain(twist: Twist) -> list[float]:
    return [twist.linear, twist.angular, twist.lateral]

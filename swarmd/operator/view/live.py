"""The source of a page for a living swarm: statuses and motions of its robots."""

from __future__ import annotations

import contextlib
import math
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from msgspec.structs import astuple, replace

from swarmd.core.bounds import keep_newest
from swarmd.core.codec import Decoder
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.incident import IncidentKind
from swarmd.core.keys import is_id
from swarmd.core.messages import STATUS_SILENCE, Motion, Presence, Status, Tracks
from swarmd.core.values import Array, Platform, Scan
from swarmd.driver_api.hw_codec import decode_scan
from swarmd.operator.session.looks import SwarmWatch
from swarmd.operator.session.members_view import MembersView, SeenMember
from swarmd.operator.session.operator import Operator
from swarmd.operator.texts.status import sections
from swarmd.operator.texts.why import absence, standing_time, why
from swarmd.operator.verbs.events.feed import EventFeed, EventLine, together
from swarmd.operator.view.history import SPAN
from swarmd.operator.view.metrics import Seen, exposition
from swarmd.operator.view.source import ShownArena, ShownRobot, limits_of, points_of, row_of
from swarmd.settings.platforms import load_platform

PLAIN = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
"""The footprint in m of a robot whose platform file is not on this machine."""

MAX_ROBOTS = 1024
MAX_LINKED = 64
"""The most robots with which the page shows links: in a room all robots hear each other."""
GONE = {Presence.LEFT: "left in order", Presence.FAILED: "failed: it may still move"}
"""The text for a robot that is not alive."""

MAX_LINES = 2000
MAX_MARKS = 200
"""The number of the latest event lines that are kept, and of the latest marks that pages get."""
Describe = Callable[[str], Sequence[Mapping[str, Any]]]
"""Takes a platform; returns its patterns as `Source.descriptions`. It may take seconds."""

_motion = Decoder(Motion)
_tracks = Decoder(Tracks)
_DESCRIBED = ("summary", "group", "platform", "params", "report_units")
MAX_INCIDENTS = 4096  # whose ids are kept, so that each counts once
_KINDS = "|".join(IncidentKind)
_INCIDENT = re.compile(
    rf"incident (?P<id>[0-9a-f]{{12}}) of (?P<robot>\S{{1,63}}): (?P<kind>{_KINDS}): "
)
_WATCHED_AGE = 1.5  # s after which tracks and scans are not shown


class LiveSource:
    """A `swarmd.operator.view.source.Source` of a living swarm; poses are by each robot's own
    odometry."""

    kind = "live"
    arena: ShownArena | None = None
    playback = None
    link: float | None = None

    def __init__(
        self, operator: Operator, patterns: Sequence[str], describe: Describe | None = None
    ) -> None:
        """Prepare the source, without robots so far."""
        self.swarm = operator.settings.swarm
        self._operator = operator
        self.patterns = patterns  # that may be run
        self.descriptions: Mapping[str, Mapping[str, Any]] = {}  # by pattern
        self._describe = describe  # a thread calls it
        self._described: set[str] = set()  # platforms for which `describe` was called
        self._descriptions = 0  # count of finished descriptions; part of `revision`
        # Events: a line is of one robot. A mark joins equal lines of several robots for the page.
        self._feed = EventFeed(SPAN)
        self._lines: deque[EventLine] = deque(maxlen=MAX_LINES)
        # None: a line has come since the last marks were made.
        self._marks: Sequence[tuple[float, str, Sequence[str]]] | None = None
        self._robots: list[ShownRobot] = []  # in the order of their indices
        self._index: dict[str, int] = {}  # by name
        self._revision = 0  # rises when a robot or its platform is added
        # The last messages of robots, by name, which threads of Zenoh write. A scan and tracks have
        # their time of arrival in s.
        self._lock = threading.Lock()
        self._motions: dict[str, Motion] = {}
        self._scans: dict[str, tuple[float, Scan]] = {}
        self._tracks: dict[str, tuple[float, Tracks]] = {}
        self._platforms: dict[str, Platform | None] = {}  # None: not known on this machine
        self._watched: frozenset[str] = frozenset()  # robots whose scans and tracks are subscribed
        self._links: frozenset[tuple[str, str]] = frozenset()  # pairs that hear each other
        self._looked_at: float | None = None  # s; the last look
        self._incidents: dict[str, tuple[str, str]] = {}  # by id: robot and kind
        self._incident_counts: Counter[tuple[str, str]] = Counter()
        self._watch = SwarmWatch(operator, on_status=self._on_status, on_view=self._on_view)

    def start(self) -> None:
        """Begin to look."""
        self._operator.watch("motion", self._on_motion)
        self._watch.start()

    def close(self) -> None:
        """End the watch; the owner of the operator closes it."""
        self._watch.close()

    @property
    def view(self) -> MembersView:
        """The members as last seen."""
        return self._watch.view

    def expected(self) -> list[str]:
        """The robots that a stop of all must reach: all shown robots except those that left."""
        members = self.view.members
        left = {name for name, member in members.items() if member.presence is Presence.LEFT}
        return [robot.name for robot in self._robots if robot.name not in left]

    def statuses(self) -> dict[str, tuple[Status, float]]:
        """The last status of each robot that sent one, and its age in s."""
        return self._watch.statuses()

    # What the page shows

    @property
    def robots(self) -> Sequence[ShownRobot]:
        """The robots that were heard, in the order of their indices."""
        return self._robots

    @property
    def revision(self) -> int:
        """A number that rises when a robot or its platform is added, or patterns are described."""
        return self._revision + self._descriptions

    @property
    def programs(self) -> Sequence[str]:
        """The Zenoh programs that any robot sees, sorted."""
        heard = [status for status, age in self.statuses().values() if age <= STATUS_SILENCE]
        return sorted({name for status in heard for name in status.programs})

    def frame(self) -> tuple[float, Array]:
        """The time, and the last pose of each robot."""
        with self._lock:
            motions = list(self._motions.values())
        index = self._index
        if any(motion.robot not in index for motion in motions):
            self._add((motion.robot for motion in motions), self.statuses())
        rows = [
            (index[motion.robot], motion.x, motion.y, motion.yaw)
            for motion in motions
            if motion.robot in index
        ]
        return time.monotonic(), np.array(rows, dtype=np.float64).reshape(-1, 4)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The row of each robot, by name: the values of its last status, and whether it is absent.

        Also adds new robots to `robots`. For new platforms, starts a thread that describes the
        patterns on these platforms (`_take_patterns`).
        """
        statuses = self.statuses()
        with self._lock:
            motions = dict(self._motions)
        view = self.view
        members = view.members
        self._add(sorted(members.keys() | statuses.keys() | view.roster), statuses)
        self._describe_new({status.platform for status, _ in statuses.values()})
        rows: dict[str, dict[str, Any]] = {}
        for robot in self._robots:
            name = robot.name
            member = members.get(name)
            status_and_age = statuses.get(name)
            if status_and_age is None:
                rows[name] = _unanswered(member)
                continue
            rows[name] = self._row(name, *status_and_age, motions.get(name))
            if member is not None and member.presence is not Presence.ALIVE:
                rows[name] |= {"presence": member.presence.value, "why": GONE[member.presence]}
        return rows

    def _describe_new(self, platforms: Iterable[str]) -> None:
        """Start a thread that describes the patterns on those of `platforms` that are new."""
        new_platforms = set(filter(is_id, platforms)) - self._described
        if self._describe is not None and new_platforms:
            self._described |= new_platforms
            arguments = (self._describe, sorted(new_platforms))
            threading.Thread(target=self._take_patterns, args=arguments, daemon=True).start()

    def _row(self, name: str, status: Status, age: float, motion: Motion | None) -> dict[str, Any]:
        """The row of a robot whose last status is `age` s old.

        `motion`: commands and nearest obstacles, published more often than the status; or None.
        """
        row = row_of(status)
        if motion is not None:
            row |= {
                "requested": list(motion.requested),
                "safe": list(motion.safe),
                "rows": limits_of(motion.rows),
            }
        row["tracks"] = self._tracks_of(name)
        platform = self._platform(status.platform)
        if platform is not None:
            limits = platform.limits
            row["limits"] = [limits.linear, limits.angular, limits.lateral]
        row["age"] = age
        # When the state began, in s on this machine's clock (`since`: s from then to the status).
        # Rounded to the same number at each call, since the server sends a row if it has changed.
        # `age`, which changes at each call, is sent apart from the rows.
        if (stood := standing_time(status)) is not None:
            row["at"] = round(time.monotonic() - age - stood)
        row["labels"] = list(status.labels)
        return row

    def scan(self, name: str) -> Array | None:
        """The returns of a watched robot's scan in its base frame; None once it is old."""
        at, scan = self._scans.get(name, (-math.inf, None))
        robot = self._index.get(name)
        if scan is None or robot is None or time.monotonic() - at > _WATCHED_AGE:
            return None
        platform = self._platform(self._robots[robot].platform)
        offset = (0.0, 0.0) if platform is None else platform.scan.offset
        return points_of(scan.ranges, scan.bearings, offset)

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """Empty: boxes are not known in a real room."""
        return ()

    def links(self) -> Sequence[tuple[int, int]]:
        """Pairs that report each other as alive; empty for more than MAX_LINKED robots."""
        index = self._index
        return [(index[a], index[b]) for a, b in self._links if a in index and b in index]

    def marks(self) -> Sequence[tuple[float, str, Sequence[str]]]:
        """The events of robots; equal texts of several robots are one line."""
        with self._lock:
            self._note(self._feed.advance(time.monotonic()))
            if self._marks is None:
                marks = together(self._lines)[-MAX_MARKS:]
                self._marks = [(round(line.at, 1), line.text, robots) for line, robots in marks]
            return self._marks

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """The content of `swarmctl describe`, and events."""
        known = self.statuses().get(name)
        member = self.view.members.get(name)
        if known is None or member is None:
            return None
        status, age = known
        groups = sections(member, status, self.descriptions.get(status.pattern or "", {}))
        return {
            "why": why(replace(member, status=status)),
            "sections": [[title, rows] for title, rows in groups if rows],
            "events": [
                [f"{max(status.uptime - event.at, 0.0) + age:.0f} s ago", event.text]
                for event in reversed(status.events)
            ],
        }

    def metrics(self) -> str:
        """The figures of the swarm, for programs that scrape them (`metrics.py`)."""
        now = time.monotonic()
        with self._lock:
            looked_at = self._looked_at
            incidents = dict(self._incident_counts)
        seen = Seen(
            swarm=self.swarm,
            version=version("swarmd"),
            view=self.view,
            look_age=None if looked_at is None else now - looked_at,
            statuses=self.statuses(),
            incidents=incidents,
        )
        return exposition(seen)

    def select(self, names: Sequence[str]) -> None:
        """Watch the scans and tracks of these robots and of no others."""
        wanted = frozenset(names)
        for name in self._watched - wanted:
            self._operator.unwatch("scan", name)
            self._operator.unwatch("tracks", name)
            self._scans.pop(name, None)
            self._tracks.pop(name, None)
        for name in wanted - self._watched:
            self._operator.watch("scan", self._on_scan, name)
            self._operator.watch("tracks", self._on_tracks, name)
        self._watched = wanted

    # What robots tell

    def _on_status(self, status: Status) -> None:
        with self._lock:
            self._note(self._feed.on_status(status, time.monotonic()))

    def _note(self, lines: Iterable[EventLine]) -> None:
        """Keep event lines; call it with the lock held."""
        if found := [line for line in lines if line.kind != "gap"]:
            self._lines.extend(found)
            self._marks = None
            for line in found:
                self._count_incident(line.text)

    def _count_incident(self, text: str) -> None:
        """Count the incident that a line of a robot's log tells, once, whoever tells it."""
        told = _INCIDENT.match(text)
        if told is None or told["id"] in self._incidents:
            return
        robot_and_kind = told["robot"], told["kind"]
        keep_newest(self._incidents, told["id"], robot_and_kind, MAX_INCIDENTS)
        if robot_and_kind in self._incident_counts or len(self._incident_counts) < MAX_INCIDENTS:
            self._incident_counts[robot_and_kind] += 1

    def _on_view(self, view: MembersView) -> None:
        """Take a look; the thread of the watch calls this after each look."""
        with self._lock:
            self._looked_at = time.monotonic()
            self._note(self._feed.on_view(view, self._looked_at))
        is_few = len(view.members) <= MAX_LINKED
        self._links = self._operator.links() if is_few else frozenset()

    def _on_motion(self, robot: str, payload: bytes) -> None:
        motion = _motion(payload)
        if motion.robot == robot and math.isfinite(motion.x + motion.y + motion.yaw):
            with self._lock:
                self._motions[robot] = motion

    def _on_scan(self, robot: str, payload: bytes) -> None:
        index = self._index.get(robot)
        if index is None:
            return
        platform = self._platform(self._robots[index].platform)
        if platform is not None:
            self._scans[robot] = time.monotonic(), decode_scan(payload, platform.scan)

    def _on_tracks(self, robot: str, payload: bytes) -> None:
        tracks = _tracks(payload)
        if tracks.robot == robot:
            self._tracks[robot] = time.monotonic(), tracks

    def _tracks_of(self, name: str) -> list[list[float | str | None]]:
        """The tracks of a watched robot: x, y, vx, vy and radius in its base frame, and name."""
        at, tracks = self._tracks.get(name, (-math.inf, None))
        if tracks is None or time.monotonic() - at > _WATCHED_AGE:
            return []
        return [
            [*(round(value, 3) for value in numbers), label]
            for *numbers, label in map(astuple, tracks.tracks)
        ]

    def _add(self, names: Iterable[str], statuses: Mapping[str, tuple[Status, float]]) -> None:
        """Add robots to the list; without a status a robot has a plain footprint."""
        for name in names:
            index = self._index.get(name)
            known = statuses.get(name)
            platform = "" if known is None else known[0].platform
            if index is not None and (not platform or self._robots[index].platform == platform):
                continue
            if index is None and len(self._robots) >= MAX_ROBOTS:
                continue
            shown = self._platform(platform) if platform else None
            shape = PLAIN if shown is None else shown.footprint
            self._revision += 1
            if index is None:
                self._index[name] = index = len(self._robots)
                self._robots.append(ShownRobot(name, index, platform, shape))
            else:
                self._robots[index] = ShownRobot(name, index, platform, shape)

    def _take_patterns(self, describe: Describe, platforms: Sequence[str]) -> None:
        """Describe all patterns on new `platforms`, and why a pattern cannot run on a platform.

        Runs in a thread. Defaults of parameters depend on the platform: the page shows those of the
        platform that was described first.
        """
        for platform in platforms:
            with contextlib.suppress(SwarmError):  # of a platform that is not known on this machine
                described = dict(self.descriptions)
                for row in (row for row in describe(platform) if "error" not in row):
                    usual = {key: row[key] for key in _DESCRIBED}
                    known = described.get(row["name"], {"unfit": {}, **usual})
                    needs = f"lacks {', '.join(row['missing'])}" if row["missing"] else ""
                    # By platform why the pattern cannot run there; empty if it can.
                    unfit = {**known["unfit"], platform: needs or row["refused"]}
                    described[row["name"]] = {**known, "unfit": unfit}
                self.descriptions = described
                self._descriptions += 1

    def _platform(self, name: str) -> Platform | None:
        """The platform of that name; None if it is not known on this machine."""
        if name not in self._platforms:
            self._platforms[name] = None
            with contextlib.suppress(ConfigError):
                if is_id(name):  # a robot names no file of this machine
                    self._platforms[name] = load_platform(name)
        return self._platforms[name]


def _unanswered(member: SeenMember | None) -> dict[str, Any]:
    """The row of a robot that sent no status."""
    row: dict[str, Any] = {"state": "", "report": {}, "presence": "expected"}
    if member is None:
        return row | {"why": absence(None), "age": math.inf}
    row |= {"presence": member.presence.value, "state": member.state, "age": member.age}
    return row | {"why": GONE.get(member.presence) or absence(member, has_age=False)}

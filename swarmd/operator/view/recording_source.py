"""The source of a page for recordings of robots, or for a merged file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swarmd.core.messages import Member, Presence, Reason
from swarmd.core.values import Array, Twist
from swarmd.daemon.recording import messages
from swarmd.operator.texts.status import NOT_DESCRIBED, sections
from swarmd.operator.texts.why import protection_word, standing_of
from swarmd.operator.verbs.events.feed import EventLine, together
from swarmd.operator.view.playback import Playback
from swarmd.operator.view.source import ShownArena, ShownRobot, link_of, points_of, row_of
from swarmd.operator.view.timeline import Track, read_timeline

MAX_EVENTS = 20
MAX_MARKS = 200
"""Events of all robots that are marked on the time; of more, the last ones."""


class RecordingSource:
    """A recording as a `Source` (operator/view/source.py) of the page and of the player of a
    report."""

    kind = "recording"
    arena: ShownArena | None = None
    patterns: Sequence[str] = ()
    programs: Sequence[str] = ()
    descriptions: Mapping[str, Mapping[str, Any]] = {}
    link: float | None = None
    revision = 0  # rises once patterns are described
    _marks: Sequence[tuple[float, str, Sequence[str]]] | None = None

    def __init__(self, paths: Sequence[Path], clock: Callable[[], float] = time.monotonic) -> None:
        """Read the recordings. SwarmError as `read_timeline`."""
        self.timeline = read_timeline(paths)
        tracks = self.timeline.tracks
        self.robots = [
            ShownRobot(name, i, track.platform.name, track.platform.footprint)
            for i, (name, track) in enumerate(tracks.items())
        ]
        if self.timeline.is_shared:
            self.link = link_of(track.platform for track in tracks.values())
        names = list(tracks)
        self.swarm = f"recording of {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}"
        run = paths[0].name
        self.playback = Playback([run], lambda _: None, clock)
        self.playback.load(run, self.timeline.duration)

    def take_patterns(self, described: Sequence[Mapping[str, Any]]) -> None:
        """Use the descriptions of `patterns show -o json` for units, from the next row on."""
        self.descriptions = {row["name"]: row for row in described if "error" not in row}
        self.revision += 1

    def frame(self) -> tuple[float, Array]:
        """The present time, and the pose of each robot that is recorded then."""
        now = self.playback.time
        rows = []
        for shown in self.robots:
            pose = self.timeline.pose(shown.name, now)
            if pose is not None:
                rows.append((shown.index, *pose))
        return now, np.array(rows, dtype=np.float64).reshape(-1, 4)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The last status and decision of each robot."""
        now = self.playback.time
        return {name: _row(track, now) for name, track in self.timeline.tracks.items()}

    def scan(self, name: str) -> Array | None:
        """The returns of the last scan."""
        track = self.timeline.tracks.get(name)
        scan = None if track is None else track.scan(self.playback.time)
        if track is None or scan is None:
            return None
        return points_of(scan.ranges, scan.bearings, track.platform.scan.offset)

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """Empty: boxes are not known in a real room."""
        return ()

    def links(self) -> Sequence[tuple[int, int]]:
        """Empty: links are not recorded."""
        return ()

    def marks(self) -> Sequence[tuple[float, str, Sequence[str]]]:
        """The last events that robots logged; equal texts of several robots are one line."""
        if self._marks is None:
            end = self.playback.duration
            tracks = self.timeline.tracks
            lines = [
                EventLine(at, name, "event", text)
                for name, track in tracks.items()
                for at, text in track.events(end, MAX_MARKS)
                if at >= 0.0
            ]
            marks = together(lines)[-MAX_MARKS:]
            self._marks = [(round(line.at, 2), line.text, robots) for line, robots in marks]
        return self._marks

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """What `describe` told, and the last lines of the robot's log."""
        track = self.timeline.tracks.get(name)
        now = self.playback.time
        if track is None:
            return None
        titled: list[Any] = []
        if (status := track.status(now)) is not None:
            alive = Presence.ALIVE
            member = Member(robot=name, instance=status.instance, presence=alive, age=0.0)
            described = self.descriptions.get(status.pattern or "", NOT_DESCRIBED)
            groups = sections(member, status, described)
            titled = [[title, rows] for title, rows in groups if rows]
        events = [[f"{at:.1f} s", text] for at, text in track.events(now, MAX_EVENTS)]
        return {"sections": titled, "events": events}

    def select(self, names: Sequence[str]) -> None:
        """Nothing to do: all values of each robot are in the recording."""


def _row(robot: Track, now: float) -> dict[str, Any]:
    if not robot.is_heard(now):
        return {"presence": "absent", "state": "", "why": "nothing is recorded at this time"}
    status = robot.status(now)
    decision = robot.decision(now)
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
    """The values of a decision, which is recorded more often than a status."""
    is_running = decision.state == "running"
    protection = protection_word(
        is_active=decision.is_active,
        is_recovering=decision.is_recovering,
        avoiding=decision.avoiding,
    )
    reason = decision.reason.replace("_", " ")
    is_same = decision.state == row.get("state") and row.get("why", "").startswith(reason)
    why = row["why"] if reason and is_same else reason
    if decision.reason == Reason.PROTECTION:
        why = ": ".join(filter(None, (reason, decision.avoiding)))
    columns = (decision.bearings, decision.gaps, decision.caps)
    return {
        "state": decision.state,
        "why": why,
        "stands": standing_of(decision.state, decision.reason),
        "protection": protection if is_running else "",
        "requested": _plain(messages.twist_of(decision.requested)),
        "safe": _plain(messages.twist_of(decision.safe)),
        "near": None if math.isnan(decision.gap) else decision.gap,
        "rows": [list(obstacle) for obstacle in zip(*(c.tolist() for c in columns), strict=True)],
    }


def _plain(twist: Twist) -> list[float]:
    return [twist.linear, twist.angular, twist.lateral]

"""A living swarm on the page: statuses and motions of its robots."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import astuple

from swarmd.core.codec import Decoder
from swarmd.core.errors import ConfigError
from swarmd.core.messages import Motion, Presence, Status
from swarmd.core.values import Array, Platform, Scan
from swarmd.driver_api.hw_codec import decode_scan
from swarmd.network.discovery import MembersView, SeenMember
from swarmd.network.operator import Operator
from swarmd.settings.platforms import load_platform
from swarmd.view.source import ShownArena, ShownRobot, points_of, row_of
from swarmd.view.swarm_watch import SwarmWatch

PLAIN = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
"""The footprint of a robot whose platform is not known here, in m."""

_motion = Decoder(Motion)


class LiveSource:
    """See `swarmd.view.source.Source`. Positions are those of each robot's own odometry."""

    kind = "live"
    arena: ShownArena | None = None
    playback = None

    def __init__(self, operator: Operator, patterns: Sequence[str]) -> None:
        self.swarm = operator.settings.swarm
        self.patterns = patterns
        self._robots: list[ShownRobot] = []
        self._operator = operator
        self._index: dict[str, int] = {}
        self._lock = threading.Lock()
        self._motions: dict[str, Motion] = {}
        self._scans: dict[str, Scan] = {}
        self._platforms: dict[str, Platform | None] = {}
        self._watched: frozenset[str] = frozenset()
        self._watch = SwarmWatch(operator)

    def start(self) -> None:
        """Begin to look."""
        self._operator.watch("motion", self._on_motion)
        self._watch.start()

    def close(self) -> None:
        """End; the operator is closed by its owner."""
        self._watch.close()

    @property
    def view(self) -> MembersView:
        """The members as last seen."""
        return self._watch.view

    def expected(self) -> list[str]:
        """The robots that a stop of all must reach: all that are shown and did not leave."""
        members = self.view.members
        left = {name for name, one in members.items() if one.presence is Presence.LEFT}
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
        """The number of robots."""
        return len(self._robots)

    def frame(self) -> tuple[float, Array]:
        """The last pose of each robot."""
        with self._lock:
            motions = list(self._motions.values())
        self._add(one.robot for one in motions)
        rows = [
            (self._index[one.robot], one.x, one.y, one.yaw)
            for one in motions
            if one.robot in self._index
        ]
        return time.monotonic(), np.array(rows, dtype=np.float64).reshape(-1, 4)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The last status of each robot, and what is known of one that does not answer."""
        statuses = self.statuses()
        with self._lock:
            motions = dict(self._motions)
        members = self.view.members
        self._add(sorted(members.keys() | statuses.keys()))
        rows: dict[str, dict[str, Any]] = {}
        for robot in self._robots:
            name = robot.name
            member, known = members.get(name), statuses.get(name)
            if known is None:
                rows[name] = _unanswered(member)
                continue
            status, age = known
            row = rows[name] = row_of(status)
            motion = motions.get(name)
            if motion is not None:
                row |= {
                    "requested": list(motion.requested),
                    "safe": list(motion.safe),
                    "rows": [list(astuple(one)) for one in motion.rows],
                }
            platform = self._platform(status.platform)
            if platform is not None:
                limits = platform.limits
                row["limits"] = [limits.linear, limits.angular, limits.lateral]
            row["age"] = round(age, 1)
            if member is not None and member.presence is not Presence.ALIVE:
                row |= {"presence": member.presence.value, "why": f"{member.presence.value}"}
        return rows

    def scan(self, name: str) -> Array | None:
        """The returns of a watched robot's scan in its base frame."""
        scan, robot = self._scans.get(name), self._index.get(name)
        if scan is None or robot is None:
            return None
        platform = self._platform(self._robots[robot].platform)
        offset = (0.0, 0.0) if platform is None else platform.scan.offset
        return points_of(scan.ranges, scan.bearings, offset)

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """Not known of a real room."""
        return ()

    def links(self) -> Sequence[tuple[int, int]]:
        """Not known."""
        return ()

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """What `describe` tells."""
        known = self.statuses().get(name)
        if known is None:
            return None
        status, age = known
        health, decision = status.health, status.decision
        values = [
            ["Platform", f"{status.platform}, driver {status.driver}"],
            ["Pattern", status.pattern or "-"],
            ["Parameters", _assignments({k: v.value for k, v in status.params.items()}) or "-"],
            ["Report", _assignments(status.report) or "-"],
            ["Protection", f"{decision.mode}, limits {decision.duty:.0%} of decisions"],
            ["Labels", ", ".join(status.labels) or "-"],
            ["Changed by", status.changed_by],
            ["Scans", f"{health.scan_rate:.1f} Hz"],
            ["Driver", health.driver],
            ["Network", health.network],
            [
                "Latches",
                "; ".join(f"{x.issuer}: {x.reason}" for x in status.latches.values()) or "-",
            ],
            ["Peers", "; ".join(f"{x.robot}: {x.text}" for x in status.peers) or "-"],
            ["Version", f"{status.version}, kernels {status.kernels}"],
        ]
        if decision.speed_share < 1.0:
            values.insert(5, ["Speed", f"{decision.speed_share:.0%}: an assumption was violated"])
        events = [
            [f"{max(status.uptime - one.at, 0.0) + age:.0f} s ago", one.text]
            for one in reversed(status.events)
        ]
        return {"values": values, "events": events}

    def select(self, names: Sequence[str]) -> None:
        """Watch the scans of these robots and of no others."""
        wanted = frozenset(names)
        for name in self._watched - wanted:
            self._operator.unwatch("scan", name)
            self._scans.pop(name, None)
        for name in wanted - self._watched:
            self._operator.watch("scan", self._on_scan, name)
        self._watched = wanted

    # What robots tell

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
            self._scans[robot] = decode_scan(payload, platform.scan)

    def _add(self, names: Any) -> None:
        new = [name for name in names if name not in self._index]
        statuses = self.statuses() if new else {}
        for name in new:
            known = statuses.get(name)
            if known is None and name not in self.view.members:
                continue
            platform = "" if known is None else known[0].platform
            if not platform:
                continue  # until its status comes
            self._index[name] = len(self._robots)
            found = self._platform(platform)
            shape = PLAIN if found is None else found.footprint
            self._robots.append(ShownRobot(name, self._index[name], platform, shape))

    def _platform(self, name: str) -> Platform | None:
        """The platform of that name; None if it is not known on this machine."""
        if name not in self._platforms:
            self._platforms[name] = None
            with contextlib.suppress(ConfigError):
                self._platforms[name] = load_platform(name)
        return self._platforms[name]


def _unanswered(member: SeenMember | None) -> dict[str, Any]:
    presence = "?" if member is None else member.presence.value
    return {"presence": presence, "state": "", "why": "does not answer", "report": {}}


def _assignments(values: Mapping[str, object]) -> str:
    shown = (f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in values.items())
    return ", ".join(shown)

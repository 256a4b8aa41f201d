"""The peers of one robot: which of them it does not see, and where those are by their own word."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import structs

from swarmd.core.messages import Body, PeerFinding
from swarmd.core.values import Neighbor, Platform
from swarmd.protection.compatibility import Accepts, assumed_speed, body_of, findings
from swarmd.protection.decision import ToldObstacle

TOLD_TIMEOUT = 1.0  # s after which a place that a neighbour was told at says nothing any more
TOLD_WITHIN = 3.0  # m; a neighbour farther away constrains no command before it is told again
# Errors of range and bearing: three standard deviations of the boards that the simulator models.
DISTANCE_ERROR, DISTANCE_SHARE, ANGLE_ERROR = 0.06, 0.06, math.radians(6.0)

_Figure = tuple[float, float, float, float]  # x, y, radius in m, and the time of measuring in s


class Peers:
    """Findings about peers, and the places of those that are not seen for certain.

    All times are in s on the robot's monotonic clock and come with each call.
    """

    def __init__(self, platform: Platform, accepts: Accepts) -> None:
        self.own = body_of(platform)
        self._others_speed = assumed_speed(platform)
        self._is_off = platform.protection.get("mode") == "off"
        self._accepts = accepts
        self._bodies: Mapping[str, Body | None] = {}
        self._findings: tuple[PeerFinding, ...] = ()
        self._radii: dict[str, float] = {}  # of peers whose places matter
        self._figures: dict[str, _Figure] = {}
        self._unseen: tuple[str, ...] = ()  # not accepted: each must be told
        self._holds_always = False
        self._due = math.inf  # until when all of `_unseen` are told

    def on_peers(self, bodies: Mapping[str, Body | None]) -> list[PeerFinding]:
        """Take in all peers that are known, alive or gone; the findings that are new."""
        if bodies == self._bodies:
            return []
        before = set(self._findings)
        self._bodies = dict(bodies)
        found = [
            finding
            for robot, body in sorted(bodies.items())
            for finding in findings(self.own, self._others_speed, robot, body, self._accepts)
        ]
        if self._is_off:
            found = [structs.replace(finding, holds=False) for finding in found]
        self._findings = tuple(found)
        self._radii = {
            finding.robot: body.radius
            for finding in found
            if finding.kind != "faster" and (body := bodies[finding.robot]) is not None
        }
        self._figures = {r: f for r, f in self._figures.items() if r in self._radii}
        self._unseen = tuple(f.robot for f in found if f.kind == "unseen" and f.holds)
        self._holds_always = any(f.kind == "faster" and f.holds for f in found)
        self._find_due()
        return [finding for finding in found if finding not in before]

    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> bool:
        """Take in the places of neighbours that are not seen for certain; True if there are any."""
        if not self._radii:
            return False
        for neighbor in neighbors:
            radius, distance = self._radii.get(neighbor.id), neighbor.distance
            if radius is None or distance is None or neighbor.bearing is None:
                continue
            if not (math.isfinite(distance) and math.isfinite(neighbor.bearing)):
                continue
            distance, at = max(distance, 0.0), now - max(neighbor.age, 0.0)
            error = math.hypot(DISTANCE_ERROR + DISTANCE_SHARE * distance, ANGLE_ERROR * distance)
            self._figures[neighbor.id] = (
                distance * math.cos(neighbor.bearing),
                distance * math.sin(neighbor.bearing),
                radius + error,
                at,
            )
        self._find_due()
        return bool(self._figures)

    def told(self, now: float) -> tuple[ToldObstacle, ...]:
        """The near peers that are told and not seen for certain, by name."""
        if not self._figures:
            return ()
        return tuple(
            ToldObstacle(x, y, radius, max(now - at, 0.0))
            for x, y, radius, at in self._figures.values()
            if now - at <= TOLD_TIMEOUT and math.hypot(x, y) - radius <= TOLD_WITHIN
        )

    def holds(self, now: float) -> bool:
        """True if a peer that is not accepted is faster than assumed, or neither seen nor told."""
        return self._holds_always or now > self._due

    def hold_due_at(self) -> float:
        """The time until which `holds` stays False, if it is False now and nothing arrives."""
        return self._due

    def _find_due(self) -> None:
        self._due = min(map(self._told_until, self._unseen), default=math.inf)

    def _told_until(self, robot: str) -> float:
        figure = self._figures.get(robot)
        return -math.inf if figure is None else figure[3] + TOLD_TIMEOUT

    def findings(self, now: float) -> tuple[PeerFinding, ...]:
        """The findings at `now`: one that is told does not hold the robot."""
        if not self._unseen:
            return self._findings
        return tuple(
            structs.replace(f, holds=False, text=f"{f.text.partition(';')[0]}; told")
            if f.kind == "unseen" and f.holds and now <= self._told_until(f.robot)
            else f
            for f in self._findings
        )

"""The peers of one robot: which of them it does not see, and where others tell them to be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np
from msgspec import structs

from swarmd.core.arrival_delay import ArrivalDelay
from swarmd.core.clock import TICK
from swarmd.core.messages import Body, PeerFinding
from swarmd.core.values import MAX_TOLD_DISTANCE, Neighbor, PeerPlace, Platform, SharedPose, Twist
from swarmd.protection.binding_range import REACTION_TIME, BindingRange
from swarmd.protection.compatibility import (
    Accepts,
    assumed_speed,
    barrier_settings,
    body_of,
    findings,
    radius_of,
    sees,
)
from swarmd.protection.decision import ToldObstacle

TOLD_TIMEOUT = 1.0  # s after which a place that a neighbour was told at says nothing any more
BLIND_RING = 0.1  # m around the outline: a robot does not fit into less
# Errors of range and bearing: three standard deviations of the boards that the simulator models.
DISTANCE_ERROR, DISTANCE_SHARE, ANGLE_ERROR = 0.06, 0.06, math.radians(6.0)

POSE_TIMEOUT = 0.5  # s of age beyond which a pose in a shared frame is neither told nor used
FASTEST_POSE = 0.1  # s that the fastest own pose takes at most to arrive: no clock shows it


class _Figure(NamedTuple):
    """A disc in m in the base frame at the time `at` in s; `until` s it tells where the peer is.

    Of two figures from one source, that with the later `until` is the newer.
    """

    x: float
    y: float
    radius: float
    at: float
    until: float


class _OwnPose(NamedTuple):
    """The own pose in a shared frame at the time `at` in s, which is right within half of
    FASTEST_POSE: that shifts the pose by `shift` m and turns it by `turn` rad at most."""

    shared: SharedPose
    at: float
    shift: float
    turn: float


class Peers:
    """Findings about peers, and the places of those that are not seen for certain.

    All times are in s on the robot's monotonic clock and come with each call. With `tells_pose`
    the robot tells its pose to all peers, else only if one of them may not see it.
    """

    def __init__(self, platform: Platform, accepts: Accepts, *, tells_pose: bool = False) -> None:
        self._tells_pose = tells_pose
        self.own = body_of(platform)
        self._others_speed = assumed_speed(platform)
        self._is_off = platform.protection.get("mode") == "off"
        self._accepts = accepts
        self._limits = platform.limits
        self._pose_delay = ArrivalDelay()
        self._own_pose: _OwnPose | None = None
        self._is_missed = False  # by a peer that may not see this robot
        self._bodies: Mapping[str, Body | None] = {}
        self._findings: tuple[PeerFinding, ...] = ()
        self._radii: dict[str, float] = {}  # of peers whose places matter
        # A peer that the lidar sees may still vanish in its blind zone.
        self._blind_within = _blind_within(platform)
        self._seen: frozenset[str] = frozenset()  # peers that are seen beyond the blind zone
        self._told_within = _told_within(platform)
        # By source, then by peer. A false place of one source must not hide the other's obstacle.
        self._sensed: dict[str, _Figure] = {}  # by range and bearing
        self._located: dict[str, _Figure] = {}  # in the shared frame
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
        if self._blind_within:
            known = {robot: body.radius for robot, body in bodies.items() if body is not None}
            self._seen = frozenset(known) - frozenset(self._radii)
            self._radii = known
        others = (body for body in bodies.values() if body is not None)
        self._is_missed = any(sees(body, self.own) is not True for body in others)
        for figures in (self._sensed, self._located):
            for robot in figures.keys() - self._radii.keys():
                del figures[robot]
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
            if not all(map(math.isfinite, (neighbor.bearing, neighbor.age))):
                continue
            if not 0.0 <= distance <= MAX_TOLD_DISTANCE:
                continue
            at = now - max(neighbor.age, 0.0)
            error = math.hypot(DISTANCE_ERROR + DISTANCE_SHARE * distance, ANGLE_ERROR * distance)
            figure = _Figure(
                distance * math.cos(neighbor.bearing),
                distance * math.sin(neighbor.bearing),
                radius + error,
                at,
                at + TOLD_TIMEOUT,
            )
            _keep_newer(self._sensed, neighbor.id, figure)
        self._find_due()
        return bool(self._sensed)

    def on_pose(self, pose: SharedPose, twist: Twist | None, now: float) -> float | None:
        """Take in the own pose; `twist` is the measured one.

        The time of the pose; None, and it is ignored, if it is not valid or no news.
        """
        if not pose.is_valid:
            return None
        late = self._pose_delay.take(pose.stamp, now)
        if late is None:
            return None
        limits, half = self._limits, 0.5 * FASTEST_POSE
        if twist is None:
            twist = Twist(limits.linear, limits.angular, limits.lateral)
        shift = half * math.hypot(twist.linear, twist.lateral)
        at = now - late - half
        self._own_pose = _OwnPose(pose, at, shift, half * abs(twist.angular))
        return at

    def shared_pose(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose in a shared frame and its age in s; None without a fresh one."""
        own = self._own_pose
        age = 0.0 if own is None else max(now - own.at, 0.0)
        return None if own is None or age > POSE_TIMEOUT else (own.shared, age)

    def pose_to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose and its highest age in s, if peers are to know it."""
        if not (self._is_missed or self._tells_pose) or self._own_pose is None:
            return None
        age = now - self._own_pose.at + 0.5 * FASTEST_POSE
        return (self._own_pose.shared, age) if age <= POSE_TIMEOUT else None

    def on_place(self, place: PeerPlace, now: float) -> bool:
        """Take in where a peer is by its own word; True if that tells where it is.

        Needs an own pose in the same frame. The peer's motion until the time of that pose, the
        errors of both and that of the time of the own pose enlarge the circle.
        """
        own, radius = self._own_pose, self._radii.get(place.robot)
        body = self._bodies.get(place.robot)
        if own is None or radius is None or body is None or place.frame != own.shared.frame:
            return False
        at = now - place.age
        if now - own.at > POSE_TIMEOUT or place.age > POSE_TIMEOUT:
            return False
        pose = own.shared.pose
        dx, dy = place.x - pose.x, place.y - pose.y
        if math.hypot(dx, dy) > MAX_TOLD_DISTANCE:
            return False
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        error = own.shared.error + own.shift + place.error
        error += (own.shared.yaw_error + own.turn) * math.hypot(dx, dy)
        error += body.surface_speed * max(own.at - at, 0.0)
        figure = _Figure(
            cos * dx + sin * dy,
            cos * dy - sin * dx,
            radius + error,
            own.at,
            min(own.at, at) + TOLD_TIMEOUT,
        )
        _keep_newer(self._located, place.robot, figure)
        self._find_due()
        return True

    def told(self, now: float) -> tuple[ToldObstacle, ...]:
        """The near peers that are told and not seen for certain: not there, or in a blind zone.

        A peer with a place from each source appears twice.
        """
        if not (self._sensed or self._located):
            return ()
        return tuple(
            ToldObstacle(one.x, one.y, one.radius, max(now - one.at, 0.0))
            for robot, one in chain(self._sensed.items(), self._located.items())
            if now <= one.until
            and math.hypot(one.x, one.y) - one.radius
            <= (self._blind_within if robot in self._seen else self._told_within)
        )

    def holds(self, now: float) -> bool:
        """True if a peer that is not accepted is faster than assumed, or neither seen nor told."""
        return self._holds_always or now > self._due

    def hold_due_at(self) -> float:
        """The time until which `holds` stays False if nothing arrives; -inf if it is True."""
        return -math.inf if self._holds_always else self._due

    @property
    def has_places(self) -> bool:
        """True if `told` may give anything."""
        return bool(self._sensed or self._located)

    def _find_due(self) -> None:
        self._due = min(map(self._told_until, self._unseen), default=math.inf)

    def _told_until(self, robot: str) -> float:
        found = (figures.get(robot) for figures in (self._sensed, self._located))
        return max((figure.until for figure in found if figure is not None), default=-math.inf)

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


def _keep_newer(figures: dict[str, _Figure], robot: str, figure: _Figure) -> None:
    """Replace the figure of a peer unless it is the newer one."""
    known = figures.get(robot)
    if known is None or figure.until >= known.until:
        figures[robot] = figure


def _told_within(platform: Platform) -> float:
    """m from the axle to the rim of a disc beyond which it constrains no command while it counts.

    -inf in a mode that regards no told obstacle.
    """
    barrier = barrier_settings(platform)
    if barrier is None:
        return -math.inf
    reach = BindingRange(platform, barrier, TICK)
    return radius_of(platform) + reach.for_age(TOLD_TIMEOUT + REACTION_TIME)


def _blind_within(platform: Platform) -> float:
    """m from the axle within which the lidar may lose a peer; 0 without a blind zone outside.

    A blind zone that ends within BLIND_RING of the outline has no room for a robot.
    """
    scan = platform.scan
    outer = float(np.hypot(*(platform.footprint - scan.offset).T).max())
    if scan.near != "lost" or scan.range_min <= outer + BLIND_RING:
        return 0.0
    return scan.range_min + math.hypot(*scan.offset)

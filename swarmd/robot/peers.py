"""The peers of one robot: which peers its lidar may miss, and their places by message or by radio.

A place comes from one of two sources: range and bearing that the own sensors measure to the peer,
or the pose that the peer reports in a shared frame. Protection avoids such a place as a disc that
no scan shows (`ToldObstacle`).
"""

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

TOLD_TIMEOUT = 1.0  # s after which the place of a neighbour is no longer used
BLIND_RING = 0.1  # m around the outline: a robot does not fit into less
# Errors of range and bearing: three standard deviations of the boards that the simulator models.
DISTANCE_ERROR, DISTANCE_SHARE, ANGLE_ERROR = 0.06, 0.06, math.radians(6.0)

POSE_TIMEOUT = 0.5  # s of age beyond which a pose in a shared frame is neither sent nor used
FASTEST_POSE = 0.1  # s: upper bound of the least delay of own poses, which no clock can measure


class _Figure(NamedTuple):
    """A disc around a peer, in m in the base frame at the time `at` (s); valid until `until` (s).

    Of two figures from one source, the figure with the later `until` is newer.
    """

    x: float
    y: float
    radius: float
    at: float
    until: float


class _OwnPose(NamedTuple):
    """The own pose in a shared frame at the time `at` in s.

    `at` is uncertain by half of FASTEST_POSE. During that time the robot moves by at most `shift`
    m and turns by at most `turn` rad.
    """

    shared: SharedPose
    at: float
    shift: float
    turn: float


class Peers:
    """Findings about peers, and the places of the peers that the lidar may miss.

    A finding is a property of a peer that protection does not assume, such as a body below the
    scan plane. All times are in s on the robot's monotonic clock and come with each call. With
    `tells_pose` the robot sends its pose to all peers, else only if a peer may not see this robot.
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
        self._is_missed = False  # a peer's lidar may miss this robot
        self._bodies: Mapping[str, Body | None] = {}
        self._findings: tuple[PeerFinding, ...] = ()
        self._radii: dict[str, float] = {}  # m, of the peers whose places are used
        # m; a peer that the lidar sees may still vanish in the blind zone near the sensor.
        self._blind_within = _blind_within(platform)
        self._seen: frozenset[str] = frozenset()  # peers that are seen beyond the blind zone
        self._told_within = _told_within(platform)
        # By peer, one dict per source: a false place of one source must not displace a true place.
        self._sensed: dict[str, _Figure] = {}  # from range and bearing
        self._located: dict[str, _Figure] = {}  # from poses in the shared frame
        # Peers that the lidar misses and that `accepts` does not list: each needs a known place.
        self._unseen: tuple[str, ...] = ()
        self._holds_always = False
        self._due = math.inf  # s, until which each of `_unseen` has a known place

    def on_peers(self, bodies: Mapping[str, Body | None]) -> list[PeerFinding]:
        """Replace the bodies of all known peers, alive or gone; returns the new findings.

        A body is None while the peer has not reported it.
        """
        if bodies == self._bodies:
            return []
        before = set(self._findings)
        self._bodies = dict(bodies)
        present = [
            finding
            for robot, body in sorted(bodies.items())
            for finding in findings(self.own, self._others_speed, robot, body, self._accepts)
        ]
        if self._is_off:
            present = [structs.replace(finding, holds=False) for finding in present]
        self._findings = tuple(present)
        self._radii = {
            finding.robot: body.radius
            for finding in present
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
        self._unseen = tuple(f.robot for f in present if f.kind == "unseen" and f.holds)
        self._holds_always = any(f.kind == "faster" and f.holds for f in present)
        self._find_due()
        return [finding for finding in present if finding not in before]

    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> bool:
        """Take in range and bearing of the neighbours that the lidar may miss.

        True if the place of any such neighbour is known.
        """
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
        """Take in the own pose; `twist` is measured, None without fresh odometry.

        Returns the time of the pose in s. None if the pose is invalid or not newer than the last
        pose; such a pose is ignored.
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
        """The own pose in a shared frame and its age in s; None without a fresh pose."""
        own = self._own_pose
        age = 0.0 if own is None else max(now - own.at, 0.0)
        return None if own is None or age > POSE_TIMEOUT else (own.shared, age)

    def pose_to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose to send to peers, and its highest possible age in s; None: send nothing."""
        if not (self._is_missed or self._tells_pose) or self._own_pose is None:
            return None
        age = now - self._own_pose.at + 0.5 * FASTEST_POSE
        return (self._own_pose.shared, age) if age <= POSE_TIMEOUT else None

    def on_place(self, place: PeerPlace, now: float) -> bool:
        """Take in the place that a peer reports; True if the place can be used.

        The robot needs a fresh own pose in the same frame. The disc grows by the motion of the peer
        until the time of the own pose, by the errors of both poses, and by the uncertain time of
        the own pose.
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
        """The places of near peers that the lidar may miss, as obstacles with their ages.

        A peer that the lidar sees is listed only inside the blind zone. A peer with a place from
        each source is listed twice.
        """
        if not (self._sensed or self._located):
            return ()
        return tuple(
            ToldObstacle(figure.x, figure.y, figure.radius, max(now - figure.at, 0.0))
            for robot, figure in chain(self._sensed.items(), self._located.items())
            if now <= figure.until
            and math.hypot(figure.x, figure.y) - figure.radius
            <= (self._blind_within if robot in self._seen else self._told_within)
        )

    def holds(self, now: float) -> bool:
        """True if a peer holds the robot, unless `accepts` lists the peer's platform.

        A peer holds the robot if it is faster than assumed, or if the lidar misses the peer and no
        place of the peer is known.
        """
        return self._holds_always or now > self._due

    def hold_due_at(self) -> float:
        """The time until which `holds` stays False if nothing arrives; -inf if it is True."""
        return -math.inf if self._holds_always else self._due

    @property
    def has_places(self) -> bool:
        """True if `told` may return an obstacle."""
        return bool(self._sensed or self._located)

    def _find_due(self) -> None:
        self._due = min(map(self._told_until, self._unseen), default=math.inf)

    def _told_until(self, robot: str) -> float:
        figures = (source.get(robot) for source in (self._sensed, self._located))
        return max((figure.until for figure in figures if figure is not None), default=-math.inf)

    def findings(self, now: float) -> tuple[PeerFinding, ...]:
        """The findings at `now`; an unseen peer with a known place does not hold the robot."""
        if not self._unseen:
            return self._findings
        return tuple(
            structs.replace(f, holds=False, text=f"{f.text.partition(';')[0]}; told")
            if f.kind == "unseen" and f.holds and now <= self._told_until(f.robot)
            else f
            for f in self._findings
        )


def _keep_newer(figures: dict[str, _Figure], robot: str, figure: _Figure) -> None:
    """Store the figure of a peer unless the stored figure is newer."""
    known = figures.get(robot)
    if known is None or figure.until >= known.until:
        figures[robot] = figure


def _told_within(platform: Platform) -> float:
    """The distance in m from axle to disc rim beyond which a disc constrains no command.

    Holds for the whole time in which the disc is valid. -inf in a mode that ignores such discs.
    """
    barrier = barrier_settings(platform)
    if barrier is None:
        return -math.inf
    reach = BindingRange(platform, barrier, TICK)
    return radius_of(platform) + reach.for_age(TOLD_TIMEOUT + REACTION_TIME)


def _blind_within(platform: Platform) -> float:
    """The distance in m from the axle within which the lidar may lose a peer; 0 if it cannot.

    A blind zone that ends within BLIND_RING of the outline has no room for a robot.
    """
    scan = platform.scan
    outer = float(np.hypot(*(platform.footprint - scan.offset).T).max())
    if scan.near != "lost" or scan.range_min <= outer + BLIND_RING:
        return 0.0
    return scan.range_min + math.hypot(*scan.offset)

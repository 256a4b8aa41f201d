"""The peers of one robot: which peers its lidar may miss, and their measured or reported places.

A place comes from one of two sources: range and bearing that the own sensors measure to the peer,
or the pose that the peer reports in a shared frame. Protection treats the place as an obstacle: a
disc (`ToldObstacle`) in addition to the points of the scan.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np
from msgspec import structs

from swarmd.core.clock import TICK
from swarmd.core.messages import Body, PeerFinding
from swarmd.core.neighbor_places import TimedPose
from swarmd.core.values import MAX_TOLD_DISTANCE, Neighbor, PeerPlace, Platform, SharedPose
from swarmd.robot.own_pose import POSE_TIMEOUT, OwnPose
from swarmd.robot.protection.binding_range import REACTION_TIME, BindingRange
from swarmd.robot.protection.compatibility import (
    Accepts,
    assumed_speed,
    barrier_settings,
    body_of,
    findings,
    sees,
)
from swarmd.robot.protection.decision import ToldObstacle
from swarmd.robot.protection.footprint import radius_of

TOLD_TIMEOUT = 1.0  # s after which the place of a neighbour is no longer used
BLIND_RING = 0.1  # m around the outline: a robot does not fit into less
# Errors of range and bearing: three standard deviations of the boards that the simulator models.
DISTANCE_ERROR = 0.06
DISTANCE_SHARE = 0.06
ANGLE_ERROR = math.radians(6.0)


class _PeerDisc(NamedTuple):
    """A disc around a peer, in m in the base frame at the time `at` (s); valid until `until` (s).

    Of two discs from one source, the disc with the later `until` is newer.
    """

    x: float
    y: float
    radius: float
    at: float
    until: float


class Peers:
    """Findings about peers, and the places of the peers that the lidar may miss.

    Protection assumes that the lidar sees all robots, and that no robot is faster than the setting
    `others_speed`. A finding is a property of a peer that contradicts one of these assumptions,
    such as a body below the scan plane. All times are in s on the robot's monotonic clock and come
    with each call. `own_pose`: the pose of this robot, which this class reads. `tells_pose`: the
    robot always sends its pose to its peers. By default the robot sends its pose only if the lidar
    of a peer may miss this robot.
    """

    def __init__(
        self,
        platform: Platform,
        accepts: Accepts,
        own_pose: OwnPose,
        *,
        tells_pose: bool = False,
    ) -> None:
        self._tells_pose = tells_pose
        self.own = body_of(platform)
        self._others_speed = assumed_speed(platform)
        self._is_off = platform.protection.get("mode") == "off"
        self._accepts = accepts
        self.own_pose = own_pose
        self.missed_by: frozenset[str] = frozenset()  # peers whose lidar may miss this robot
        self._bodies: Mapping[str, Body | None] = {}
        self._findings: tuple[PeerFinding, ...] = ()
        self._radii: dict[str, float] = {}  # m, of the peers whose places are used
        # m; a peer that the lidar sees may still vanish in the blind zone near the sensor.
        self._blind_within = _blind_within(platform)
        self._seen_beyond: frozenset[str] = frozenset()  # peers that are seen beyond the blind zone
        self._told_within = _told_within(platform)
        # By peer, one dict per source: a false place of one source must not displace a true place.
        # Discs of peers that were sensed by range and bearing.
        self._sensed: dict[str, _PeerDisc] = {}
        # Discs of peers that report poses in a shared frame.
        self._located: dict[str, _PeerDisc] = {}
        # Peers that the lidar misses and that `accepts` does not list: each needs a known place.
        self._unseen: tuple[str, ...] = ()
        self._holds_always = False
        self._places_until = math.inf  # s, until which each of `_unseen` has a known place

    def on_peers(self, bodies: Mapping[str, Body | None]) -> list[PeerFinding]:
        """Replace the bodies (size, height, speed) of all known peers, alive or gone.

        `bodies`: by robot; None while the peer has not reported its body. Returns the new findings:
        properties of peers that contradict what protection assumes, such as a body below the scan
        plane. A finding that `holds` makes the robot stand.
        """
        if bodies == self._bodies:
            return []
        earlier_findings = set(self._findings)
        self._bodies = dict(bodies)
        self._findings = self._findings_of(bodies)
        may_be_unseen = {f.robot for f in self._findings if f.kind in ("unseen", "unknown")}
        self._use_places_of(may_be_unseen)
        reported = {robot: body for robot, body in bodies.items() if body is not None}
        # `sees` is None if a height is unknown: the peer may miss this robot.
        self.missed_by = frozenset(
            robot for robot, body in reported.items() if sees(body, self.own) is not True
        )
        self._set_holds()
        return [finding for finding in self._findings if finding not in earlier_findings]

    def _findings_of(self, bodies: Mapping[str, Body | None]) -> tuple[PeerFinding, ...]:
        """The findings about all peers. With the protection mode `off` none holds the robot."""
        present = [
            finding
            for robot, body in sorted(bodies.items())
            for finding in findings(self.own, self._others_speed, robot, body, self._accepts)
        ]
        if self._is_off:
            present = [structs.replace(finding, holds=False) for finding in present]
        return tuple(present)

    def _set_holds(self) -> None:
        """A finding `faster` holds always, a finding `unseen` until the peer's place is known."""
        holding = [finding for finding in self._findings if finding.holds]
        self._unseen = tuple(finding.robot for finding in holding if finding.kind == "unseen")
        self._holds_always = any(finding.kind == "faster" for finding in holding)
        self._update_places_until()

    def _use_places_of(self, missed: Collection[str]) -> None:
        """Choose the peers whose measured or reported places are obstacles (`_radii`).

        `missed`: the peers that the lidar may miss. Their places are always obstacles. If the lidar
        has a blind zone near the sensor, the place of any other peer (`_seen_beyond`) is an
        obstacle while this place is inside the zone.
        """
        radii = {robot: body.radius for robot, body in self._bodies.items() if body is not None}
        self._radii = {robot: radius for robot, radius in radii.items() if robot in missed}
        if self._blind_within:
            self._seen_beyond = frozenset(radii) - frozenset(self._radii)
            self._radii = radii
        for discs in (self._sensed, self._located):
            for robot in discs.keys() - self._radii.keys():
                del discs[robot]

    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> bool:
        """Take in the measured range (m) and bearing (rad) of neighbours that the lidar may miss.

        Each such neighbour becomes a disc in the base frame, which contains the body of the
        neighbour and the errors of range and bearing. Skips a neighbour without range or bearing,
        and numbers that are not finite or too large. Returns True if any disc is stored, also from
        an earlier call.
        """
        if not self._radii:
            return False
        for neighbor in neighbors:
            body_radius = self._radii.get(neighbor.id)  # None for a peer whose place is not used
            disc = None if body_radius is None else _disc_of(neighbor, body_radius, now)
            if disc is not None:
                _keep_newer(self._sensed, neighbor.id, disc)
        self._update_places_until()
        return bool(self._sensed)

    def pose_to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose to send to peers, and its highest possible age in s; None: send nothing."""
        return self.own_pose.to_tell(now) if self.missed_by or self._tells_pose else None

    def on_place(self, place: PeerPlace, now: float) -> bool:
        """Take in the pose that a peer reports in a shared frame; True if the pose can be used.

        The pose becomes a disc around the peer, in the base frame that this robot had at the time
        of its own last pose. False without a fresh own pose in the same frame, for an old report,
        for a peer that is far away, and for a peer that the lidar sees.
        """
        own = self.own_pose.last
        body = self._bodies.get(place.robot)
        if own is None or body is None or not _is_usable(place, own, now):
            return False
        body_radius = self._radii.get(place.robot)
        if body_radius is None:  # the lidar sees the peer
            return False
        pose = own.pose.pose
        reported_at = now - place.age
        # m in the shared frame, from own to peer
        dx = place.x - pose.x
        dy = place.y - pose.y
        cos = math.cos(pose.yaw)
        sin = math.sin(pose.yaw)
        disc = _PeerDisc(
            x=cos * dx + sin * dy,  # rotated by -yaw, from the shared frame to the base frame
            y=cos * dy - sin * dx,
            radius=body_radius + self._place_error(place, reported_at, own, body),
            at=own.at,
            until=min(own.at, reported_at) + TOLD_TIMEOUT,  # from the older of the two poses
        )
        _keep_newer(self._located, place.robot, disc)
        self._update_places_until()
        return True

    def _place_error(
        self, place: PeerPlace, reported_at: float, own: TimedPose, body: Body
    ) -> float:
        """The bound in m of the error of a peer's place in the base frame, at the time of `own`.

        `reported_at`: the time in s of the pose that the peer reports.
        """
        shared = own.pose
        distance = math.hypot(place.x - shared.pose.x, place.y - shared.pose.y)
        position_error = shared.error + self.own_pose.shift + place.error
        arc_of_yaw_error = (shared.yaw_error + self.own_pose.turn) * distance
        # The peer moves after an older report until the time of the own pose. A newer report needs
        # no such growth: protection assumes that the peer has moved since the time of the own pose.
        motion_of_peer = body.surface_speed * max(own.at - reported_at, 0.0)
        return position_error + arc_of_yaw_error + motion_of_peer

    def told(self, now: float) -> tuple[ToldObstacle, ...]:
        """The places of near peers that the lidar may miss, as obstacles with their ages.

        A peer that the lidar sees is listed only if it is inside the blind zone near the sensor,
        where the lidar may lose it. A peer whose place is both measured and reported is listed
        twice.
        """
        if not (self._sensed or self._located):
            return ()
        return tuple(
            ToldObstacle(disc.x, disc.y, disc.radius, max(now - disc.at, 0.0))
            for robot, disc in chain(self._sensed.items(), self._located.items())
            if now <= disc.until
            and math.hypot(disc.x, disc.y) - disc.radius
            <= (self._blind_within if robot in self._seen_beyond else self._told_within)
        )

    def holds(self, now: float) -> bool:
        """True if a peer makes this robot stand.

        This robot stands for a peer that is faster than protection assumes, and for a peer that the
        lidar misses while no place of that peer is known. This robot never stands for a peer whose
        platform the operator accepted (`accepts`).
        """
        return self._holds_always or now > self._places_until

    def hold_due_at(self) -> float:
        """The time until which `holds` stays False if nothing arrives; -inf if it is True."""
        return -math.inf if self._holds_always else self._places_until

    @property
    def has_places(self) -> bool:
        """True if `told` may return an obstacle."""
        return bool(self._sensed or self._located)

    def _update_places_until(self) -> None:
        self._places_until = min(map(self._place_known_until, self._unseen), default=math.inf)

    def _place_known_until(self, robot: str) -> float:
        discs = (source.get(robot) for source in (self._sensed, self._located))
        return max((disc.until for disc in discs if disc is not None), default=-math.inf)

    def findings(self, now: float) -> tuple[PeerFinding, ...]:
        """The findings at `now`; an unseen peer with a known place does not hold the robot."""
        if not self._unseen:
            return self._findings
        return tuple(
            structs.replace(f, holds=False, text=f"{f.text.partition(';')[0]}; told")
            if f.kind == "unseen" and f.holds and now <= self._place_known_until(f.robot)
            else f
            for f in self._findings
        )


def _disc_of(neighbor: Neighbor, body_radius: float, now: float) -> _PeerDisc | None:
    """The disc around a neighbour by range and bearing; None without usable numbers."""
    distance = neighbor.distance
    bearing = neighbor.bearing
    if distance is None or bearing is None:
        return None
    if not (math.isfinite(bearing) and math.isfinite(neighbor.age)):
        return None
    if not 0.0 <= distance <= MAX_TOLD_DISTANCE:  # also a distance that is NaN
        return None
    measured_at = now - max(neighbor.age, 0.0)
    error = neighbor.error
    if error is None:
        # Errors in m along the line of sight, and across it (the arc of the bearing's error).
        radial_error = DISTANCE_ERROR + DISTANCE_SHARE * distance
        error = math.hypot(radial_error, ANGLE_ERROR * distance)
    return _PeerDisc(
        x=distance * math.cos(bearing),
        y=distance * math.sin(bearing),
        radius=body_radius + error,
        at=measured_at,
        until=measured_at + TOLD_TIMEOUT,
    )


def _is_usable(place: PeerPlace, own: TimedPose, now: float) -> bool:
    """True if own pose and reported place are fresh, in one frame, and not too far apart."""
    pose = own.pose.pose
    is_old = now - own.at > POSE_TIMEOUT or place.age > POSE_TIMEOUT
    is_far = math.hypot(place.x - pose.x, place.y - pose.y) > MAX_TOLD_DISTANCE
    return place.frame == own.pose.frame and not is_old and not is_far


def _keep_newer(discs: dict[str, _PeerDisc], robot: str, disc: _PeerDisc) -> None:
    """Store the disc of a peer unless the stored disc is newer."""
    known = discs.get(robot)
    if known is None or disc.until >= known.until:
        discs[robot] = disc


def _told_within(platform: Platform) -> float:
    """The distance in m from axle to disc rim beyond which a peer's disc limits no command.

    Computed for a disc of the age TOLD_TIMEOUT: an older disc is not used, and a newer disc limits
    commands only at a smaller distance. -inf in a protection mode that uses no discs.
    """
    barrier = barrier_settings(platform)
    if barrier is None:
        return -math.inf
    reach = BindingRange(platform, barrier, TICK)
    return radius_of(platform) + reach.for_age(TOLD_TIMEOUT + REACTION_TIME)


def _blind_within(platform: Platform) -> float:
    """The distance in m from the axle within which the lidar may lose a peer; 0 if never.

    0 also if the blind zone ends within BLIND_RING of the outline: no robot fits in between.
    """
    scan = platform.scan
    outer = float(np.hypot(*(platform.footprint - scan.offset).T).max())
    if scan.near != "lost" or scan.range_min <= outer + BLIND_RING:
        return 0.0
    return scan.range_min + math.hypot(*scan.offset)

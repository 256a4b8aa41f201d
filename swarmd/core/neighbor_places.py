"""Where the neighbors are that the base does not measure: by detections and by shared poses. Pure.

For patterns and neighborhoods alone: protection takes places from `Peers` (robot/peers.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

from msgspec import structs

from swarmd.core.values import ROBOT, Detection, Neighbor, PeerPlace, SharedPose

V = TypeVar("V")
PLACE_TIMEOUT = 1.0  # s after which the place of a peer, or the own pose, is too old
MAX_PEERS = 1024  # peers whose places are kept


class TimedPose(NamedTuple):
    """The own pose in a shared frame, and its time in s on the robot's monotonic clock."""

    pose: SharedPose
    at: float


class NeighborPlaces:
    """The last known places of peers. All times are in s on the robot's monotonic clock.

    Of several sources the most direct counts: the base's measurement, then a detection of the peer
    (a tag on its body), then the poses of both robots in a shared frame.
    """

    def __init__(self) -> None:
        self._places: dict[str, tuple[PeerPlace, float]] = {}  # place, and its time, by robot
        self._seen: dict[str, tuple[Detection, float]] = {}  # detection, and its arrival, by robot

    def on_place(self, place: PeerPlace, now: float) -> None:
        """Take in the place that a peer reports, unless a newer one is known."""
        at = now - place.age
        if at >= self._places.get(place.robot, (None, -math.inf))[1]:
            _keep(self._places, place.robot, (place, at))

    def on_detections(self, detections: tuple[Detection, ...] | None, now: float) -> None:
        """Take in the recognised objects: robots with a distance, of each the nearest."""
        found = [one for one in detections or () if one.kind == ROBOT]
        for seen in sorted(found, key=lambda one: one.distance or 0.0, reverse=True):
            if seen.distance is not None:
                _keep(self._seen, seen.id, (seen, now))

    def complete(
        self, neighbors: tuple[Neighbor, ...], own: TimedPose | None, now: float
    ) -> tuple[Neighbor, ...]:
        """The neighbors with the distance, bearing and heading that are not measured.

        `own`: the pose of this robot; without one no poses are compared.

        A place older than PLACE_TIMEOUT, or in a frame other than that of the own pose, is left
        out. The older of both poses gives the age. `error` in m bounds the error of the place,
        apart from motion within its age.
        """
        if not (self._places or self._seen):
            return neighbors
        return tuple([self._located(self._sighted(one, now), own, now) for one in neighbors])

    def by_poses(
        self, neighbors: tuple[Neighbor, ...], own: TimedPose | None, now: float
    ) -> tuple[Neighbor, ...]:
        """As `complete`, without the places of detected robots."""
        if not self._places:
            return neighbors
        return tuple([self._located(one, own, now) for one in neighbors])

    def _sighted(self, neighbor: Neighbor, now: float) -> Neighbor:
        """The neighbor at the place of its last detection, unless it is measured."""
        seen, at = self._seen.get(neighbor.id, (None, now))
        is_measured = None not in (neighbor.distance, neighbor.bearing)
        if seen is None or is_measured or now - at > PLACE_TIMEOUT:
            return neighbor
        distance = seen.distance if neighbor.distance is None else neighbor.distance
        bearing = seen.bearing if neighbor.bearing is None else neighbor.bearing
        return Neighbor(neighbor.id, now - at, distance, bearing, neighbor.heading)

    def _located(self, neighbor: Neighbor, timed: TimedPose | None, now: float) -> Neighbor:
        """The neighbor with the fields that are not known by the poses in the shared frame."""
        place, at = self._places.get(neighbor.id, (None, now))
        if place is None or timed is None:
            return neighbor
        own = timed.pose
        age = now - min(timed.at, at)
        if age > PLACE_TIMEOUT or place.frame != own.frame:
            return neighbor
        # m, from own to peer
        dx = place.x - own.pose.x
        dy = place.y - own.pose.y
        bearing = _known(neighbor.bearing, math.atan2(dy, dx), own)
        heading = _known(neighbor.heading, place.heading, own)
        if neighbor.distance is not None:
            return structs.replace(neighbor, bearing=bearing, heading=heading)
        distance = math.hypot(dx, dy)
        error = own.error + place.error + own.yaw_error * distance
        return Neighbor(
            neighbor.id, max(age, 0.0), distance, bearing, heading, neighbor.in_reach, error
        )


def _known(measured: float | None, angle: float | None, own: SharedPose) -> float | None:
    """The measured angle in rad, else `angle` of the shared frame in the base frame; None: none."""
    if measured is not None or angle is None:
        return measured
    return math.remainder(angle - own.pose.yaw, math.tau)


def _keep(by_robot: dict[str, V], robot: str, value: V) -> None:
    """Store a value as the newest; the oldest is dropped beyond MAX_PEERS."""
    by_robot.pop(robot, None)
    by_robot[robot] = value
    if len(by_robot) > MAX_PEERS:
        del by_robot[next(iter(by_robot))]

"""Where the neighbours are that the base does not measure: by detections and by shared poses.

For patterns alone: protection takes places from `Peers` (peers.py).
"""

from __future__ import annotations

from typing import TypeVar

from swarmd.core.relative_place import PLACE_TIMEOUT, located
from swarmd.core.values import ROBOT, Detection, Neighbor, PeerPlace, SharedPose

V = TypeVar("V")
MAX_PEERS = 1024  # peers whose places are kept


class NeighborPlaces:
    """The last known places of peers. All times are in s on the robot's monotonic clock.

    Of several sources the most direct counts: the base's measurement, then a detection of the peer
    (a tag on its body), then the poses of both robots in a shared frame.
    """

    def __init__(self) -> None:
        self._own: tuple[SharedPose, float] | None = None  # pose, and its time
        self._places: dict[str, tuple[PeerPlace, float]] = {}  # place, and its time, by robot
        self._seen: dict[str, tuple[Detection, float]] = {}  # detection, and its arrival, by robot

    def on_pose(self, pose: SharedPose, at: float) -> None:
        """Take in the own pose at the time `at`."""
        self._own = pose, at

    def on_place(self, place: PeerPlace, now: float) -> None:
        """Take in the place that a peer reports."""
        _keep(self._places, place.robot, (place, now - place.age))

    def on_detections(self, detections: tuple[Detection, ...] | None, now: float) -> None:
        """Take in the recognised objects, of which robots with a distance count."""
        for seen in detections or ():
            if seen.kind == ROBOT and seen.distance is not None:
                _keep(self._seen, seen.id, (seen, now))

    def complete(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        """The neighbours with the distance, bearing and heading that are not measured.

        A place older than PLACE_TIMEOUT, or in a frame other than that of the own pose, is left
        out.
        """
        if not (self._places or self._seen):
            return neighbors
        return tuple([self._completed(neighbor, now) for neighbor in neighbors])

    def _completed(self, neighbor: Neighbor, now: float) -> Neighbor:
        seen, seen_at = self._seen.get(neighbor.id, (None, now))
        is_measured = neighbor.distance is not None and neighbor.bearing is not None
        if seen is not None and not is_measured and now - seen_at <= PLACE_TIMEOUT:
            age, bearing = now - seen_at, seen.bearing
            neighbor = Neighbor(neighbor.id, age, seen.distance, bearing, neighbor.heading)
        place, place_at = self._places.get(neighbor.id, (None, now))
        if place is None or self._own is None:
            return neighbor
        own, own_at = self._own
        return located(neighbor, own, now - own_at, place, now - place_at)


def _keep(by_robot: dict[str, V], robot: str, value: V) -> None:
    """Store a value as the newest; the oldest is dropped beyond MAX_PEERS."""
    by_robot.pop(robot, None)
    by_robot[robot] = value
    if len(by_robot) > MAX_PEERS:
        del by_robot[next(iter(by_robot))]

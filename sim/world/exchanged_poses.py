"""The poses in a shared frame that simulated robots send each other, as of a tracker.

Noise, rate and gaps are our choice, of the order of trackers and of localisation on a map. The
delay of datagrams is not modelled: on one network it is below a twentieth of the period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from swarmd.core.neighbor_places import NeighborPlaces, TimedPose
from swarmd.core.values import Array, Neighbor, PeerPlace, Pose, SharedPose
from swarmd.sim.world.seeding import generator

# m along each axis, rad
_SD = 0.02
_YAW_SD = math.radians(2.0)
# bounds of the errors that robots send
_ERROR = 3.0 * _SD
_YAW_ERROR = 3.0 * _YAW_SD
# s without a pose, once in each period, at a random phase by robot
_GAP = 0.5
_GAP_PERIOD = 5.0
_FRAME = "world"


class ExchangedPoses:
    """The last measured pose of each robot, and the places of its neighbors that follow."""

    def __init__(self, ids: Sequence[str], *, seed: int) -> None:
        self._heard = [Neighbor(robot, 0.0) for robot in ids]
        self._rngs = [generator(seed, "poses", robot) for robot in ids]
        self._gap_phases = [rng.uniform(0.0, _GAP_PERIOD) for rng in self._rngs]
        # By row, what a robot knows.
        self._own: list[TimedPose | None] = [None for _ in ids]
        self._known = [NeighborPlaces() for _ in ids]

    def measure(
        self,
        rows: Iterable[int],
        poses: Array,
        now: float,
        tracked: Callable[[int, Array, float], Array] = lambda row, pose, now: pose,
    ) -> None:
        """Measure the poses of robots `rows`, except of those in a gap; `poses` (n, 3), `now` s.

        `tracked(row, pose, now)`: the pose in place of a sound one, by a fault of the tracker.
        """
        for row in rows:
            sound = poses[row] + self._rngs[row].normal(0.0, (_SD, _SD, _YAW_SD))
            x, y, yaw = tracked(row, sound, now).tolist()
            if (now + self._gap_phases[row]) % _GAP_PERIOD >= _GAP:
                shared = SharedPose(now, Pose(x, y, yaw), _ERROR, _YAW_ERROR, _FRAME)
                if shared.is_valid:
                    self._own[row] = TimedPose(shared, now)
                place = PeerPlace(self._heard[row].id, _FRAME, x, y, _ERROR, 0.0, yaw)
                for known in self._known:
                    known.on_place(place, now)

    def neighbors(self, row: int, neighbors: Iterable[int], now: float) -> tuple[Neighbor, ...]:
        """The robots `neighbors` (rows) with their places as robot `row` computes them at `now`."""
        heard = tuple([self._heard[other] for other in neighbors])
        return self._known[row].complete(heard, self._own[row], now)

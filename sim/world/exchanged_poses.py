"""The poses in a shared frame that simulated robots send each other, as of a tracker.

Noise, rate and gaps are our choice, of the order of trackers and of localisation on a map. The
delay of datagrams is not modelled: on one network it is below a twentieth of PERIOD.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from swarmd.core.relative_place import located
from swarmd.core.values import Array, Neighbor, PeerPlace, Pose, SharedPose
from swarmd.sim.world.seeding import generator

POSES_RATE = 10.0  # Hz
_SD, _YAW_SD = 0.02, math.radians(2.0)  # m along each axis, rad
_BOUND = 3.0  # standard deviations that count as the bound of an error
_GAP, _GAP_PERIOD = 0.5, 5.0  # s without a pose, once in each period, at a random phase by robot
_FRAME = "world"


class ExchangedPoses:
    """The last measured pose of each robot, and the places of its neighbors that follow."""

    def __init__(self, ids: Sequence[str], *, seed: int) -> None:
        self._ids = tuple(ids)
        self._rngs = [generator(seed, "poses", robot) for robot in ids]
        self._gap_phases = [rng.uniform(0.0, _GAP_PERIOD) for rng in self._rngs]
        self._last: dict[int, tuple[SharedPose, float]] = {}  # pose and its time in s, by row

    def measure(self, rows: Iterable[int], poses: Array, now: float) -> None:
        """Measure the poses of robots `rows`, except of those in a gap; `poses` (n, 3), `now` s."""
        for row in rows:
            x, y, yaw = (poses[row] + self._rngs[row].normal(0.0, (_SD, _SD, _YAW_SD))).tolist()
            if (now + self._gap_phases[row]) % _GAP_PERIOD >= _GAP:
                errors = _BOUND * _SD, _BOUND * _YAW_SD
                self._last[row] = SharedPose(now, Pose(x, y, yaw), *errors, _FRAME), now

    def neighbors(self, row: int, neighbors: Iterable[int], now: float) -> tuple[Neighbor, ...]:
        """The robots `neighbors` (rows) with their places as robot `row` computes them at `now`."""
        return tuple([self._neighbor(row, other, now) for other in neighbors])

    def _neighbor(self, row: int, other: int, now: float) -> Neighbor:
        neighbor = Neighbor(self._ids[other], 0.0)
        if row not in self._last or other not in self._last:
            return neighbor
        (own, own_at), (peer, peer_at) = self._last[row], self._last[other]
        x, y, yaw = peer.pose.x, peer.pose.y, peer.pose.yaw
        place = PeerPlace(neighbor.id, _FRAME, x, y, peer.error, 0.0, yaw)
        return located(neighbor, own, now - own_at, place, now - peer_at)

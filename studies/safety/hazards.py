"""The hazards of a live course: a ramming robot, and obstacles that appear ahead of robots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import cycle

import numpy as np

from swarmd.core.values import Platform, Twist
from swarmd.sim.live.state import Triple, WorldState
from swarmd.sim.world.arena import Box
from swarmd.sim.world.geometry import gaps, transform

MASS = 1e6  # kg: robots cannot push such a box
OBSTACLES: Mapping[str, Box] = {
    name: Box(0.0, 0.0, *size, name=name, mass=MASS, is_placed=False)
    for name, size in {
        "wall-1": (1.0, 0.05),
        "pole-1": (0.06, 0.06),
        "wall-2": (1.0, 0.05),
        "pole-2": (0.1, 0.1),
        "pole-3": (0.04, 0.04),
    }.items()
}

_REACTION = 0.1  # s from a scan's arrival to braking wheels: a tick, network, actuators
_BRAKING = 1.0  # m/s2, the least of the bases
_STALE = 0.15  # s, the highest age of a state from which an obstacle is placed
_SLACK = 0.4  # m, at most, beyond the required distance
_PAUSE = 1.0  # s between two obstacles
_TURN = 0.6  # share of the rammer's speed that turning may use
_TURN_GAIN = 2.0  # rad/s of turning for each rad between heading and target
_CHASE = 20.0  # s after which the rammer changes its target
_RETREAT = 1.0  # s


class Rammer:
    """Drives into one robot after the other; no point of its surface exceeds `speed` in m/s.

    `reach` in m is the distance of the rammer's farthest corner from its axle. Turning reduces the
    speed that is left for driving. The higher of the commanded and the actual turn rate counts,
    since the body still turns after its command ends. Earlier commands count, too, since the state
    may be older than these commands.
    """

    def __init__(self, speed: float, reach: float) -> None:
        self._speed, self._reach = speed, reach
        self._last_turn = 0.0
        self._target = -1
        self._chases_until = self._retreats_until = -math.inf
        self._touches = 0

    def command(self, state: WorldState, row: int) -> Twist:
        """The command for the rammer, which is robot `row`.

        The rammer chases the nearest robot except its last target. After a contact, or after
        `_CHASE` s without a contact, the rammer backs away and chooses another robot.
        """
        if state.contacts > self._touches or state.time >= self._chases_until:
            self._touches = state.contacts
            self._retreats_until = state.time + _RETREAT
            self._chases_until = self._retreats_until + _CHASE
            own, poses = state.poses[row], state.poses
            others = [index for index in range(len(poses)) if index not in (row, self._target)]
            self._target = min(others, key=lambda index: math.dist(poses[index][:2], own[:2]))
        spin = state.twists[row][1]
        if state.time < self._retreats_until:
            return self._twist(0.0, spin, -1.0)
        (x, y, yaw), target = state.poses[row], state.poses[self._target]
        bearing = math.remainder(math.atan2(target[1] - y, target[0] - x) - yaw, math.tau)
        most = _TURN * self._speed / self._reach
        wanted = min(max(_TURN_GAIN * bearing, -most), most)
        return self._twist(wanted, spin, max(0.0, math.cos(bearing)))

    def _twist(self, wanted: float, spin: float, share: float) -> Twist:
        turning = max(abs(wanted), self._last_turn, abs(spin))
        self._last_turn = max(abs(wanted), self._last_turn / 2.0)
        left = max(0.0, self._speed - turning * self._reach)
        return Twist(linear=share * left, angular=wanted)


class ObstaclePlacer:
    """Places obstacles ahead of moving robots, at a distance at which they can stop."""

    def __init__(self, platform: Platform, robots: int, seed: int) -> None:
        """ObstaclePlacer appear ahead of the first `robots` robots of a state."""
        self._platform, self._robots = platform, robots
        self._rng = np.random.default_rng(seed)
        self._names = cycle(OBSTACLES)
        self._next = -math.inf
        self._room = room(platform) + _STALE * platform.limits.linear

    def next(self, state: WorldState) -> tuple[str, Triple] | None:
        """The name and pose of the next obstacle; None if none is due, or there is no room."""
        moving = [
            row
            for row in range(self._robots)
            if state.twists[row][0] > self._platform.limits.linear / 2.0
        ]
        if state.time < self._next or not moving:
            return None
        name = next(self._names)
        pose = self._ahead(state.poses[int(self._rng.choice(moving))])
        outlines = transform(self._platform.footprint, np.array(state.poses))
        if gaps(transform(OBSTACLES[name].shape, np.array(pose)), outlines).min() < self._room:
            return None
        self._next = state.time + _PAUSE
        return name, pose

    def _ahead(self, pose: Triple) -> Triple:
        """A pose ahead of a robot at `pose`, across the robot's heading."""
        gap = self._room + float(self._rng.uniform(0.1, _SLACK))
        x, y, yaw = pose
        distance = float(self._platform.footprint[:, 0].max()) + gap
        aside = yaw + float(self._rng.uniform(-0.2, 0.2))
        across = yaw + math.pi / 2.0 + float(self._rng.uniform(-0.8, 0.8))
        return x + distance * math.cos(aside), y + distance * math.sin(aside), across


def room(platform: Platform) -> float:
    """The least distance in m from each robot at which an obstacle may appear.

    The sum of the blind zone, the distance that the fastest robot drives before it acts on the next
    scan, its braking distance, and the part of a body that a lidar does not see.
    """
    barrier, speed = platform.protection["barrier"], platform.limits.linear
    wait = 1.0 / platform.scan.rate + 2.0 * platform.scan.latency + _REACTION
    stop = speed * wait + speed * speed / (2.0 * _BRAKING)
    return float(platform.scan.range_min + stop + barrier["margin"] + barrier["unseen_extent"])

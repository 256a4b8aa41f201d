"""Flocking: the robots move about as one group; none talks, none knows where another heads.

Source of law "paper": Moeslinger, Schmickl and Crailsheim, "A minimalist flocking algorithm for
swarm robots" (2011), as Kaiser et al., ICRA 2022, have it in ROS2swarm: four sectors, three
distances and, by priority, straight on or a turn.

Law "elastic" is ours. A spring ties each robot to the few that are nearest: what of its force lies
along the heading changes the speed, what lies across turns the robot (Ferrante et al.,
"Self-organized flocking with a mobile robot swarm: a novel motion control method", Adaptive
Behavior 20, 2012). That alone aligns headings slowly and not for long, for others' lidars and
bodies are behind their axles. So it also turns to where the others move, as scans a second apart
and its own odometry tell (aligning: Vicsek et al., Phys. Rev. Lett. 75, 1995); without odometry
the springs must do. Walls, told from robots by their width, push as springs do.

Limits: a pillar is taken for a robot, a robot within some 0.2 m of a wall for a part of it. One
that sees no other drives straight on.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from swarmd.api import (
    ZERO,
    Array,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Platform,
    Recovery,
    Scalar,
    Scan,
    TopSpeed,
    TopTurn,
    Twist,
    Value,
    about,
    closest_points,
    clusters,
    wrap,
)

# A surface so near, in m, to that of what may be a robot is the same.
_SAME = 0.25
# Nearer than this share of the lidar's range an object is seen with what is beside it.
_SURE = 0.95
# A spring that is pressed is stiffer than one that is drawn by this factor, and has so many times
# its force at most.
_STIFFER = 2.0
# Share of the highest speed when backing, so that two that meet come free.
_BACK = 0.4
# s over which the motion of others is observed, and m that one moves meanwhile at most.
_BASELINE, _STEP = 1.0, 0.35
# rad: how wide a sector of law "paper" is.
_SECTOR = math.pi / 2.0
# rad: a robot that is near, or the far end of what may be one, and a wall (4 and 18 rays of 360).
_FEW, _MANY = math.radians(4.0), math.radians(18.0)
# The states of law "paper", and the sign of their turns.
_TURNS = {"straight": 0.0, "left": 1.0, "right": -1.0}


class FlockingParams(Params, frozen=True):
    """The law, speeds and distances; those of law "paper" come last."""

    law: Annotated[
        Literal["elastic", "paper"],
        about(
            "elastic: tied to the nearest by springs; paper: the original states",
            source="ours: the original takes a robot seen whole for a wall, and splits",
        ),
    ] = "elastic"
    speed: TopSpeed = 0.2
    turn: TopTurn = 1.82
    cruise: Annotated[
        float,
        about(
            "share of the highest speed at which it drives where nothing pulls or pushes",
            ge=0.0,
            le=1.0,
            source="ours: who lags behind has the rest to catch up",
        ),
    ] = 0.6
    ties: Annotated[
        int,
        about(
            "how many others it is tied to, the nearest",
            ge=1,
            le=100,
            unit="robots",
            source="ours: with three the springs can all be at rest, with six or more they cannot",
        ),
    ] = 3
    spacing: Annotated[
        float,
        about(
            "distance from the lidar to another's surface at which a spring is at rest",
            ge=0.1,
            le=20.0,
            unit="m",
            source="ours: 1.5 times the protection threshold",
        ),
    ] = 0.75
    give: Annotated[
        float,
        about(
            "how much a spring yields before its force is full",
            ge=0.01,
            le=20.0,
            unit="m",
            source="ours: the protection threshold",
        ),
    ] = 0.5
    surge: Annotated[
        float,
        about(
            "share of the highest speed by which a full force along the heading changes it",
            ge=0.0,
            le=10.0,
            source="Ferrante et al. 2012, K1; the value: ours",
        ),
    ] = 1.2
    swing: Annotated[
        float,
        about(
            "turn rate that a full force across the heading gives",
            ge=0.0,
            le=10.0,
            unit="rad/s",
            source="Ferrante et al. 2012, K2; the value: ours",
        ),
    ] = 0.5
    align: Annotated[
        float,
        about(
            "turn rate if the others are seen to move abreast at the highest speed; 0: no matter",
            ge=0.0,
            le=10.0,
            unit="rad/s",
            source="ours; aligning: Vicsek et al. 1995, Phys. Rev. Lett. 75",
        ),
    ] = 1.2
    wall: Annotated[
        float,
        about(
            "distance to a wall from which on it pushes; the force is full after the spacing",
            ge=0.1,
            le=100.0,
            unit="m",
            source="ours: twice the spacing, 0.9 times the lidar's reach at most",
        ),
    ] = 1.5
    object_width: Annotated[
        float,
        about(
            "what is wider is no robot",
            ge=0.05,
            le=10.0,
            unit="m",
            source="ours: twice the footprint's diagonal",
        ),
    ] = 0.8
    paper_turn: Annotated[
        float,
        about("law paper: turn rate", ge=0.0, le=4.0, unit="rad/s", source="ROS2swarm"),
    ] = 0.2
    near: Annotated[
        float,
        about(
            "law paper: turns away from what is nearer, ahead or aside",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ROS2swarm: z1 and z2, the protection threshold",
        ),
    ] = 0.5
    far_aside: Annotated[
        float,
        about(
            "law paper: turns to what is farther, left or right",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ROS2swarm: z3, 3/7 of the lidar's reach",
        ),
    ] = 1.5
    far_behind: Annotated[
        float,
        about(
            "law paper: turns round for what is farther behind",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ROS2swarm: z4, 5/7 of the lidar's reach",
        ),
    ] = 2.5
    recovery: Recovery = False


class Flocking(MovementPattern[FlockingParams]):
    """Drives where those around it drive, at a distance from them."""

    params_type = FlockingParams

    def __init__(self, params: FlockingParams, context: Context) -> None:
        super().__init__(params, context)
        self._state = ""
        self._goes_on = False
        self._scan: Scan | None = None
        self._requested = ZERO
        self._seen: deque[tuple[float, NDArray[np.complex128]]] = deque()

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """Speeds from the limits, reach from the lidar, distances from the protection."""
        threshold = float(platform.protection["threshold"])
        diagonal = float(np.hypot(*np.ptp(platform.footprint, axis=0)))
        reach = platform.scan.range_max
        return {
            "speed": min(platform.limits.linear, 0.5),
            "turn": min(platform.limits.angular, 4.0),
            "spacing": 1.5 * threshold,
            "give": threshold,
            "wall": min(3.0 * threshold, 0.9 * reach),
            "object_width": 2.0 * diagonal,
            "near": threshold,
            "far_aside": reach * 3.0 / 7.0,
            "far_behind": reach * 5.0 / 7.0,
        }

    def report(self) -> Mapping[str, Scalar]:
        """Law elastic: flock or alone; law paper: straight, left or right."""
        return {"state": self._state}

    def drive(self, inputs: Inputs) -> Twist:
        """One command from the latest scan."""
        if inputs.scan is None:
            return ZERO
        if self.params.law == "paper":
            return self._follow_states(inputs.scan, inputs.is_new_scan)
        if inputs.scan is not self._scan:
            self._scan, self._requested = inputs.scan, self._follow(inputs.scan, inputs)
        return self._requested

    def update(self, params: FlockingParams) -> None:
        """Take over changed parameters, and look at the scan anew with them."""
        super().update(params)
        self._scan = None

    def _follow(self, scan: Scan, inputs: Inputs) -> Twist:
        params = self.params
        robots, walls = self._look(scan)
        force = self._springs(robots) + self._push(walls)
        self._state = "flock" if len(robots) else "alone"
        share = min(max(params.cruise + params.surge * float(force[0]), -_BACK), 1.0)
        aside = self._motion(robots, inputs).imag / params.speed if params.speed else 0.0
        turn = params.swing * float(force[1]) + params.align * min(max(aside, -1.0), 1.0)
        return Twist(linear=share * params.speed, angular=min(max(turn, -params.turn), params.turn))

    def _motion(self, robots: Array, inputs: Inputs) -> complex:
        """The mean velocity in m/s of the robots that are seen, forward and left of this one.

        From where they were a second ago, by odometry; 0 if that is not known.
        """
        if inputs.odometry is None:
            return 0j
        pose, now = inputs.odometry.pose, inputs.now
        heading = complex(math.cos(pose.yaw), math.sin(pose.yaw))
        places = complex(pose.x, pose.y) + heading * _places(robots)
        self._seen.append((now, places))
        while len(self._seen) > 1 and self._seen[1][0] <= now - _BASELINE:
            self._seen.popleft()
        then, before = self._seen[0]
        if not 0.5 * _BASELINE <= now - then <= 2.0 * _BASELINE or not len(before):
            return 0j
        off = np.abs(places[:, None] - before)
        is_same = off.min(axis=1, initial=math.inf) < _STEP
        if not is_same.any():
            return 0j
        steps = places[is_same] - before[off[is_same].argmin(axis=1)]
        return complex(steps.mean()) / (now - then) * heading.conjugate()

    def _look(self, scan: Scan) -> tuple[Array, Array]:
        """(k, 2) where robots are and (p, 2) where walls come closest: range, bearing.

        Both from the lidar: seen from the axle, others, whose lidars are behind theirs, would all
        lie back a little, and the pull of that breaks what aligns the headings.
        """
        params = self.params
        objects = clusters(scan, within=scan.range_max)
        is_narrow = objects.widths <= params.object_width
        is_narrow &= objects.ranges <= _SURE * scan.range_max
        seen = np.array((objects.ranges, objects.bearings)).T
        robots = seen[is_narrow & objects.is_free]
        points = closest_points(scan, within=params.wall)
        # A robot that another half hides does not count as one, but is no wall either.
        gaps = np.abs(_places(points)[:, None] - _places(seen[is_narrow]))
        walls = points[gaps.min(axis=1, initial=math.inf) > _SAME]
        return robots, walls

    def _springs(self, robots: Array) -> Array:
        """(2,) the force of the springs to the nearest robots: forward, left; 1 is full."""
        params = self.params
        nearest = robots[np.argsort(robots[:, 0], kind="stable")[: params.ties]]
        stretch = (nearest[:, 0] - params.spacing) / params.give
        force = np.clip(np.where(stretch < 0.0, _STIFFER * stretch, stretch), -_STIFFER, 1.0)
        return _sum(force, nearest[:, 1])

    def _push(self, walls: Array) -> Array:
        """(2,) the force of the walls: forward, left; 1 is full."""
        params = self.params
        depth = max(params.wall - params.spacing, params.give)
        push = (params.wall - walls[:, 0]) / depth
        return -_sum(np.clip(push, 0.0, _STIFFER), walls[:, 1])

    def _follow_states(self, scan: Scan, is_new: bool) -> Twist:
        params = self.params
        if is_new or self._state not in _TURNS:
            self._state, self._goes_on = self._next_state(scan)
        speed = params.speed if self._goes_on else 0.0
        return Twist(linear=speed, angular=_TURNS[self._state] * params.paper_turn)

    def _next_state(self, scan: Scan) -> tuple[str, bool]:
        """Where to turn, and whether to drive on meanwhile."""
        params = self.params
        ranges = np.where(np.isnan(scan.ranges), math.inf, np.maximum(scan.ranges, scan.range_min))
        bearings = np.array([wrap(bearing) for bearing in scan.bearings.tolist()])
        sector = np.rint(bearings / _SECTOR).astype(np.int64) % 4
        ahead, left, behind, right = _filled(sector, ranges < params.near)
        if ahead > _FEW:
            nearest = bearings[np.argmin(np.where(sector == 0, ranges, math.inf))]
            return ("right" if nearest > 0.0 else "left"), False
        least, most = 0.5 * _FEW, _MANY
        if least <= left < most:
            return "right", True
        if least <= ahead < most:
            return self._either(), True
        if least <= right < most:
            return "left", True
        is_seen = ranges < scan.range_max
        _, left, _, right = _filled(sector, is_seen & (ranges > params.far_aside))
        left, right = (side if side < _FEW else 0.0 for side in (left, right))
        if left != right:
            return ("left" if left > right else "right"), True
        _, _, behind, _ = _filled(sector, is_seen & (ranges > params.far_behind))
        if 0.0 < behind < _FEW:
            return self._either(), False
        return "straight", True

    def _either(self) -> str:
        """The side to which it turns already, else any."""
        if self._state not in ("left", "right"):
            return str(self.context.rng.choice(("left", "right")))
        return self._state


def _places(points: Array) -> NDArray[np.complex128]:
    """Points (k, 2) of range, bearing as complex numbers (k,)."""
    places: NDArray[np.complex128] = points[:, 0] * np.exp(1j * points[:, 1])
    return places


def _filled(sector: NDArray[np.int64], is_counted: NDArray[np.bool_]) -> list[float]:
    """How many rad of the sectors ahead, left, behind and right these rays fill."""
    ray = 2.0 * math.pi / max(len(sector), 1)
    return [ray * float(np.count_nonzero(is_counted & (sector == which))) for which in range(4)]


def _sum(lengths: Array, bearings: Array) -> Array:
    """(2,) the sum of vectors of lengths (k,) along bearings (k,)."""
    return np.array([float(lengths @ np.cos(bearings)), float(lengths @ np.sin(bearings))])

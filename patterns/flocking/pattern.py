"""Flocking: the robots move as one group, without messages and without knowing other headings.

Source of law "paper": Moeslinger, Schmickl and Crailsheim, "A minimalist flocking algorithm for
swarm robots" (2011), as Kaiser et al., ICRA 2022, have it in ROS2swarm: four sectors, three
distances and, by priority, straight on or a turn.

Law "elastic" is ours. Springs tie each robot to the few nearest robots. The force along the heading
changes the speed, and the force across the heading turns the robot (Ferrante et al.,
"Self-organized flocking with a mobile robot swarm: a novel motion control method", Adaptive
Behavior 20, 2012). Springs alone align headings slowly and not for long: a robot turns about its
axle, and the lidar and the body, which other robots see, are behind the axle. So the robot also
turns to the direction in which the other robots move (aligning: Vicsek et al., Phys. Rev. Lett. 75,
1995). This direction is measured from scans a second apart and the robot's odometry; without
odometry only the springs act. Walls push like springs; a wall is an object that is wider than a
robot.

Limits: a pillar counts as a robot, a robot within about 0.2 m of a wall as a part of the wall. A
robot that sees no other robot drives straight on.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmd.api import (
    ZERO,
    Array,
    Context,
    Inputs,
    MovementPattern,
    ObjectWidth,
    Params,
    Platform,
    Recovery,
    Scalar,
    Scan,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    closest_points,
    clusters,
    of_threshold,
    threshold,
)

# m: a wall point nearer than this to a robot belongs to the robot.
_ROBOT_RADIUS = 0.25
# Beyond this share of its range the lidar sees only parts of an object.
_MAX_RANGE_SHARE = 0.95
# Stiffness and highest force of a compressed spring, relative to an extended one.
_COMPRESSED_STIFFNESS = 2.0
# Share of the highest speed in reverse, so that two robots that meet separate.
_MAX_REVERSE_SHARE = 0.4
# s over which the motion of other robots is measured, and m that a robot moves meanwhile at most.
_MOTION_PERIOD = 1.0
_MAX_MOTION = 0.35
# rad: width of a sector of law "paper".
_SECTOR = math.pi / 2.0
# rad: a wider object is near, or a wall (4 and 18 rays of 360).
_NEAR_WIDTH = math.radians(4.0)
_WALL_WIDTH = math.radians(18.0)
# The states of law "paper", and the sign of their turns.
_TURNS = {"straight": 0.0, "left": 1.0, "right": -1.0}

Polar: TypeAlias = tuple[float, float]  # range, bearing


class FlockingParams(Params, frozen=True, kw_only=True):
    """The law, speeds and distances; those of law "paper" come last."""

    law: Annotated[
        Literal["elastic", "paper"],
        about(
            "elastic: tied to the nearest by springs; paper: the original states",
            source="ours: the original treats a fully visible robot as a wall, and splits",
        ),
    ] = "elastic"
    speed: TopSpeed
    turn: TopTurn
    cruise: Annotated[
        float,
        about(
            "share of the highest speed without any force",
            ge=0.0,
            le=1.0,
            source="ours: a robot that lags behind has the rest to catch up",
        ),
    ] = 0.6
    ties: Annotated[
        int,
        about(
            "number of nearest robots that it is tied to",
            ge=1,
            le=100,
            unit="robots",
            source="ours: three springs can all be at rest, six or more cannot",
        ),
    ] = 3
    spacing: Annotated[
        float,
        about(
            "distance from the lidar to another's surface at which a spring is at rest",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 1.5 times the protection threshold",
            derived=of_threshold(1.5),
        ),
    ]
    give: Annotated[
        float,
        about(
            "change of length at which a spring has its full force",
            ge=0.01,
            le=20.0,
            unit="m",
            source="ours: the protection threshold",
            derived=of_threshold(1.0),
        ),
    ]
    surge: Annotated[
        float,
        about(
            "share of the highest speed that a full force along the heading adds",
            ge=0.0,
            le=10.0,
            source="Ferrante et al. 2012, K1; the value: ours",
        ),
    ] = 1.2
    swing: Annotated[
        float,
        about(
            "turn rate that a full force across the heading adds",
            ge=0.0,
            le=10.0,
            unit="rad/s",
            source="Ferrante et al. 2012, K2; the value: ours",
        ),
    ] = 0.5
    align: Annotated[
        float,
        about(
            "turn rate if the others move sideways at the highest speed; 0: no aligning",
            ge=0.0,
            le=10.0,
            unit="rad/s",
            source="ours; aligning: Vicsek et al. 1995, Phys. Rev. Lett. 75",
        ),
    ] = 1.2
    wall: Annotated[
        float,
        about(
            "distance below which a wall pushes; at `spacing` the force is full",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: twice the spacing, at most 0.9 times the lidar's range",
            derived=_wall_distance,
        ),
    ]
    object_width: ObjectWidth
    paper_turn: Annotated[
        float, about("law paper: turn rate", ge=0.0, le=4.0, unit="rad/s", source="ROS2swarm")
    ] = 0.2
    near: Annotated[
        float,
        about(
            "law paper: turns away from nearer objects, ahead or aside",
            ge=0.02,
            le=100.0,
            unit="m",
            source="ROS2swarm: z1 and z2, the protection threshold",
            derived=of_threshold(1.0),
        ),
    ]
    far_aside: Annotated[
        float,
        about(
            "law paper: turns to farther objects, left or right",
            ge=0.02,
            le=100.0,
            unit="m",
            source="ROS2swarm: z3, 3/7 of the lidar's range",
            derived=lambda platform: platform.scan.range_max * 3.0 / 7.0,
        ),
    ]
    far_behind: Annotated[
        float,
        about(
            "law paper: turns around for farther objects behind",
            ge=0.02,
            le=100.0,
            unit="m",
            source="ROS2swarm: z4, 5/7 of the lidar's range",
            derived=lambda platform: platform.scan.range_max * 5.0 / 7.0,
        ),
    ]
    recovery: Recovery = False


class Flocking(MovementPattern[FlockingParams]):
    """Drives with the robots around it, at a distance from them."""

    group = "move together"
    params_type = FlockingParams

    def __init__(self, params: FlockingParams, context: Context) -> None:
        super().__init__(params, context)
        self._state = ""
        self._drives_on = False  # law "paper": the robot also drives while it turns
        self._scan_seq: int | None = None  # of the scan that `_requested` follows
        self._requested = ZERO
        # Time in s, and places of robots in m in the frame of the odometry, x + i y.
        self._robots_seen: deque[tuple[float, Sequence[complex]]] = deque()

    def report(self) -> Mapping[str, Scalar]:
        """The state: `flock` or `alone`; with `law: paper` `straight`, `left` or `right`."""
        return {"state": self._state}

    def drive(self, inputs: Inputs) -> Twist:
        """The command from the latest scan."""
        if inputs.scan is None:
            return ZERO
        if self.params.law == "paper":
            return self._follow_states(inputs.scan, inputs.is_new_scan)
        if inputs.scan.seq != self._scan_seq:
            self._scan_seq = inputs.scan.seq
            self._requested = self._follow(inputs.scan, inputs)
        return self._requested

    def update(self, params: FlockingParams) -> None:
        """Apply changed parameters, and evaluate the scan again."""
        super().update(params)
        self._scan_seq = None

    def _follow(self, scan: Scan, inputs: Inputs) -> Twist:
        """The command of law "elastic": springs to robots, walls, and the motion of the robots."""
        params = self.params
        robots, walls = self._robots_and_walls(scan)
        force = self._springs(robots) - self._push(walls)
        self._state = "flock" if robots else "alone"
        speed = min(max(params.cruise + params.surge * force.real, -_MAX_REVERSE_SHARE), 1.0)
        sideways = self._motion(robots, inputs).imag / params.speed if params.speed else 0.0
        turn = params.swing * force.imag + params.align * min(max(sideways, -1.0), 1.0)
        return Twist(linear=speed * params.speed, angular=min(max(turn, -params.turn), params.turn))

    def _motion(self, robots: Sequence[Polar], inputs: Inputs) -> complex:
        """The mean velocity in m/s of the robots in sight, in the base frame: forward + i left.

        A robot's velocity is the change of its position within `_MOTION_PERIOD`, in the frame of
        the odometry. A position belongs to the robot whose earlier position is nearest. 0 without
        odometry, and 0 if the lidar saw no robot a period ago.
        """
        if inputs.odometry is None:
            return 0j
        pose = inputs.odometry.pose
        now = inputs.now
        own_place = complex(pose.x, pose.y)
        heading = cmath.rect(1.0, pose.yaw)
        places = [own_place + heading * cmath.rect(*robot) for robot in robots]
        self._robots_seen.append((now, places))
        while len(self._robots_seen) > 1 and self._robots_seen[1][0] <= now - _MOTION_PERIOD:
            self._robots_seen.popleft()
        earlier, earlier_places = self._robots_seen[0]
        is_period = 0.5 * _MOTION_PERIOD <= now - earlier <= 2.0 * _MOTION_PERIOD
        if not is_period or not earlier_places:
            return 0j
        steps = (min((place - old for old in earlier_places), key=abs) for place in places)
        same_robot = [step for step in steps if abs(step) < _MAX_MOTION]
        if not same_robot:
            return 0j
        return sum(same_robot) / len(same_robot) / (now - earlier) * heading.conjugate()

    def _robots_and_walls(self, scan: Scan) -> tuple[Sequence[Polar], Sequence[Polar]]:
        """The robots, and the closest points of walls, as (range in m, bearing in rad) each.

        An object of the scan that is at most `object_width` wide counts as a robot. Ranges are from
        the lidar, not from the axle. The scan plane of a robot cuts the lidars of other robots,
        which are behind their axles. Relative to the axle all neighbours would appear shifted back,
        and the resulting pull breaks the alignment of the headings. Objects near the limit of
        the lidar's range do not count as robots, since the lidar sees only parts of them.
        """
        params = self.params
        objects = clusters(scan, within=scan.range_max).objects
        max_distance = _MAX_RANGE_SHARE * scan.range_max
        # 1. Robots. A partly hidden robot (not `is_free`) is neither followed nor a wall.
        narrow = [
            one for one in objects if one[2] <= params.object_width and one[0] <= max_distance
        ]
        robots = [(distance, bearing) for distance, bearing, _, _, is_free in narrow if is_free]
        narrow_objects = [cmath.rect(one[0], one[1]) for one in narrow]
        # 2. Walls: the closest points that do not lie on a narrow object.
        walls: list[Polar] = []
        for distance, bearing in closest_points(scan, within=params.wall).tolist():
            point = cmath.rect(distance, bearing)
            if not any(abs(point - narrow) <= _ROBOT_RADIUS for narrow in narrow_objects):
                walls.append((distance, bearing))
        return robots, walls

    def _springs(self, robots: Sequence[Polar]) -> complex:
        """The force of the springs to the nearest robots: forward + i left; 1 is full."""
        params = self.params
        force = 0j
        for distance, bearing in sorted(robots, key=_range)[: params.ties]:
            stretch = (distance - params.spacing) / params.give
            stretch *= _COMPRESSED_STIFFNESS if stretch < 0.0 else 1.0
            force += cmath.rect(min(max(stretch, -_COMPRESSED_STIFFNESS), 1.0), bearing)
        return force

    def _push(self, walls: Sequence[Polar]) -> complex:
        """The force towards the walls (to be subtracted): forward + i left; 1 is full."""
        params = self.params
        force = 0j
        depth = max(params.wall - params.spacing, params.give)
        for distance, bearing in walls:
            push = (params.wall - distance) / depth
            force += cmath.rect(min(max(push, 0.0), _COMPRESSED_STIFFNESS), bearing)
        return force

    def _follow_states(self, scan: Scan, is_new: bool) -> Twist:
        """The command of law "paper": drive straight on, or turn at `paper_turn`."""
        params = self.params
        if is_new or self._state not in _TURNS:
            self._state, self._drives_on = self._next_state(scan)
        speed = params.speed if self._drives_on else 0.0
        return Twist(linear=speed, angular=_TURNS[self._state] * params.paper_turn)

    def _next_state(self, scan: Scan) -> tuple[str, bool]:
        """The next state of law "paper", and whether the robot also drives straight ahead.

        The state is left, right or straight: away from a near object, else towards a far object,
        else straight on.
        """
        ranges = np.where(np.isnan(scan.ranges), math.inf, np.maximum(scan.ranges, scan.range_min))
        bearings = (scan.bearings + math.pi) % (2.0 * math.pi) - math.pi
        # 0: ahead, 1: left, 2: behind, 3: right.
        sector = np.rint(bearings / _SECTOR).astype(np.int64) % 4
        away = self._away_from_near(ranges, bearings, sector)
        if away is not None:
            return away
        return self._toward_far(ranges, sector, scan.range_max) or ("straight", True)

    def _away_from_near(
        self, ranges: Array, bearings: Array, sector: NDArray[np.int64]
    ) -> tuple[str, bool] | None:
        """The state by which the robot turns away from a near object; None without a near object.

        The result also says whether the robot drives while it turns. `ranges`, `bearings`,
        `sector`: (n,) m, rad, and the sector of each ray. All near rays of a sector count as one
        object; their angle in rad is its width.
        """
        ahead, left, _, right = _filled(sector, ranges < self.params.near)
        if ahead > _NEAR_WIDTH:  # turn away from the nearest point ahead, without driving
            nearest = bearings[np.argmin(np.where(sector == 0, ranges, math.inf))]
            return ("right" if nearest > 0.0 else "left"), False
        # a wider object is a wall
        min_width = 0.5 * _NEAR_WIDTH
        max_width = _WALL_WIDTH
        if min_width <= left < max_width:
            return "right", True
        if min_width <= ahead < max_width:
            return self._either(), True
        if min_width <= right < max_width:
            return "left", True
        return None

    def _toward_far(
        self, ranges: Array, sector: NDArray[np.int64], range_max: float
    ) -> tuple[str, bool] | None:
        """The state by which the robot turns to a far object; None without a far object.

        The result also says whether the robot drives while it turns.
        `ranges`, `sector`: (n,) m, and the sector of each ray. `range_max`: m, of the sensor. From
        afar a robot is narrower than _NEAR_WIDTH, so a wider object is a wall and does not count.
        """
        is_seen = ranges < range_max
        _, left, _, right = _filled(sector, is_seen & (ranges > self.params.far_aside))
        left, right = (width if width < _NEAR_WIDTH else 0.0 for width in (left, right))
        if left != right:
            return ("left" if left > right else "right"), True
        _, _, behind, _ = _filled(sector, is_seen & (ranges > self.params.far_behind))
        if 0.0 < behind < _NEAR_WIDTH:  # turn around, without driving
            return self._either(), False
        return None

    def _either(self) -> str:
        """The side to which the robot already turns, else a random side."""
        if self._state not in ("left", "right"):
            return str(self.context.rng.choice(("left", "right")))
        return self._state


def _wall_distance(platform: Platform) -> float:
    return min(3.0 * threshold(platform), 0.9 * platform.scan.range_max)


def _range(robot: Polar) -> float:
    return robot[0]


def _filled(sector: NDArray[np.int64], is_counted: NDArray[np.bool_]) -> list[float]:
    """The rad of the sectors ahead, left, behind and right that these rays fill."""
    ray = 2.0 * math.pi / max(len(sector), 1)
    return [ray * count for count in np.bincount(sector[is_counted], minlength=4).tolist()]

"""Mode `barrier`: the command nearest to the request from which the robot can still stop.

The speed at which the outline closes on a near return is linear in the twist. A constraint keeps
this speed at or below a cap. From the cap the robot can still stop before robot and obstacle touch,
while the obstacle approaches at its assumed speed. Each constraint is a half-plane of permitted
twists. The command is the permitted twist nearest to the requested command. The command is reduced
further if the outline would not stay clear while the robot brakes. The zero command satisfies all
constraints. Moving away from an obstacle is free, except that a robot in contact moves at creep
speed. Far from obstacles a requested command passes unchanged, bit by bit.

Sources: control barrier functions as command filters (Ames, Xu, Grizzle and Tabuada, IEEE TAC
2017); for swarms Wang, Ames and Egerstedt, IEEE T-RO 2017; "passive safety", no own fault at
contact: Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017. Unlike theirs, all inputs come from
the robot's own lidar and odometry. docs/safety.md states what holds and under which assumptions.

Cython compiles this file with its parts as one unit, and CPython runs the files where they are not
compiled (core/kernels.py). Each comparison is written so that a NaN makes a constraint
stricter: an unknown constraint forbids motion.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import fabs, hypot
from swarmd.core.errors import ConfigError
from swarmd.core.messages import NarrowestPassage
from swarmd.core.values import (
    ZERO,
    Array,
    Limits,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    TouchZone,
    Twist,
)
from swarmd.robot.protection.barrier_assumptions import OTHER, Assumptions
from swarmd.robot.protection.blind_zone import HiddenObstacles
from swarmd.robot.protection.closing_speed import CREEP_SPEED
from swarmd.robot.protection.comparisons import maximum
from swarmd.robot.protection.constraints import ConstraintRows, Constraints, SpeedAxes, linear_limit
from swarmd.robot.protection.dead_reckoning import ScanMotion
from swarmd.robot.protection.decision import Clearance, DecisionContext, ModeDecision, MovedWall
from swarmd.robot.protection.envelope import Creeping
from swarmd.robot.protection.feasible_set import FeasibleSet
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.limiting_obstacles import LimitingRows
from swarmd.robot.protection.obstacles import NO_NUMBERS, NO_ROWS, NearObstacles
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.passage import Room
from swarmd.robot.protection.projection import Projection
from swarmd.robot.protection.settings import BarrierSettings
from swarmd.robot.protection.stopping import Speeds, StopCheck
from swarmd.robot.protection.walls.standing_walls import StandingWalls
from swarmd.robot.sensing.rays import unit_vectors

SLOW_REQUEST = 3.0 * CREEP_SPEED
"""m/s: a robot with a faster request does not creep towards an obstacle."""
CREEP_GAIN = 1e-6
"""How much nearer to the request creeping must come; the distance is that of the projection."""

_make_decision = ModeDecision  # a C name: no lookup in each decision


@cython.cclass
class Barrier:
    """Mode `barrier`. Units: m, s, rad."""

    mode = "barrier"

    _limits: Limits
    _scan: ScanSpec
    # Cython sets an attribute without a value to None, and so does CPython (cython_shadow.py).
    _hidden: HiddenObstacles | None  # None if the lidar reports near returns
    _walls: StandingWalls | None  # None: walls are not assumed to stand
    _feasible: FeasibleSet
    _projection: Projection
    _stop: StopCheck
    _limiting: LimitingRows
    # The last request in the present situation, and its result.
    _is_decided: bool  # False until `_asked` is judged
    _is_limited: bool  # the request must be limited
    _asked: Speeds  # of the request
    _speeds: Speeds  # of the limited command
    _decision: ModeDecision  # the ModeDecision of a limited request

    def __init__(self, platform: Platform) -> None:
        """Build the parts of the mode; ConfigError if the platform has no settings of the mode."""
        given = platform.protection["barrier"]
        if given is None:
            raise ConfigError(
                f"platform {platform.name}: protection mode barrier has no settings; expected"
                " protection.barrier with others_speed and unseen_extent"
            )
        settings = msgspec.convert(given, BarrierSettings)
        self._limits = platform.limits
        self._scan = platform.scan
        # Returns nearer than range_min are lost, as if nothing were there: their places are kept.
        if platform.scan.near == "lost" and platform.scan.range_min > 0.0:
            base_speed = math.hypot(platform.limits.linear, platform.limits.lateral)  # m/s at most
            approach_speed = settings.others_speed + base_speed
            self._hidden = HiddenObstacles(
                platform.scan.range_min, approach_speed, 1.0 / platform.scan.rate
            )
        assumptions = Assumptions(platform, settings)
        outline = Outline(platform)
        if settings.walls_stand is not None:
            self._walls = StandingWalls(platform, settings.walls_stand, settings.unseen_extent)
        self._feasible = feasible = FeasibleSet(assumptions, outline, self._walls)
        self._projection = Projection()
        self._stop = StopCheck(assumptions, outline, feasible.constraints)
        self._limiting = LimitingRows(assumptions, feasible.constraints, outline)
        self._asked = Speeds()
        self._speeds = Speeds()
        self._decision = ModeDecision(ZERO, is_active=False)

    def clearance(self, speed: float) -> Clearance:
        """The clearance needed to drive at `speed`: ahead, and to each side."""
        return self._room().clearance(speed)

    def narrowest_passage(self) -> NarrowestPassage:
        """The narrowest door, corridor and meeting that protection lets this robot through."""
        return self._room().narrowest_passage()

    def _room(self) -> Room:
        return Room(self._feasible.assumptions, self._feasible.outline, self._scan)

    @property
    def min_gap(self) -> float | None:
        """The m from the outline to the nearest return of the last scan; None without a return."""
        return self._feasible.near.min_gap

    @property
    def has_walls(self) -> bool:
        """True if walls that have stood are assumed to stand on (`walls_stand`)."""
        return self._walls is not None

    def kinds(self) -> list[int]:
        """The kind of the return of each ray of the last scan, such as BARE_WALL."""
        walls = self._walls
        count = len(self._feasible.near.bearings)
        if walls is None or not walls.has_kinds:
            return [OTHER] * count
        return [walls.kinds[i] for i in range(count)]

    @property
    def moved_wall(self) -> MovedWall | None:
        """The wall that the last scan showed to move, against `walls_stand`; None without one."""
        return None if self._walls is None else self._walls.moved

    def trust_walls(self, is_trusted: bool) -> None:
        """Whether the assumption `walls_stand` holds; False after it was found violated."""
        if self._walls is not None:
            self._walls.is_trusted = is_trusted

    def hear(self, diagonal: float) -> None:
        """Take in the longest diagonal in m of the platforms of all peers; inf: not known."""
        if diagonal != self._feasible.near.longest_peer:
            self._feasible.near.hear(diagonal)
            self._feasible.situation.is_known = False
        if self._walls is not None:
            self._walls.hear(diagonal)

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Take in a new scan: find the returns that are near enough to constrain the robot.

        The time of a scan is the time of its newest ray. But if conditioning has filled a sector of
        the scan with remembered rays, the age of these rays counts. If a scan is not newer than the
        scan before, only `min_gap` is set, and the obstacles of the scan before stay: odometry
        moves these obstacles on, but does not move remembered rays.

        `geometry` is the mounting of the lidar, for the hidden obstacles. `context` has the
        time, the age of the scan, and odometry.
        """
        motion: ScanMotion = self._feasible.motion
        near: NearObstacles = self._feasible.near

        # 1. Drops the moved wall that the scan before showed. Takes in odometry, and the directions
        # of the rays.
        if self._walls is not None:
            self._walls.moved = None
        if context.odometry is not None:
            self._feasible.reckoning.record(context.odometry)
        if scan.bearings is not near.bearings:  # each scan of a robot that turns has its own
            near.set_bearings(scan.bearings)

        # 2. Time and pose of the scan. A scan that is not newer sets `min_gap` alone.
        ranges = view(scan.ranges)
        ages = NO_NUMBERS if scan.ages is None else view(scan.ages)
        age = context.scan_age or 0.0
        odometry_age = context.odometry_age or 0.0
        newest = self._newest_age(scan)
        if not motion.begin(context.now, age, newest, context.scan_delay, odometry_age, ages):
            near.find_min_gap(ranges, scan.range_min)
            return

        # 3. Obstacles in the blind zone, and near returns.
        hidden = NO_ROWS
        obstacles = self._hidden
        if obstacles is not None:
            moved = Pose(motion.moved.x, motion.moved.y, motion.moved.yaw)
            obstacles.update(scan, geometry, moved, motion.driven(), motion.seconds)
            if len(obstacles.bearings):
                hidden = view(_rays_and_ranges(obstacles.bearings, obstacles.nearest))
        filled = NO_NUMBERS if scan.filled is None else view(scan.filled)
        near.take_scan(ranges, scan.range_min, ages, filled, scan.borrowed, hidden)
        self._feasible.situation.is_known = False

    def _newest_age(self, scan: Scan) -> float:
        """The age in s of the newest ray of a scan when the scan arrived.

        A conditioned scan states this age (`newest_age`). For other scans the platform states the
        mean age of all rays on arrival (`latency`). Subtracted from this mean age is the mean time
        by which the rays are older than the newest ray.
        """
        if scan.newest_age is not None:
            return scan.newest_age
        ages = scan.ages
        mean = float(ages.mean()) if ages is not None and len(ages) else 0.0
        return max(self._scan.latency - mean, 0.0)

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The feasible command nearest to `requested`; `requested` itself if it is feasible.

        ZERO if odometry had a reset since the last scan: then the place of the obstacles is
        unknown.

        Args:
            requested: the command within the limits of the platform.
            context: the time, the inputs, and their ages.
            command: the command in force, by which the base moves until the next command.
            touch: the granted touch zone, in which the robot may touch obstacles; None: no zone.
        """
        # 1. The usual cases without constraints.
        feasible: FeasibleSet = self._feasible
        feasible.take_context(context, command, touch)
        speed = requested.linear
        angular = requested.angular
        lateral = requested.lateral
        is_zero = speed == 0.0 and angular == 0.0 and lateral == 0.0
        if is_zero or feasible.is_unbounded():
            return _make_decision(requested, False)
        if not feasible.has_scan_pose():
            return _make_decision(ZERO, True)

        # 2. The plane of two speeds: the linear speed in the request's direction, and the turn.
        along_x = 1.0
        along_y = 0.0
        limit = feasible.assumptions.linear_limit
        if lateral != 0.0:
            speed = hypot(requested.linear, lateral)
            along_x = requested.linear / speed
            along_y = lateral / speed
            limit = linear_limit(self._limits, along_x, along_y)

        # 3. Builds the constraints, or repeats the decision for the same situation and request.
        is_same_situation = feasible.enter(context, command, along_x, along_y, limit)
        is_same_request = self._asked.linear == speed and self._asked.angular == angular
        if is_same_situation and self._is_decided and is_same_request:
            return self._decision if self._is_limited else _make_decision(requested, False)

        # 4. Limits the request.
        self._is_decided = False  # nothing to repeat until `_judge` has set `_speeds`
        self._asked.linear = speed
        self._asked.angular = angular
        self._is_limited = self._judge(speed, angular)
        self._is_decided = True
        if not self._is_limited:
            return _make_decision(requested, False)

        # 5. The limited command with the obstacles that limit it.
        linear = self._speeds.linear
        twist = Twist(linear * along_x, self._speeds.angular, linear * along_y)
        rows = self._limiting.report(self._projection.x, self._projection.y)
        self._decision = _make_decision(twist, True, rows)
        return self._decision

    def _judge(self, speed: float, angular: float) -> bool:
        """True if a request must be limited; sets `_speeds` to the limited speeds."""
        axes: SpeedAxes = self._feasible.constraints.axes
        rows: ConstraintRows = self._feasible.constraints.rows
        creeping: Creeping = self._feasible.creeping
        projection: Projection = self._projection
        wanted_x = speed / axes.limit
        wanted_y = angular / axes.angular_limit
        if creeping.is_active:
            creeping.end(rows, axes)
        projection.project(rows, wanted_x, wanted_y)
        self._speeds.linear = projection.x * axes.limit
        self._speeds.angular = projection.y * axes.angular_limit
        is_reduced = self._stop.limit(self._speeds)
        if not is_reduced and projection.x == wanted_x and projection.y == wanted_y:
            return False
        if not creeping.is_possible:
            return True
        slow_cap = 0.0  # m/s, of the caps of a slow request
        if 0.0 < fabs(speed) <= SLOW_REQUEST:
            creeping.allow(self._feasible.constraints.placed)
            slow_cap = maximum(creeping.cap, 0.0)
        if self._is_locked():
            self._creep_out(wanted_x, wanted_y, slow_cap)
        elif slow_cap > 0.0:
            self._creep(wanted_x, wanted_y)
        return True

    def _is_locked(self) -> bool:
        """True if the present `_speeds` are no faster than a creep, and no direction permitted."""
        constraints: Constraints = self._feasible.constraints
        creeping: Creeping = self._feasible.creeping
        fastest = creeping.slow.fastest_corner(
            self._speeds.linear, self._speeds.angular, constraints.axes
        )
        if fastest > CREEP_SPEED:
            return False
        return creeping.is_locked(constraints)

    def _creep(self, wanted_x: float, wanted_y: float) -> None:
        """Set `_speeds` to the command of a creeping robot, if this command is the better command.

        The better command is nearer to the request than the present `_speeds`, by CREEP_GAIN at
        least. A creeping robot has higher caps, and an envelope of CREEP_SPEED (envelope.py).
        `wanted_x`, `wanted_y`: the requested speeds over their limits.
        """
        axes: SpeedAxes = self._feasible.constraints.axes
        rows: ConstraintRows = self._feasible.constraints.rows
        creeping: Creeping = self._feasible.creeping
        projection: Projection = self._projection
        present_x = projection.x
        present_y = projection.y
        off = hypot(
            self._speeds.linear / axes.limit - wanted_x,
            self._speeds.angular / axes.angular_limit - wanted_y,
        )
        creeping.begin(rows, axes)
        projection.project(rows, wanted_x, wanted_y)
        if hypot(projection.x - wanted_x, projection.y - wanted_y) < off - CREEP_GAIN:
            self._speeds.linear = projection.x * axes.limit
            self._speeds.angular = projection.y * axes.angular_limit
        else:
            creeping.end(rows, axes)
            projection.x = present_x
            projection.y = present_y

    def _creep_out(self, wanted_x: float, wanted_y: float, least: float) -> None:
        """Set `_speeds` to the command of a locked robot, which creeps.

        The present `_speeds` satisfy the constraints of this robot, too, so its command is at least
        as near to the request. `wanted_x`, `wanted_y`: the requested speeds over their limits.
        `least`: m/s, as of `Creeping.begin_out`.
        """
        axes: SpeedAxes = self._feasible.constraints.axes
        creeping: Creeping = self._feasible.creeping
        projection: Projection = self._projection
        creeping.begin_out(self._feasible.constraints, self._feasible.near, least)
        projection.project(self._feasible.constraints.rows, wanted_x, wanted_y)
        self._speeds.linear = projection.x * axes.limit
        self._speeds.angular = projection.y * axes.angular_limit


def _rays_and_ranges(bearings: Array, nearest: Array) -> Array:
    """(n, 3) unit vectors to hidden obstacles, and the least m of each from the lidar."""
    return np.column_stack((unit_vectors(bearings), nearest))

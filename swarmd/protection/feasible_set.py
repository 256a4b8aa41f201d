"""The feasible set of mode `barrier`: all constraints on the next command.

A situation (time, scan, odometry, ...) has one feasible set, which all requests in it share. Part
of the library of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.protection.buffers import is_same, maximum
from swarmd.protection.closing_speed import DECISION_PERIOD
from swarmd.protection.constraints import ConstraintRows, Constraints, PlacedPoints, SpeedAxes
from swarmd.protection.dead_reckoning import (
    LONGEST_EXTRAPOLATION,
    DeadReckoning,
    PlanarPose,
    ScanMotion,
)
from swarmd.protection.envelope import Creeping
from swarmd.protection.obstacles import NearObstacles, ToldDiscs
from swarmd.protection.outline import Outline
from swarmd.protection.touch_zone import TouchSector

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import NAN, cos, sin
else:
    from swarmd.core.cython_shadow import NAN, cos, sin

_NO_ODOMETRY = cython.declare(cython.Py_ssize_t, -1)


@cython.final
@cython.cclass
class Situation:
    """The inputs of a decision that determine the constraints.

    A new scan, touch zone or set of discs sets `is_known` to False instead.
    """

    is_known: cython.bint
    now: cython.double
    scan_age: cython.double  # s; NaN without a scan
    odometry_age: cython.double  # s; NaN without odometry
    version: cython.Py_ssize_t  # of odometry
    along_x: cython.double  # the direction of the linear speed
    along_y: cython.double

    @cython.cfunc
    @cython.exceptval(-1)
    def keep(
        self,
        now: cython.double,
        scan_age: cython.double,
        odometry_age: cython.double,
        version: cython.Py_ssize_t,
        along_x: cython.double,
        along_y: cython.double,
    ) -> cython.int:
        """1 if all values equal the kept ones; else keep the new values, set `is_known` False."""
        if (
            self.is_known
            and self.now == now
            and self.version == version
            and is_same(self.scan_age, scan_age)
            and is_same(self.odometry_age, odometry_age)
            and self.along_x == along_x
            and self.along_y == along_y
        ):
            return 1
        self.is_known, self.now = False, now
        self.scan_age, self.odometry_age = scan_age, odometry_age
        self.version = version
        self.along_x, self.along_y = along_x, along_y
        return 0


@cython.final
@cython.cclass
class FeasibleSet:
    """The constraints of one robot in its present situation, and what they are made of."""

    assumptions: Assumptions
    outline: Outline
    reckoning: DeadReckoning
    motion: ScanMotion
    near: NearObstacles
    told: ToldDiscs
    touch: TouchSector
    situation: Situation
    constraints: Constraints
    creeping: Creeping
    _predicted: PlanarPose  # at which the next command takes effect
    _frame: PlanarPose  # of the last scan in the predicted base frame
    _told_pose: PlanarPose  # at which a disc was measured, in the same frame

    def __init__(self, assumptions: Assumptions, outline: Outline) -> None:
        self.assumptions, self.outline = assumptions, outline
        self.reckoning = DeadReckoning(assumptions)
        self.motion = ScanMotion(assumptions, self.reckoning)
        self.near = NearObstacles(assumptions, outline, self.motion)
        self.told, self.touch = ToldDiscs(), TouchSector()
        self.situation = Situation()
        self.constraints = Constraints(assumptions, outline, self.touch)
        self.creeping = Creeping(assumptions, outline)
        self._predicted, self._frame = PlanarPose(), PlanarPose()
        self._told_pose = PlanarPose()

    @cython.cfunc
    @cython.exceptval(-1)
    def is_unbounded(self) -> cython.int:
        """1 if no obstacle and no touch zone constrains the robot."""
        return not (
            self.touch.is_granted or self.near.is_near or self.near.points.count or self.told.count
        )

    @cython.cfunc
    @cython.exceptval(-1)
    def take_context(self, context, command, touch) -> cython.int:
        """Take the inputs of a decision: odometry, discs, the touch zone, the command in force."""
        odometry = context.odometry
        if odometry is not None and odometry is not self.reckoning.odometry:
            self.reckoning.record(odometry)
        if touch is not self.touch.zone and touch != self.touch.zone:
            self.touch.grant(touch, self.outline.corners)
            self.situation.is_known = False
        told = context.told + context.near if context.near else context.told
        if told is not self.told.obstacles and told != self.told.obstacles:
            self.told.set(told)
            self.situation.is_known = False
        self.told.find_binding(self.assumptions, self.outline.radius)
        self.motion.ahead.note(command.linear)
        self.motion.left.note(command.lateral)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def has_scan_pose(self) -> cython.int:
        """1 if the pose of the last scan is valid: odometry had no reset since."""
        return self.motion.resets == self.reckoning.resets

    @cython.cfunc
    @cython.exceptval(-1)
    def enter(
        self,
        context,
        command,
        along_x: cython.double,
        along_y: cython.double,
        limit: cython.double,
    ) -> cython.int:
        """1 if the constraints of the last decision still hold; else 0, and build them anew.

        The linear speed has the direction `along_x`, `along_y` and the limit `limit` m/s.
        """
        is_known: cython.bint = self.situation.keep(
            context.now,
            NAN if context.scan_age is None else context.scan_age,
            NAN if context.odometry_age is None else context.odometry_age,
            _NO_ODOMETRY if context.odometry is None else self.reckoning.version,
            along_x,
            along_y,
        )
        if is_known:
            return 1
        axes: SpeedAxes = self.constraints.axes
        axes.along_x, axes.along_y = along_x, along_y
        axes.limit = limit
        self._build(command.linear, command.angular, command.lateral)
        self.situation.is_known = True
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _build(
        self, linear: cython.double, angular: cython.double, lateral: cython.double
    ) -> cython.int:
        """Build all constraints of the situation; the arguments are the command in force."""
        near: NearObstacles = self.near
        assumptions: Assumptions = self.assumptions
        constraints: Constraints = self.constraints
        rows: ConstraintRows = constraints.rows
        odometry_age: cython.double = self.situation.odometry_age
        if odometry_age != odometry_age:
            odometry_age = 0.0
        self.reckoning.predict_pose(odometry_age, linear, angular, lateral, self._predicted)
        self._frame.set_relative(self.motion.pose, self._predicted)
        age: cython.double = self.situation.now - self.motion.taken + REACTION
        late: cython.double = maximum(odometry_age - LONGEST_EXTRAPOLATION, 0.0)
        unknown: cython.double = (late + self.motion.lag) * assumptions.surface_speed
        free: cython.double = assumptions.margin + assumptions.unseen_extent + unknown
        furthest: cython.double = assumptions.binding_range(age + self.motion.oldest)
        constraints.begin(near, self.told.count, furthest)
        constraints.add_seen(near, self._frame, age, free)
        if self.touch.is_granted:
            constraints.allow_touch()
        self._add_told(odometry_age, late)
        rows.all = rows.count
        if near.is_near or self.told.count:
            if self._is_touching():
                self.creeping.slow.put(rows, constraints.axes)
            else:
                self.creeping.usual.put(rows, constraints.axes)
        self.creeping.is_active, self.creeping.cap = False, 0.0
        is_seen_alone: cython.bint = not (self.touch.is_granted or self.told.count)
        if assumptions.may_creep and near.is_near and is_seen_alone:
            self.creeping.allow(constraints.placed)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_told(self, odometry_age: cython.double, late: cython.double) -> cython.int:
        """Add the constraints of the discs, moved to where odometry now places them.

        `late` in s: the part of the age of odometry that is not extrapolated.
        """
        k: cython.Py_ssize_t
        told: ToldDiscs = self.told
        table: cython.double[:, ::1] = told.table
        pose: PlanarPose = self._told_pose
        seen: cython.Py_ssize_t = self.constraints.placed.seen
        moved: cython.double = late * self.assumptions.surface_speed
        for k in range(told.count):
            row: cython.Py_ssize_t = told.row[k]
            self.reckoning.find_pose(odometry_age, table[row, 3], pose)
            pose.set_relative(pose, self._predicted)
            c: cython.double = cos(pose.yaw)
            s: cython.double = sin(pose.yaw)
            x: cython.double = c * table[row, 0] - s * table[row, 1]
            y: cython.double = s * table[row, 0] + c * table[row, 1]
            self.constraints.add_disc(
                seen + k,
                pose.x + x,
                pose.y + y,
                table[row, 2],
                table[row, 3],
                moved,
            )
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_touching(self) -> cython.int:
        """1 if an obstacle may touch the robot.

        Contact with a return of the scan lasts until the next scan: an obstacle that pushes the
        robot follows it, but by odometry the robot moves away, at 0.3 m/s by 4.6 cm within 0.15 s.
        """
        i: cython.Py_ssize_t
        near: NearObstacles = self.near
        rows: ConstraintRows = self.constraints.rows
        placed: PlacedPoints = self.constraints.placed
        for i in range(0 if near.has_contact else placed.seen):
            gap: cython.double = min(placed.gap[i], placed.scan_gap[i])
            if gap <= placed.contact[i] and rows.cap[placed.first_row[i]] <= 0.0:
                near.has_contact = True
                break
        if near.has_contact:
            return 1
        # A told obstacle is somewhere in its disc. Once the disc may have reached the outline, the
        # direction to its middle does not show on which side the obstacle is.
        for i in range(placed.seen, placed.seen + placed.discs):
            left: cython.double = placed.gap[i] - (placed.free[i] - self.assumptions.margin)
            if left <= self.assumptions.others * (placed.age[i] + DECISION_PERIOD):
                return 1
        return 0

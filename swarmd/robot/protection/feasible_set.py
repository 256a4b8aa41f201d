"""The feasible set of mode `barrier`: all constraints on the next command.

A situation (time, scan, odometry, ...) has one feasible set, which all requests in it share. Part
of the unit of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import NAN, cos, sin
from swarmd.core.odometry_trail import LONGEST_EXTRAPOLATION
from swarmd.robot.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.robot.protection.closing_speed import DECISION_PERIOD
from swarmd.robot.protection.comparisons import is_same, maximum
from swarmd.robot.protection.constraints import (
    ConstraintRows,
    Constraints,
    PlacedPoints,
    SpeedAxes,
    ToldPlaces,
)
from swarmd.robot.protection.dead_reckoning import (
    DeadReckoning,
    PlanarPose,
    ScanMotion,
)
from swarmd.robot.protection.envelope import Creeping
from swarmd.robot.protection.obstacles import (
    DISC_AGE,
    DISC_RADIUS,
    DISC_X,
    DISC_Y,
    NearObstacles,
    ObstacleDiscs,
    ReturnLayer,
)
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.touch_zone import TouchSector

if TYPE_CHECKING:
    from swarmd.core.values import TouchZone, Twist
    from swarmd.robot.protection.decision import DecisionContext

_NO_ODOMETRY = -1


@cython.cclass
class Situation:
    """The inputs of a decision that determine the constraints.

    The scan, the touch zone and the discs are not among the attributes: `FeasibleSet` and `Barrier`
    set `is_known` to False for a new scan, touch zone or set of discs.
    """

    is_known: bool  # the constraints were built for the inputs below
    now: float
    scan_age: float  # s; NaN without a scan
    odometry_age: float  # s; NaN without odometry
    version: int  # of odometry
    along_x: float  # the direction of the linear speed
    along_y: float

    def keep(
        self,
        now: float,
        scan_age: float,
        odometry_age: float,
        version: int,
        along_x: float,
        along_y: float,
    ) -> bool:
        """True if the arguments equal the stored inputs; else store the arguments, and return 0.

        With 0 the constraints of the last decision do not hold any more, and `is_known` becomes
        False. `now`: s. `scan_age`, `odometry_age`: s, NaN without a scan or odometry. `version`:
        the number of the reading of odometry. `along_x`, `along_y`: the direction of the linear
        speed.
        """
        if (
            self.is_known
            and self.now == now
            and self.version == version
            and is_same(self.scan_age, scan_age)
            and is_same(self.odometry_age, odometry_age)
            and self.along_x == along_x
            and self.along_y == along_y
        ):
            return True
        self.is_known = False
        self.now = now
        self.scan_age = scan_age
        self.odometry_age = odometry_age
        self.version = version
        self.along_x = along_x
        self.along_y = along_y
        return False


@cython.cclass
class FeasibleSet:
    """The constraints of one robot in its present situation, and what they are made of."""

    assumptions: Assumptions
    outline: Outline
    reckoning: DeadReckoning
    motion: ScanMotion
    near: NearObstacles
    discs: ObstacleDiscs
    touch: TouchSector
    situation: Situation
    constraints: Constraints
    creeping: Creeping
    _predicted: PlanarPose  # at which the next command takes effect
    _frame: PlanarPose  # of the last scan in the predicted base frame
    _disc_pose: PlanarPose  # at which a disc was measured, in the same frame

    def __init__(
        self, assumptions: Assumptions, outline: Outline, layer: ReturnLayer | None
    ) -> None:
        self.assumptions = assumptions
        self.outline = outline
        self.reckoning = DeadReckoning(assumptions)
        self.motion = ScanMotion(assumptions, self.reckoning)
        self.near = NearObstacles(assumptions, outline, self.motion, layer)
        self.discs = ObstacleDiscs()
        self.touch = TouchSector()
        self.situation = Situation()
        self.constraints = Constraints(assumptions, outline, self.touch)
        self.creeping = Creeping(assumptions, outline)
        self._predicted = PlanarPose()
        self._frame = PlanarPose()
        self._disc_pose = PlanarPose()

    def is_unbounded(self) -> bool:
        """True if no obstacle and no touch zone constrains the robot."""
        return not (
            self.touch.is_granted or self.near.is_near or self.near.points.count or self.discs.count
        )

    def take_context(
        self, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> None:
        """Take the inputs of a decision: odometry, discs, the touch zone, the command in force."""
        odometry = context.odometry
        if odometry is not None and odometry is not self.reckoning.odometry:
            self.reckoning.record(odometry)
        if touch is not self.touch.zone and touch != self.touch.zone:
            self.touch.grant(touch, self.outline.corners)
            self.situation.is_known = False
        # Places that peers shared, and returns of the ring of range sensors.
        reported = context.told + context.near if context.near else context.told
        if reported is not self.discs.obstacles and reported != self.discs.obstacles:
            self.discs.set(reported)
            self.situation.is_known = False
        self.discs.find_binding(self.assumptions, self.outline.radius)
        self.motion.ahead.note(command.linear)
        self.motion.left.note(command.lateral)

    def has_scan_pose(self) -> bool:
        """True if the pose of the last scan is valid: odometry had no reset since."""
        return self.motion.resets == self.reckoning.resets

    def enter(
        self, context: DecisionContext, command: Twist, along_x: float, along_y: float, limit: float
    ) -> bool:
        """True if the constraints of the last decision still hold; else 0, and build them anew.

        `command` and `limit` go into the constraints, but `Situation.keep` need not compare them:

        - `command` differs at the same `now` only because the last decision was made at this `now`.
          The base has not followed this decision yet, so the predicted motion stays as it was.
        - `limit` follows from `along_x` and `along_y`: the limits of a platform do not change.

        Args:
            context: the DecisionContext: time, odometry, and the ages of the inputs.
            command: the command in force (a Twist), by which the base moves until the next command.
            along_x, along_y: unit vector of the linear speed of the request.
            limit: m/s, the limit of the linear speed in this direction.
        """
        scan_age = context.scan_age
        odometry_age = context.odometry_age
        is_known = self.situation.keep(
            context.now,
            NAN if scan_age is None else scan_age,
            NAN if odometry_age is None else odometry_age,
            _NO_ODOMETRY if context.odometry is None else self.reckoning.version,
            along_x,
            along_y,
        )
        if is_known:
            return True
        axes: SpeedAxes = self.constraints.axes
        axes.along_x = along_x
        axes.along_y = along_y
        axes.limit = limit
        self._build(command.linear, command.angular, command.lateral)
        self.situation.is_known = True
        return False

    def _build(self, linear: float, angular: float, lateral: float) -> None:
        """Build all constraints of the situation: linear bounds on the speeds of the next command.

        `linear`, `angular` and `lateral` are the command in force, in m/s and rad/s.
        """
        near: NearObstacles = self.near
        assumptions: Assumptions = self.assumptions
        constraints: Constraints = self.constraints
        rows: ConstraintRows = constraints.rows

        # 1. Predicts the pose at which the command takes effect, and the pose of the scan in the
        # predicted base frame. Without odometry (an age of NaN) both are 0.
        odometry_age = self.situation.odometry_age
        has_odometry = odometry_age == odometry_age
        if not has_odometry:
            odometry_age = 0.0
        self.reckoning.predict_pose(odometry_age, linear, angular, lateral, self._predicted)
        self._frame.set_relative(self.motion.pose, self._predicted)

        # 2. The distance that must stay free around each return. Odometry does not show the motion
        # after the extrapolation ends, nor the motion while the scan waited for its first use.
        not_extrapolated = maximum(odometry_age - LONGEST_EXTRAPOLATION, 0.0)
        unknown_s = not_extrapolated + self.motion.first_use_delay
        odometry_error = unknown_s * assumptions.surface_speed
        free = assumptions.margin + assumptions.unseen_extent + odometry_error
        bare_free = assumptions.margin + assumptions.foot + odometry_error
        if near.has_bare_walls():
            self._place_told(odometry_age, not_extrapolated)

        # 3. Adds the constraints of returns, then of the touch zone (directions in which the robot
        # may touch), then of discs. `age`: of the newest ray when the command takes effect.
        age = self.situation.now - self.motion.measured_at + REACTION
        binding_range = assumptions.binding_range(age + self.motion.oldest)
        constraints.begin(near, self.discs.count, binding_range)
        constraints.add_seen(near, self._frame, age, free, bare_free)
        if self.touch.is_granted:
            constraints.allow_touch()
        self._add_discs(odometry_age, not_extrapolated)

        # 4. Adds the envelope, a bound on the speed of all corners near an obstacle: the slow
        # envelope if an obstacle may touch the robot. The envelope counts in `rows.all` alone.
        rows.all = rows.count
        if near.is_near or self.discs.count:
            self.creeping.is_touching = self._is_touching()
            if self.creeping.is_touching:
                self.creeping.slow.put(rows, constraints.axes)
            else:
                self.creeping.usual.put(rows, constraints.axes)

        # 5. The robot may creep only where the scan shows all obstacles.
        has_only_returns = not (self.touch.is_granted or self.discs.count)
        self.creeping.is_active = False
        self.creeping.is_possible = assumptions.may_creep and near.is_near and has_only_returns

    def _place_told(self, odometry_age: float, not_extrapolated: float) -> None:
        """Set the circles of `constraints.told`: within `unseen_extent` m of each disc.

        All discs count, not only those that can constrain the robot themselves. The obstacle of a
        disc may have moved since its measurement. The arguments are those of `_add_discs`.
        """
        assumptions: Assumptions = self.assumptions
        told: ToldPlaces = self.constraints.told
        table = self.discs.table
        pose: PlanarPose = self._disc_pose
        moved = not_extrapolated * assumptions.surface_speed  # m, at most
        told.begin(len(table))
        for k in range(len(table)):
            age = table[k, DISC_AGE]
            self.reckoning.find_pose(odometry_age, age, pose)
            pose.set_relative(pose, self._predicted)
            cos_yaw = cos(pose.yaw)
            sin_yaw = sin(pose.yaw)
            x = cos_yaw * table[k, DISC_X] - sin_yaw * table[k, DISC_Y]
            y = sin_yaw * table[k, DISC_X] + cos_yaw * table[k, DISC_Y]
            reach = table[k, DISC_RADIUS] + assumptions.unseen_extent + moved
            reach += assumptions.others_speed * (age + REACTION)
            told.add(pose.x + x, pose.y + y, reach)

    def _add_discs(self, odometry_age: float, not_extrapolated: float) -> None:
        """Add the constraints of discs: of places that peers shared, and of near single ranges.

        Somewhere in each disc is an obstacle (`ToldObstacle`). A disc has its centre in the base
        frame at the time of its measurement. Odometry since then moves the centre into the
        predicted base frame.

        `odometry_age`: s, of the newest reading. `not_extrapolated`: s of this age beyond the
        longest extrapolation. The prediction lacks the motion of the outline in that time.
        """
        discs: ObstacleDiscs = self.discs
        table = discs.table
        pose: PlanarPose = self._disc_pose
        # In `placed` the discs come behind the `seen` returns.
        first_disc = self.constraints.placed.seen
        moved = not_extrapolated * self.assumptions.surface_speed  # m, at most
        for k in range(discs.count):  # the discs near enough to constrain the robot
            disc = discs.binding[k]  # the row in `table`
            disc_x = table[disc, DISC_X]
            disc_y = table[disc, DISC_Y]
            age = table[disc, DISC_AGE]
            self.reckoning.find_pose(odometry_age, age, pose)
            pose.set_relative(pose, self._predicted)
            cos_yaw = cos(pose.yaw)
            sin_yaw = sin(pose.yaw)
            x = cos_yaw * disc_x - sin_yaw * disc_y
            y = sin_yaw * disc_x + cos_yaw * disc_y
            self.constraints.add_disc(
                first_disc + k,
                pose.x + x,
                pose.y + y,
                table[disc, DISC_RADIUS],
                age,
                moved,
            )

    def _is_touching(self) -> bool:
        """True if an obstacle may touch the robot.

        Contact with a return of the scan lasts until the next scan (`near.has_contact`). Odometry
        cannot end a contact: by odometry a robot that is pushed moves away from the obstacle, which
        follows the robot (4.6 cm within 0.15 s, pushed at 0.3 m/s).
        """
        near: NearObstacles = self.near
        rows: ConstraintRows = self.constraints.rows
        placed: PlacedPoints = self.constraints.placed
        # 1. Returns. A cap above 0 permits to close on the obstacle, for example in a touch zone.
        for i in range(0 if near.has_contact else placed.seen):
            gap = min(placed.gap[i], placed.scan_gap[i])
            is_contact_forbidden = rows.cap[placed.first_row[i]] <= 0.0
            if gap <= placed.contact[i] and is_contact_forbidden:
                near.has_contact = True
                break
        if near.has_contact:
            return True
        # 2. Discs. An obstacle is anywhere in its disc. Once the disc may have reached the outline,
        # the direction to the centre does not show on which side of the robot the obstacle is. So
        # the robot counts as touched as soon as the obstacle may have used up the gap to the disc.
        # `free` holds the radius of the disc, and the margin. The margin is a reserve for the noise
        # of ranges, which a disc does not need, so the margin is subtracted.
        for i in range(placed.seen, placed.seen + placed.discs):
            gap_to_disc = placed.gap[i] - (placed.free[i] - self.assumptions.margin)
            if gap_to_disc <= self.assumptions.others_speed * (placed.age[i] + DECISION_PERIOD):
                return True
        return False

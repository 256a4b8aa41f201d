"""The stop check of mode `barrier`: the outline stays clear of obstacles while the robot brakes.

Part of the unit of barrier.py. A constraint limits how fast a place of the outline closes on an
obstacle now. Constraints alone do not keep the outline clear during a stop, for three reasons:

1. A corner swings outwards while the robot still turns.
2. The linear speed may move a place away from an obstacle while the angular speed moves it closer,
   or the reverse. The speed that moves away may reach zero first.
3. An obstacle may move along the outline to a place that the turn moves outwards.

For 1 and 2 the stop is simulated, as in the dynamic window approach (Fox, Burgard and Thrun, IEEE
RAM 1997): with both brakes as weak as assumed, and with either brake ideal. For 3, the turn may
move no place outwards that an obstacle can have reached. Units: m, s, rad, in the predicted base
frame.
"""

from __future__ import annotations

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, doubles, view
from swarmd.core.cython_shadow import Doubles, Table, copysign, cos, fabs, sin, sqrt
from swarmd.core.values import Array
from swarmd.robot.protection.barrier_assumptions import Assumptions
from swarmd.robot.protection.closing_speed import DECISION_PERIOD
from swarmd.robot.protection.constraints import Constraints, PlacedPoints, SpeedAxes
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.projection import is_feasible

NEGLIGIBLE_SPEED = 0.015
"""m/s: closing at a speed up to this is no approach."""
FAULT_SPEED = 0.02
"""m/s: a contact at a closing speed up to this is not a fault of the robot."""
IDEAL_BRAKING = 1e9
"""m/s2 and rad/s2: an immediate stop."""

_STEPS = 4  # poses of a simulated stop
# The simulated stops: with both brakes as assumed (0), and with either brake ideal.
_BRAKES = 3
_IDEAL_LINEAR = 1
_IDEAL_ANGULAR = 2
# m by which distances may be off by rounding, so that no point that matters is left out
_ROUNDING = 1e-9
_SPEED_ROUNDING = 1e-12  # m/s, of the fastest place


def _speed_shares() -> Array:
    """The rows of _SPEED_SHARES."""
    grid = (1.0, 0.75, 0.5, 0.25, 0.0)
    shares = [(a, b) for a in grid for b in grid if (a, b) != (1.0, 1.0)]
    shares.sort(key=lambda share: (1.0 - share[0]) ** 2 + (1.0 - share[1]) ** 2)
    return np.array(shares)


_SPEED_SHARES = view(_speed_shares())
"""(24, 2) shares of the two speeds, those nearest to (1, 1) first; the last pair is zero."""


def _slowed(start: float, wanted: float, seconds: float, rate: float) -> float:
    """The speed `seconds` after `start`: for DECISION_PERIOD towards `wanted`, then towards zero.

    It changes at `rate`. NaN if `start` is NaN: such a stop is never clear.
    """
    most = min(seconds, DECISION_PERIOD) * rate
    speed = start + max(min(wanted - start, most), -most)
    left = fabs(speed) - max(seconds - DECISION_PERIOD, 0.0) * rate
    return 0.0 if left <= 0.0 else copysign(left, speed)


@cython.cclass
class StopMotion:
    """The pose of a base in a simulated stop, step by step.

    The base has three speeds: in m/s along a direction (the unit vector `along_x`, `along_y` in the
    base frame) and aside, to the left of this direction, and in rad/s. The place `x`, `y` and the
    angle `turned` begin at 0.
    """

    along_x: float
    along_y: float
    heading: float  # rad, the yaw at the begin, in the frame of the place
    x: float
    y: float
    turned: float
    # Of the last step: m along and aside, and rad.
    moved: float
    aside: float
    arc: float

    def begin(self, along_x: float, along_y: float, heading: float) -> None:
        """Begin a stop."""
        self.along_x = along_x
        self.along_y = along_y
        self.heading = heading
        self.x = 0.0
        self.y = 0.0
        self.turned = 0.0

    def advance(
        self,
        middle_s: float,
        step_s: float,
        along: float,
        aside: float,
        turn: float,
        to_along: float,
        to_aside: float,
        to_turn: float,
        braking: float,
        turning: float,
    ) -> None:
        """Move the pose by a step at the speeds in the middle of the step.

        Args:
            middle_s: s from the begin of the stop.
            step_s: s, the duration of the step.
            along, aside, turn: the speeds at the begin of the stop.
            to_along, to_aside, to_turn: the command in force until the next decision.
            braking: m/s2.
            turning: rad/s2.
        """
        self.moved = _slowed(along, to_along, middle_s, braking) * step_s
        # Most bases have no speed aside: the condition takes 3 % off a decision by eight steps.
        self.aside = (
            0.0
            if aside == 0.0 and to_aside == 0.0
            else _slowed(aside, to_aside, middle_s, braking) * step_s
        )
        self.arc = _slowed(turn, to_turn, middle_s, turning) * step_s
        self.turned += self.arc
        yaw = self.heading + self.turned - 0.5 * self.arc
        cos_yaw = cos(yaw)
        sin_yaw = sin(yaw)
        x = cos_yaw * self.along_x - sin_yaw * self.along_y
        y = sin_yaw * self.along_x + cos_yaw * self.along_y
        self.x += self.moved * x - self.aside * y
        self.y += self.moved * y + self.aside * x


@cython.cclass
class Speeds:
    """The two speeds of a command: linear in m/s along its direction, angular in rad/s."""

    linear: float
    angular: float


@cython.cclass
class StopPoints:
    """The points that the outline could touch during a stop.

    Their places in m, their present gaps in m, the gap in m that each point must keep at the begin
    of the stop (`needed_gap`), and how fast the obstacle moves in m/s (`others`).
    """

    count: int
    x: Doubles
    y: Doubles
    gap: Doubles
    needed_gap: Doubles
    others: Doubles

    def __init__(self) -> None:
        self._allocate(96)

    def check_indices(self) -> None:
        """ValueError unless `count` is within each array."""
        room = min(map(len, (self.x, self.y, self.gap, self.needed_gap, self.others)))
        if not 0 <= self.count <= room:
            raise ValueError(f"{self.count} points beside a stop in {room}")

    def _allocate(self, room: int) -> None:
        """Make all arrays anew."""
        self.x = doubles(room)
        self.y = doubles(room)
        self.gap = doubles(room)
        self.needed_gap = doubles(room)
        self.others = doubles(room)

    def collect(self, constraints: Constraints, seconds: float, travel: float) -> None:
        """Replace the points by those that the outline may touch during a stop.

        Contacts are left out, since constraints with the cap 0 forbid all motion towards contacts.
        Returns in a touch zone are left out, since the robot may touch the obstacle there.

        Args:
            constraints: the constraints of the decision, with the placed points.
            seconds: the duration of the stop.
            travel: m, how far a place of the outline moves at most during the stop.
        """
        placed: PlacedPoints = constraints.placed
        is_granted = constraints.touch.is_granted
        points = placed.seen + placed.discs
        if len(self.x) < points:
            self._allocate(points + points // 2)
        free = checked(placed.free, points)
        age = checked(placed.age, points)
        gap = checked(placed.gap, points)
        to_gap = checked(self.gap, points)
        to_needed_gap = checked(self.needed_gap, points)
        others = checked(placed.others, points)
        to_others = checked(self.others, points)
        x = checked(placed.x, points)
        y = checked(placed.y, points)
        to_x = checked(self.x, points)
        to_y = checked(self.y, points)
        count = 0
        for i in range(placed.contacts, points):
            is_return = i < placed.seen  # the other points are discs
            if is_granted and is_return and placed.in_touch_zone[i]:
                continue
            needed_gap = free[i] + others[i] * age[i]
            needed_gap_at_end = needed_gap + others[i] * seconds
            if gap[i] <= needed_gap_at_end + travel:
                to_x[count] = x[i]
                to_y[count] = y[i]
                to_gap[count] = gap[i]
                to_needed_gap[count] = needed_gap
                to_others[count] = others[i]
                count += 1
        self.count = count


@cython.cclass
class StopCheck:
    """Reduces speeds from which the robot cannot stop with its outline clear of obstacles."""

    _assumptions: Assumptions
    _outline: Outline
    _constraints: Constraints
    _points: StopPoints
    _shares: Table
    _forbidding: int  # the point that forbade the last speeds
    _motion: StopMotion
    # The simulated stop. At the end of each step: the pose, and the m that a place of the outline
    # has moved at most. At the begin of each step: the speeds.
    _poses: int  # in the steps after these the outline is too slow to matter
    _stop_x: cython.double[4]
    _stop_y: cython.double[4]
    _stop_cos: cython.double[4]
    _stop_sin: cython.double[4]
    _stop_travel: cython.double[4]
    _stop_linear: cython.double[4]
    _stop_angular: cython.double[4]
    _stop_turns: cython.bint[4]  # the turn is fast enough to move a place outwards

    def __init__(
        self, assumptions: Assumptions, outline: Outline, constraints: Constraints
    ) -> None:
        self._assumptions = assumptions
        self._outline = outline
        self._constraints = constraints
        self._points = StopPoints()
        self._shares = _SPEED_SHARES
        self._motion = StopMotion()

    def check_indices(self) -> None:
        """ValueError unless the poses are within the arrays, and the point is in use."""
        if not 0 <= self._poses <= _STEPS:
            raise ValueError(f"{self._poses} poses of a stop")
        if not 0 <= self._forbidding <= len(self._points.x):
            raise ValueError(f"the point {self._forbidding} of {len(self._points.x)}")

    def limit(self, speeds: Speeds) -> bool:
        """Reduce the speeds so that the outline stays clear while the robot brakes.

        The reduced speeds are shares of the requested speeds: the first pair of _SPEED_SHARES that
        satisfies all constraints and whose stop stays clear. The pairs nearest to the requested
        speeds come first. Returns True if a speed changed.
        """
        assumptions: Assumptions = self._assumptions
        axes: SpeedAxes = self._constraints.axes
        linear = speeds.linear
        angular = speeds.angular

        # 1. Collects the points that the outline may touch before the robot stands.
        linear_s = fabs(linear) / assumptions.braking_linear
        angular_s = fabs(angular) / assumptions.braking_angular
        seconds = DECISION_PERIOD + (angular_s if angular_s > linear_s else linear_s)
        travel = (fabs(linear) + fabs(angular) * self._outline.radius) * seconds
        self._points.collect(self._constraints, seconds, travel)
        if self._points.count == 0:
            return False

        # 2. Returns if the stop from the requested speeds stays clear.
        self._forbidding = 0  # the points are new, so the last index may be beyond them
        if self._is_clear(linear, angular):
            return False

        # 3. Tries the pairs of shares; without a clear pair the speeds are 0. Each pair is compared
        # with the constraints, since a lower linear speed alone, or a lower angular speed alone,
        # may violate a constraint that the requested speeds satisfy.
        speeds.linear = 0.0
        speeds.angular = 0.0
        for i in range(len(self._shares)):
            reduced_linear = self._shares[i, 0] * linear
            reduced_angular = self._shares[i, 1] * angular
            x = reduced_linear / axes.limit
            if not is_feasible(self._constraints.rows, x, reduced_angular / axes.angular_limit):
                continue
            if self._is_clear(reduced_linear, reduced_angular):
                speeds.linear = reduced_linear
                speeds.angular = reduced_angular
                break
        is_unchanged = speeds.linear == linear and speeds.angular == angular
        return not is_unchanged

    def _is_clear(self, linear: float, angular: float) -> bool:
        """True if the outline stays clear in each of the three simulated stops from these speeds.

        The stops: both brakes as weak as assumed, an ideal linear brake, an ideal angular brake.
        `linear` in m/s and `angular` in rad/s are a command. False if a point forbids a stop.
        """
        speed = fabs(linear)
        turn_rate = fabs(angular)
        count = self._points.count
        gap = checked(self._points.gap, count)
        needed_gap = checked(self._points.needed_gap, count)
        others = checked(self._points.others, count)
        for brake in range(_BRAKES):
            if (brake == _IDEAL_LINEAR and speed == 0.0) or (
                brake == _IDEAL_ANGULAR and turn_rate == 0.0
            ):
                continue  # an ideal brake of a speed of 0 gives the stop with both brakes

            # 1. Simulates the stop.
            linear_s = speed / self._assumptions.braking_linear
            angular_s = turn_rate / self._assumptions.braking_angular
            linear_s = 0.0 if brake == _IDEAL_LINEAR else linear_s
            angular_s = 0.0 if brake == _IDEAL_ANGULAR else angular_s
            stop_s = DECISION_PERIOD + (angular_s if angular_s > linear_s else linear_s)
            step_s = stop_s / _STEPS
            travel = self._simulate(brake, linear, angular, step_s)
            if self._poses == 0:  # the outline is too slow to close on an obstacle
                continue

            # 2. Examines the point that forbade the last speeds first: it often forbids these, too.
            if self._forbids(self._forbidding, travel, step_s):
                return False

            # 3. Examines the points that the outline can reach. A gap of NaN is not safe.
            for i in range(count):
                is_safe = gap[i] >= _safe_gap(needed_gap[i], others[i], step_s * _STEPS, travel)
                if not is_safe and self._forbids(i, travel, step_s):
                    self._forbidding = i
                    return False
        return True

    def _simulate(self, brake: int, linear: float, angular: float, step_s: float) -> float:
        """Simulate a stop in _STEPS steps; return the m that a place of the outline moves at most.

        Sets pose, travel and speeds of each step (`_stop_...`), and the number of steps in which
        the outline is fast enough to matter (`_poses`). The pose begins at 0 in the predicted base
        frame.

        Args:
            brake: 0: both brakes as assumed. _IDEAL_LINEAR, _IDEAL_ANGULAR: this brake stops at
                once.
            linear: m/s, of the command whose stop is simulated.
            angular: rad/s, of the same command.
            step_s: s, the duration of a step.
        """
        axes: SpeedAxes = self._constraints.axes
        radius = self._outline.radius
        motion: StopMotion = self._motion
        assumptions: Assumptions = self._assumptions
        linear_braking = IDEAL_BRAKING if brake == _IDEAL_LINEAR else assumptions.braking_linear
        turn_braking = IDEAL_BRAKING if brake == _IDEAL_ANGULAR else assumptions.braking_angular
        travel = 0.0
        motion.begin(axes.along_x, axes.along_y, 0.0)
        self._poses = 0
        for j in range(_STEPS):
            # 1. Moves the pose. Braking begins at the next decision, so after DECISION_PERIOD.
            motion.advance(
                step_s * (j + 0.5),
                step_s,
                linear,
                0.0,
                angular,
                linear,
                0.0,
                angular,
                linear_braking,
                turn_braking,
            )
            self._stop_x[j] = motion.x
            self._stop_y[j] = motion.y
            self._stop_cos[j] = cos(motion.turned)
            self._stop_sin[j] = sin(motion.turned)
            travel += fabs(motion.moved) + fabs(motion.arc) * radius
            self._stop_travel[j] = travel

            # 2. Stores the speeds at the begin of the step, where they are highest.
            self._stop_linear[j] = _slowed(linear, linear, step_s * j, linear_braking)
            self._stop_angular[j] = _slowed(angular, angular, step_s * j, turn_braking)

            # 3. Is the step fast enough to matter? A speed of NaN is. A turn matters above
            # FAULT_SPEED (`_turns_outwards`), any motion above NEGLIGIBLE_SPEED (`_forbids`).
            corner_turn = fabs(self._stop_angular[j]) * radius
            fastest_corner = fabs(self._stop_linear[j]) + corner_turn
            self._stop_turns[j] = not (corner_turn + _ROUNDING <= FAULT_SPEED)
            if not (fastest_corner + _SPEED_ROUNDING <= NEGLIGIBLE_SPEED):
                self._poses = j + 1
        return travel

    def _forbids(self, point: int, travel: float, step_s: float) -> bool:
        """True if a point forbids the simulated stop.

        A point forbids the stop in two cases: the outline closes on the point while the gap is too
        small, or the turn moves a place outwards that the obstacle can have reached.

        Args:
            point: the index of the point in `_points`.
            travel: m that a place of the outline moves at most during the stop.
            step_s: s, the duration of a step.
        """
        outline: Outline = self._outline
        points: StopPoints = self._points
        gap = points.gap[point]
        needed_gap = points.needed_gap[point]
        others = points.others[point]
        point_x = points.x[point]
        point_y = points.y[point]
        margin = self._assumptions.margin
        safe_gap = _safe_gap(needed_gap, others, step_s * _STEPS, travel)
        if gap >= safe_gap:
            return False
        previous_gap = gap
        for j in range(self._poses):
            # 1. The gap at this step, with the point in the frame of the simulated pose.
            dx = point_x - self._stop_x[j]
            dy = point_y - self._stop_y[j]
            cos_yaw = self._stop_cos[j]
            sin_yaw = self._stop_sin[j]
            x = cos_yaw * dx + sin_yaw * dy
            y = cos_yaw * dy - sin_yaw * dx
            present_gap = outline.gap_of(x, y)

            # 2. The outline must not close on a point whose gap is too small. At the end of the
            # step the obstacle has moved for j + 1 steps. A gap of NaN is too small, and closes.
            is_free = present_gap >= needed_gap + others * (step_s * (j + 1.0))
            is_closing = not (previous_gap - present_gap <= NEGLIGIBLE_SPEED * step_s)
            if is_closing and not is_free:
                return True

            # 3. The turn must not move a place outwards within the reach of the obstacle. The turn
            # acts during the whole step, so the reach is that of the middle of the step, after
            # j + 0.5 steps. The reach excludes the margin, which is a reserve for noise.
            if self._stop_turns[j]:
                reach = needed_gap - margin + others * (step_s * (j + 0.5))
                if present_gap < reach and self._turns_outwards(j, x, y, reach):
                    return True

            # 4. Ends early if the gap is large enough for the rest of the stop. The outline can
            # only move the rest of `travel`, so the travel so far is added to the gap.
            if present_gap + self._stop_travel[j] >= safe_gap:
                return False
            previous_gap = present_gap
        return False

    def _turns_outwards(self, pose: int, x: float, y: float, reach: float) -> bool:
        """True if the turn of a simulated stop moves a place of the outline outwards, near a point.

        Only places of the outline within `reach` m of the point are examined. The outward
        speed of a place is its speed along the outward normal of its edge. The place counts as
        moved outwards if this speed is above FAULT_SPEED by the turn alone, and also by the turn
        and the linear speed together.

        Args:
            pose: the step of the stop.
            x: m, the point in the frame of the simulated pose.
            y: m, of the same point.
            reach: m, how far the obstacle can have moved along the outline.
        """
        outline: Outline = self._outline
        axes: SpeedAxes = self._constraints.axes
        edges = outline.edges
        linear = self._stop_linear[pose]
        angular = self._stop_angular[pose]
        axis_x = checked(outline.axis_x, 2 * edges)
        axis_y = checked(outline.axis_y, 2 * edges)
        origin = checked(outline.origin, 2 * edges)
        lengths = checked(outline.length, edges)
        for k in range(edges):
            nx = axis_x[edges + k]
            ny = axis_y[edges + k]
            above = nx * x + ny * y - origin[edges + k]
            if not above < reach:  # the whole edge is out of reach
                continue
            length = lengths[k]
            along = axis_x[k] * x + axis_y[k] * y - origin[k]

            # 1. The part of the edge within reach, from `first` to `last` in m along the edge.
            if above > 0.0:  # outside the line of the edge: a circle around the point cuts the line
                half_chord = sqrt(reach * reach - above * above)
                first = along - half_chord
                last = along + half_chord
            else:  # inside the line of the edge: the obstacle moves around the nearer corner
                beyond = -along if along < 0.0 else along - length
                if not beyond > 0.0:
                    continue
                rest = reach - sqrt(beyond * beyond + above * above)
                if not rest > 0.0:
                    continue
                first = 0.0 if along < 0.0 else length - rest
                last = rest if along < 0.0 else length
            first = first if first > 0.0 else 0.0
            last = last if last < length else length
            if first > last:
                continue

            # 2. The outward speed of the place of this part that the turn moves outwards fastest.
            # Along the edge, the outward speed by the turn falls by `angular` m/s for each m, so
            # this place is an end of the part.
            fastest_place = first if angular > 0.0 else last
            corner_lever = outline.corner_x[k] * ny - outline.corner_y[k] * nx
            turn_speed = angular * (corner_lever - fastest_place)
            linear_speed = linear * (axes.along_x * nx + axes.along_y * ny)
            if turn_speed > FAULT_SPEED and turn_speed + linear_speed > FAULT_SPEED:
                return True
        return False


def _safe_gap(needed_gap: float, others: float, seconds: float, travel: float) -> float:
    """The gap in m at which a point cannot matter in a stop of `seconds` s; nor at a greater gap.

    `needed_gap`: m that the point must keep at the begin of the stop. `others`: m/s, of the
    obstacle. `travel`: m that a place of the outline moves at most during the stop.
    """
    return needed_gap + others * seconds + travel + _ROUNDING

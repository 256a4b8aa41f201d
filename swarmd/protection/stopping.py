"""The stop check of mode `barrier`: the outline stays clear of obstacles while the robot brakes.

Part of the library of barrier.py. A constraint limits how fast a place of the outline closes on an
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

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import Array
from swarmd.protection.barrier_assumptions import Assumptions
from swarmd.protection.buffers import checked, doubles, maximum, sign, view
from swarmd.protection.closing_speed import DECISION_PERIOD
from swarmd.protection.constraints import Constraints, PlacedPoints, SpeedAxes
from swarmd.protection.outline import Outline
from swarmd.protection.projection import is_feasible

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import cos, fabs, sin, sqrt
else:
    from swarmd.core.cython_shadow import cos, fabs, sin, sqrt

NEGLIGIBLE_SPEED = cython.declare(cython.double, 0.015)
"""m/s: closing at a speed up to this is no approach."""
FAULT_SPEED = cython.declare(cython.double, 0.02)
"""m/s: a contact at a closing speed up to this is not a fault of the robot."""

_STEPS = cython.declare(cython.Py_ssize_t, 4)  # poses of a simulated stop
_BRAKES = cython.declare(cython.Py_ssize_t, 3)
_IDEAL_LINEAR = cython.declare(cython.Py_ssize_t, 1)
_IDEAL_ANGULAR = cython.declare(cython.Py_ssize_t, 2)
_IDEAL_BRAKING = cython.declare(cython.double, 1e9)  # m/s2 and rad/s2: an immediate stop
# m by which distances may be off by rounding, so that no point that matters is left out
_ROUNDING = cython.declare(cython.double, 1e-9)
_SPEED_ROUNDING = cython.declare(cython.double, 1e-12)  # m/s, of the fastest place


def _speed_shares() -> Array:
    grid = (1.0, 0.75, 0.5, 0.25, 0.0)
    shares = [(a, b) for a in grid for b in grid if (a, b) != (1.0, 1.0)]
    shares.sort(key=lambda share: (1.0 - share[0]) ** 2 + (1.0 - share[1]) ** 2)
    return np.array(shares)


_SPEED_SHARES = view(_speed_shares())
"""(24, 2) shares of the two speeds, those nearest to (1, 1) first; the last pair is zero."""


@cython.final
@cython.cclass
class Speeds:
    """The two speeds of a command: linear in m/s along its direction, angular in rad/s."""

    linear: cython.double
    angular: cython.double


@cython.final
@cython.cclass
class StopPoints:
    """The points that the outline could touch during a stop.

    Places, present gaps, and the gap in m that each must keep at the begin of the stop (`need`).
    """

    count: cython.Py_ssize_t
    x: cython.double[::1]
    y: cython.double[::1]
    gap: cython.double[::1]
    need: cython.double[::1]

    def __init__(self) -> None:
        self._allocate(96)

    def check_indices(self) -> None:
        """ValueError unless `count` is within each array."""
        room = min(map(len, (self.x, self.y, self.gap, self.need)))
        if not 0 <= self.count <= room:
            raise ValueError(f"{self.count} points beside a stop in {room}")

    def _allocate(self, room):
        """Make all arrays anew."""
        self.x, self.y = doubles(room), doubles(room)
        self.gap, self.need = doubles(room), doubles(room)

    @cython.cfunc
    @cython.exceptval(-1)
    def collect(
        self,
        constraints: Constraints,
        others: cython.double,
        seconds: cython.double,
        way: cython.double,
    ) -> cython.int:
        """Take the points that the outline may touch during a stop of `seconds`.

        During the stop no place of the outline moves more than `way` m, and obstacles move at
        `others` m/s. Contacts and points in a touch zone are left out.
        """
        i: cython.Py_ssize_t
        placed: PlacedPoints = constraints.placed
        is_granted: cython.bint = constraints.touch.is_granted
        points: cython.Py_ssize_t = placed.seen + placed.discs
        if len(self.x) < points:
            self._allocate(points + points // 2)
        free: cython.p_double = checked(placed.free, points)
        age: cython.p_double = checked(placed.age, points)
        gap: cython.p_double = checked(placed.gap, points)
        near_gap: cython.p_double = checked(self.gap, points)
        near_need: cython.p_double = checked(self.need, points)
        count: cython.Py_ssize_t = 0
        for i in range(placed.contacts, points):
            if is_granted and i < placed.seen and placed.in_touch_zone[i]:
                continue
            need: cython.double = free[i] + others * age[i]
            if gap[i] <= need + others * seconds + way:
                self.x[count], self.y[count] = placed.x[i], placed.y[i]
                near_gap[count], near_need[count] = gap[i], need
                count += 1
        self.count = count
        return 0


@cython.final
@cython.cclass
class StopCheck:
    """Reduces speeds from which the robot cannot stop with its outline clear of obstacles."""

    _assumptions: Assumptions
    _outline: Outline
    _constraints: Constraints
    _points: StopPoints
    _shares: cython.double[:, ::1]
    _forbidding: cython.Py_ssize_t  # the point that forbade the last speeds
    # The simulated stop: pose, way so far in m (negative) and speeds at each step. Only at the
    # first `_poses` steps is the outline fast enough to close on an obstacle.
    _poses: cython.Py_ssize_t
    _stop_x: cython.double[4]
    _stop_y: cython.double[4]
    _stop_cos: cython.double[4]
    _stop_sin: cython.double[4]
    _stop_way: cython.double[4]
    _stop_linear: cython.double[4]
    _stop_angular: cython.double[4]

    def __init__(
        self, assumptions: Assumptions, outline: Outline, constraints: Constraints
    ) -> None:
        self._assumptions, self._outline = assumptions, outline
        self._constraints, self._points = constraints, StopPoints()
        self._shares = _SPEED_SHARES

    def check_indices(self) -> None:
        """ValueError unless the poses are within the arrays, and the point is in use."""
        if not 0 <= self._poses <= _STEPS:
            raise ValueError(f"{self._poses} poses of a stop")
        if not 0 <= self._forbidding <= len(self._points.x):
            raise ValueError(f"the point {self._forbidding} of {len(self._points.x)}")

    @cython.cfunc
    @cython.exceptval(-1)
    def limit(self, speeds: Speeds) -> cython.int:
        """Reduce the speeds so that the outline stays clear while the robot brakes.

        1 if the speeds changed. The reduced speeds are the first pair of _SPEED_SHARES that
        satisfies all constraints and whose stop stays clear.
        """
        i: cython.Py_ssize_t
        assumptions: Assumptions = self._assumptions
        axes: SpeedAxes = self._constraints.axes
        linear: cython.double = speeds.linear
        angular: cython.double = speeds.angular
        slow: cython.double = fabs(linear) / assumptions.braking_linear
        turning: cython.double = fabs(angular) / assumptions.braking_angular
        seconds: cython.double = DECISION_PERIOD + (turning if turning > slow else slow)
        others: cython.double = assumptions.others if assumptions.is_passive else 0.0
        way: cython.double = (fabs(linear) + fabs(angular) * self._outline.radius) * seconds
        self._points.collect(self._constraints, others, seconds, way)
        if self._points.count == 0:
            return 0
        self._forbidding = 0
        if self._is_clear(linear, angular, others):
            return 0
        speeds.linear = speeds.angular = 0.0
        # A share of one speed alone may violate a constraint that both speeds together satisfy.
        for i in range(len(self._shares)):
            slower: cython.double = self._shares[i, 0] * linear
            turn: cython.double = self._shares[i, 1] * angular
            x: cython.double = slower / axes.limit
            if not is_feasible(self._constraints.rows, x, turn / axes.angular_limit):
                continue
            if self._is_clear(slower, turn, others):
                speeds.linear, speeds.angular = slower, turn
                break
        # The zero command is always clear; shares of a speed of 0 are 0.
        return not (speeds.linear == linear and speeds.angular == angular)

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_clear(
        self, linear: cython.double, angular: cython.double, others: cython.double
    ) -> cython.int:
        """1 if the outline stays clear in each of the three simulated stops from these speeds.

        The gap that a point must keep grows at `others` m/s. A point farther away than the outline
        moves needs no exact distance. The point that forbade the last speeds is examined first.
        """
        i: cython.Py_ssize_t
        brake: cython.Py_ssize_t
        speed: cython.double = fabs(linear)
        turning: cython.double = fabs(angular)
        count: cython.Py_ssize_t = self._points.count
        gap: cython.p_double = checked(self._points.gap, count)
        need: cython.p_double = checked(self._points.need, count)
        for brake in range(_BRAKES):  # both brakes as assumed, then each of them ideal
            if (brake == _IDEAL_LINEAR and speed == 0.0) or (
                brake == _IDEAL_ANGULAR and turning == 0.0
            ):
                continue  # the brake of a speed of 0 changes nothing
            slow: cython.double = speed / self._assumptions.braking_linear
            until: cython.double = turning / self._assumptions.braking_angular
            slow = 0.0 if brake == _IDEAL_LINEAR else slow
            until = 0.0 if brake == _IDEAL_ANGULAR else until
            last: cython.double = DECISION_PERIOD + (until if until > slow else slow)
            step: cython.double = last / _STEPS
            way: cython.double = self._simulate(brake, linear, angular, step)
            if self._poses == 0:  # the outline closes on nothing
                continue
            if self._forbids(self._forbidding, way, step, others):
                return 0
            for i in range(count):
                most: cython.double = need[i] + others * (step * _STEPS) + way + _ROUNDING
                if not (gap[i] >= most) and self._forbids(i, way, step, others):
                    self._forbidding = i
                    return 0
        return 1

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _simulate(
        self,
        brake: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        step: cython.double,
    ) -> cython.double:
        """Simulate a stop in four steps; the m that a place of the outline moves at most.

        Sets the poses, ways and speeds of the steps. `step` in s is the duration of one.
        """
        j: cython.Py_ssize_t
        axes: SpeedAxes = self._constraints.axes
        radius: cython.double = self._outline.radius
        speed: cython.double = fabs(linear)
        turning: cython.double = fabs(angular)
        slowing: cython.double = self._assumptions.braking_linear
        unturning: cython.double = self._assumptions.braking_angular
        slowing = _IDEAL_BRAKING if brake == _IDEAL_LINEAR else slowing
        unturning = _IDEAL_BRAKING if brake == _IDEAL_ANGULAR else unturning
        way: cython.double = 0.0
        x: cython.double = 0.0
        y: cython.double = 0.0
        yaw: cython.double = 0.0
        self._poses = 0
        for j in range(_STEPS):
            braked: cython.double = step * (j + 0.5) - DECISION_PERIOD
            move: cython.double = _braked(speed, slowing, braked) * step * sign(linear)
            turn: cython.double = _braked(turning, unturning, braked) * step * sign(angular)
            yaw += turn
            c: cython.double = cos(yaw - 0.5 * turn)
            s: cython.double = sin(yaw - 0.5 * turn)
            x += move * (c * axes.along_x - s * axes.along_y)
            y += move * (s * axes.along_x + c * axes.along_y)
            self._stop_x[j], self._stop_y[j] = x, y
            braked = step * j - DECISION_PERIOD
            self._stop_linear[j] = _braked(speed, slowing, braked) * sign(linear)
            self._stop_angular[j] = _braked(turning, unturning, braked) * sign(angular)
            self._stop_cos[j], self._stop_sin[j] = cos(yaw), sin(yaw)
            fastest: cython.double = (
                fabs(self._stop_linear[j]) + fabs(self._stop_angular[j]) * radius
            )
            if not (fastest + _SPEED_ROUNDING <= NEGLIGIBLE_SPEED):
                self._poses = j + 1  # the steps after this are too slow to matter
            way += fabs(move) + fabs(turn) * radius
            self._stop_way[j] = -way
        return way

    @cython.cfunc
    @cython.exceptval(-1)
    def _forbids(
        self,
        point: cython.Py_ssize_t,
        way: cython.double,
        step: cython.double,
        others: cython.double,
    ) -> cython.int:
        """1 if the outline closes on a point whose gap is too small, at a step of the stop."""
        j: cython.Py_ssize_t
        outline: Outline = self._outline
        points: StopPoints = self._points
        gap: cython.double = points.gap[point]
        need: cython.double = points.need[point]
        point_x: cython.double = points.x[point]
        point_y: cython.double = points.y[point]
        margin: cython.double = self._assumptions.margin
        least: cython.double = need + others * (step * _STEPS) + way + _ROUNDING
        if gap >= least:
            return 0
        before: cython.double = gap
        for j in range(self._poses):
            dx: cython.double = point_x - self._stop_x[j]
            dy: cython.double = point_y - self._stop_y[j]
            c: cython.double = self._stop_cos[j]
            s: cython.double = self._stop_sin[j]
            x: cython.double = c * dx + s * dy
            y: cython.double = c * dy - s * dx
            left: cython.double = outline.gap_of(x, y)
            is_free: cython.bint = left >= need + others * (step * (j + 1.0))
            if not is_free and not (before - left <= NEGLIGIBLE_SPEED * step):
                return 1
            within: cython.double = need - margin + others * (step * (j + 0.5))
            if left < within and self._turns_outwards(j, x, y, within):
                return 1
            if left - self._stop_way[j] >= least:
                return 0
            before = left
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _turns_outwards(
        self,
        pose: cython.Py_ssize_t,
        x: cython.double,
        y: cython.double,
        within: cython.double,
    ) -> cython.int:
        """1 if the turn moves a place of the outline within `within` m of a point outwards.

        Along an edge the outward speed is a linear function of the place. So only the ends of the
        part of an edge within `within` m of the point are examined. A turn moves no place faster
        than the outermost corner.
        """
        k: cython.Py_ssize_t
        outline: Outline = self._outline
        axes: SpeedAxes = self._constraints.axes
        edges: cython.Py_ssize_t = outline.edges
        linear: cython.double = self._stop_linear[pose]
        angular: cython.double = self._stop_angular[pose]
        if fabs(angular) * outline.radius + _ROUNDING <= FAULT_SPEED:
            return 0
        for k in range(edges):
            nx: cython.double = outline.axis_x[edges + k]
            ny: cython.double = outline.axis_y[edges + k]
            above: cython.double = nx * x + ny * y - outline.origin[edges + k]
            if not above < within:
                continue
            length: cython.double = outline.length[k]
            along: cython.double = outline.axis_x[k] * x + outline.axis_y[k] * y - outline.origin[k]
            first: cython.double
            last: cython.double
            if above > 0.0:
                half: cython.double = sqrt(within * within - above * above)
                first, last = along - half, along + half
            else:  # from behind the edge's line the way leads around the nearer corner
                past: cython.double = -along if along < 0.0 else along - length
                if not past > 0.0:
                    continue
                left: cython.double = within - sqrt(past * past + above * above)
                if not left > 0.0:
                    continue
                first = 0.0 if along < 0.0 else length - left
                last = left if along < 0.0 else length
            first = first if first > 0.0 else 0.0
            last = last if last < length else length
            if first > last:
                continue
            turned: cython.double = angular * (
                outline.corner_x[k] * ny
                - outline.corner_y[k] * nx
                - (first if angular > 0.0 else last)
            )
            moved: cython.double = linear * (axes.along_x * nx + axes.along_y * ny)
            if turned > FAULT_SPEED and turned + moved > FAULT_SPEED:
                return 1
        return 0


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _braked(speed: cython.double, braking: cython.double, seconds: cython.double) -> cython.double:
    """What is left of a speed after `seconds` of braking; before it brakes they are negative."""
    braked: cython.double = maximum(seconds, 0.0)
    shed: cython.double = braking * braked if braked > 0.0 else 0.0
    return maximum(speed - shed, 0.0)

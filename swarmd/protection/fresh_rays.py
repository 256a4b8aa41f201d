"""Fresh rays of mode `barrier`: those of the turn in progress, before the turn is whole.

The lidar sweeps over the obstacles while it turns. Each segment of the turn brings the rays of a
sector, which replace returns of the last whole scan by these rules:

1. Each return of a segment is added, at its place in the frame of the last scan and with its age.
2. A return of the last scan is dropped if the sweep has passed every place at which its obstacle
   may be. These places are a disc around the return. Its radius is the way at `others_speed` since
   the return was measured, and _DISC_SLACK. Each ray through the disc must have a return: the ray
   meets the obstacle, or shows that the obstacle is not before the return of the ray.
3. These obstacles stay as the last scan shows them, with their ages: contacts, hidden obstacles
   (nearer than the lidar can measure), returns of standing walls, and returns ahead of the sweep.
4. Rays without information keep the returns whose discs the rays meet. These are lost rays, and
   rays that hit a standing wall: the standing return constrains the robot less than a fresh return.
   A few lost rays between two returns hide no obstacle beside, so these rays keep only returns
   within _RAY_WIDTH.
5. A missing segment ends the sweep, and the next segment begins a new sweep. The disc must then not
   reach the first ray of the new sweep either.

So each obstacle is within `others_speed` times the age of a return, or behind a return. If the
return of the last scan stays, the obstacle is near this return. Otherwise the obstacle is near the
return of the ray that has met the obstacle since.

Part of the library of barrier.py. Units: m, s, rad, in the base frame of the last scan.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmd.core.values import Platform
from swarmd.protection.barrier_assumptions import Assumptions, is_standing
from swarmd.protection.buffers import doubles, indices
from swarmd.protection.dead_reckoning import DeadReckoning, PlanarPose, ScanMotion
from swarmd.protection.obstacles import NearObstacles, Points
from swarmd.protection.outline import Outline

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, cos, fabs, fmod, hypot, remainder, sin
else:
    from swarmd.core.cython_shadow import (
        INFINITY,
        cos,
        fabs,
        fmod,
        hypot,
        remainder,
        sin,
    )

# m beside the way of an obstacle: noise of a range, and the distance between two rays
_DISC_SLACK = cython.declare(cython.double, 0.02)
# m that an obstacle may move between two segments of one sweep: no body is so narrow that it passes
# from the one to the other unseen
_SEAM_WAY = cython.declare(cython.double, 0.01)
_RAY_WIDTH = cython.declare(cython.double, 0.01)  # m beside a lost ray
_WALL_WIDTH = cython.declare(cython.double, 0.1)  # m around a standing return
_LOST_RAYS = cython.declare(cython.Py_ssize_t, 6)  # side by side that a lidar loses: one packet
# rad of a sweep beyond which nothing is dropped: its ends must not meet
_MAX_ANGLE = cython.declare(cython.double, 2.0 * math.pi - 0.2)
_WHOLE_TURN = cython.declare(cython.double, 2.0 * math.pi)

# The fields of a ray without information in `_blind`.
_B_X = cython.declare(cython.Py_ssize_t, 0)  # m, the place of the lidar
_B_Y = cython.declare(cython.Py_ssize_t, 1)
_B_COS = cython.declare(cython.Py_ssize_t, 2)  # the direction of the ray
_B_SIN = cython.declare(cython.Py_ssize_t, 3)
_B_HIDES = cython.declare(cython.Py_ssize_t, 4)  # 1.0 if the ray may hide an obstacle beside it
_B_FIELDS = cython.declare(cython.Py_ssize_t, 5)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _ahead(angle: cython.double) -> cython.double:
    """The angle modulo a full turn, from 0."""
    rest: cython.double = fmod(angle, _WHOLE_TURN)
    return rest + _WHOLE_TURN if rest < 0.0 else rest


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _quadrants(x: cython.double, y: cython.double) -> cython.double:
    """From 0 to 4, rising with the angle of (x, y) from 0 to a full turn: without a slow atan2."""
    if y >= 0.0:
        return y / (x + y) if x > 0.0 else (1.0 - x / (y - x) if y - x > 0.0 else 0.0)
    return 2.0 + y / (x + y) if x < 0.0 else 3.0 + x / (x - y)


@cython.final
@cython.cclass
class RayLine:
    """A ray: the place of the lidar when it measured the ray, and the direction."""

    x: cython.double
    y: cython.double
    angle: cython.double
    cos: cython.double
    sin: cython.double

    @cython.cfunc
    @cython.exceptval(-1)
    def set(self, ray: RayLine) -> cython.int:
        """Take the values of another ray."""
        self.x, self.y = ray.x, ray.y
        self.angle = ray.angle
        self.cos, self.sin = ray.cos, ray.sin
        return 0


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _meets(
    x: cython.double,
    y: cython.double,
    ray_cos: cython.double,
    ray_sin: cython.double,
    reach: cython.double,
) -> cython.bint:
    """True if a ray comes within `reach` m of a place; also if a number is NaN.

    `x`, `y`: the place in m relative to the lidar. `ray_cos`, `ray_sin`: the direction of the ray.
    """
    if x * ray_cos + y * ray_sin > 0.0:
        return not fabs(y * ray_cos - x * ray_sin) > reach
    return not hypot(x, y) > reach


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _ahead_of(
    ray: RayLine, x: cython.double, y: cython.double, direction: cython.double
) -> cython.double:
    """The angle from a ray to a place, as `_quadrants` gives angles: from 0 to 4.

    `x`, `y`: the place in m relative to the lidar. `direction`: 1.0 if the angle is counted
    counter-clockwise, -1.0 clockwise.
    """
    return _quadrants(x * ray.cos + y * ray.sin, direction * (y * ray.cos - x * ray.sin))


@cython.final
@cython.cclass
class FreshRays:
    """The sweep of the turn in progress; puts its returns into the near obstacles."""

    _assumptions: Assumptions
    _outline: Outline
    _reckoning: DeadReckoning
    _motion: ScanMotion
    _near: NearObstacles
    _range_min: cython.double
    _range_max: cython.double
    _direction: cython.double  # of the sweep: 1.0 counter-clockwise
    # The sweep so far.
    _is_swept: cython.bint  # a segment has come since the last whole scan
    _has_seam: cython.bint  # rays before the first ray are missing, or much older
    _begun_at: cython.double  # s, the time of the first ray
    _newest_at: cython.double  # s, the time of the last ray
    _angle: cython.double  # rad from the first to the last ray
    _swept: cython.double  # the same angle as `_quadrants`
    _first: RayLine
    _last: RayLine
    _blind: cython.double[::1]  # _B_FIELDS of each ray without information
    _blind_count: cython.Py_ssize_t
    _run: cython.Py_ssize_t  # the last rays of the sweep, if these are without information
    _has_return: cython.bint  # a ray of the sweep has a return
    _ray: RayLine
    _pose: PlanarPose
    _begin: PlanarPose
    _end: PlanarPose
    _is_dropped: cython.longlong[::1]
    _returns: Points  # of the segment

    def __init__(
        self,
        platform: Platform,
        assumptions: Assumptions,
        outline: Outline,
        reckoning: DeadReckoning,
        motion: ScanMotion,
        near: NearObstacles,
    ) -> None:
        """Without a sweep of the platform all segments are ignored."""
        spec = platform.scan
        self._assumptions, self._outline = assumptions, outline
        self._reckoning, self._motion = reckoning, motion
        self._near = near
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._direction = 0.0 if spec.sweep is None else spec.sweep.direction
        self._first, self._last = RayLine(), RayLine()
        self._ray, self._pose = RayLine(), PlanarPose()
        self._begin, self._end = PlanarPose(), PlanarPose()
        self._blind, self._is_dropped = doubles(_B_FIELDS), indices(1)
        self._returns = Points(1)

    @cython.cfunc
    @cython.exceptval(-1)
    def forget(self) -> cython.int:
        """End the sweep: a whole scan has come."""
        self._is_swept = False
        return 0

    def take(
        self,
        ranges: cython.const[cython.double][::1],
        bearings: cython.const[cython.double][::1],
        ages: cython.const[cython.double][::1],
        newest_at: cython.double,
        gap: cython.double,
        age: cython.double,
        odometry_age: cython.double,
    ):
        """Take in a segment: its returns replace those that the sweep has passed (rules 1 and 2).

        A segment is ignored before the first scan, and after a reset of odometry since the scan.

        Args:
            ranges: (n,) m, of the driver. A ray whose range the lidar cannot measure is unknown.
            bearings: (n,) rad, in the order of the sweep.
            ages: (n,) s against the newest ray, falling to 0.
            newest_at: s, the time of the newest ray.
            gap: s from the ray before to the first ray, inf if rays are missing there.
            age: s of the newest ray, now.
            odometry_age: s of the newest odometry, now.
        """
        i: cython.Py_ssize_t
        motion: ScanMotion = self._motion
        near: NearObstacles = self._near
        count: cython.Py_ssize_t = len(ranges)
        if count == 0 or self._direction == 0.0 or motion.measured_at == -INFINITY:
            return
        if motion.resets != self._reckoning.resets:
            return
        if len(bearings) != count or len(ages) != count:
            raise IndexError(f"{count} ranges, {len(bearings)} bearings and {len(ages)} ages")

        # 1. The poses of the first and the last ray in the frame of the last scan.
        span: cython.double = ages[0]
        self._reckoning.find_pose(odometry_age, age, self._pose)
        self._end.set_relative(self._pose, motion.pose)
        self._reckoning.find_pose(odometry_age, age + span, self._pose)
        self._begin.set_relative(self._pose, motion.pose)

        # 2. Continues the sweep, or begins a sweep at the first ray (`_place` sets `_ray`). A sweep
        # has a seam if an obstacle may have passed before its first ray unseen (rule 5).
        follows_at_once: cython.bint = self._assumptions.others_speed * gap <= _SEAM_WAY
        self._place(bearings[0], 0.0)
        if not (self._is_swept and follows_at_once):
            self._has_seam = not follows_at_once
            self._begin_sweep(newest_at - span)
        self._place(bearings[count - 1], 1.0)
        self._extend_sweep(newest_at)

        # 3. Fills `_returns` with the returns of the segment, and `_blind` with its blind rays.
        self._take_rays(ranges, bearings, ages, span)

        # 4. Drops the returns that the sweep has passed, and adds those of the segment.
        points: Points = near.points
        if len(self._is_dropped) < points.count:
            self._is_dropped = indices(2 * points.count)
        may_drop: cython.bint = self._angle <= _MAX_ANGLE
        for i in range(near.contacts, points.count):
            self._is_dropped[i] = may_drop and self._has_passed(i)
        near.drop_returns(self._is_dropped, self._returns.count)
        for i in range(self._returns.count):
            near.add_return(
                self._returns.x[i],
                self._returns.y[i],
                self._returns.gap[i],
                motion.measured_at - newest_at + self._returns.age[i],
            )
        near.end_refresh()

    @cython.cfunc
    @cython.exceptval(-1)
    def _begin_sweep(self, begun_at: cython.double) -> cython.int:
        """Begin a sweep at `_ray`, its first ray, which was measured at `begun_at` s."""
        self._is_swept, self._angle = True, 0.0
        self._begun_at = begun_at
        self._blind_count = self._run = 0
        self._has_return = False
        self._first.set(self._ray)
        self._last.set(self._ray)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _extend_sweep(self, newest_at: cython.double) -> cython.int:
        """Extend the sweep to `_ray`, which was measured at `newest_at` s.

        If `_ray` has the angle of the last ray of the sweep so far, rounding may turn the angle
        between both rays into almost a full turn. Such an angle counts as 0.
        """
        turned: cython.double = _ahead(self._direction * (self._ray.angle - self._last.angle))
        if turned < _MAX_ANGLE:
            self._angle += turned
        self._last.set(self._ray)
        self._swept = _quadrants(cos(self._angle), sin(self._angle))
        self._newest_at = newest_at
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _place(self, bearing: cython.double, share: cython.double) -> cython.int:
        """Set `_ray` to a ray of the segment: where the lidar was, and the direction of the ray.

        The lidar measured the ray while the base moved from `_begin` to `_end`. `bearing` in rad:
        in the base frame when the ray was measured. `share`: the part of the time of the segment
        that had passed then, 0 at the first ray and 1 at the last ray.
        """
        begin: PlanarPose = self._begin
        end: PlanarPose = self._end
        ray: RayLine = self._ray
        yaw: cython.double = begin.yaw + share * remainder(end.yaw - begin.yaw, _WHOLE_TURN)
        cos_yaw: cython.double = cos(yaw)
        sin_yaw: cython.double = sin(yaw)
        lidar_x: cython.double = self._outline.lidar_x
        lidar_y: cython.double = self._outline.lidar_y
        ray.x = begin.x + share * (end.x - begin.x) + cos_yaw * lidar_x - sin_yaw * lidar_y
        ray.y = begin.y + share * (end.y - begin.y) + sin_yaw * lidar_x + cos_yaw * lidar_y
        ray.angle = bearing + yaw
        ray.cos, ray.sin = cos(ray.angle), sin(ray.angle)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _take_rays(
        self,
        ranges: cython.const[cython.double][::1],
        bearings: cython.const[cython.double][::1],
        ages: cython.const[cython.double][::1],
        span: cython.double,
    ) -> cython.int:
        """Fill `_returns` with the returns of a segment, and add its blind rays to `_blind`.

        A blind ray gives no information: the ray is lost, or hits a wall that stands (rule 4). A
        return has its gap at the pose of its ray, and its age against the newest ray. `ranges`,
        `bearings`, `ages`: (n,) m, rad, and s against the newest ray. `span`: s from the first to
        the last ray.
        """
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(ranges)
        outline: Outline = self._outline
        ray: RayLine = self._ray  # set by `_place`
        returns: Points = self._returns
        returns.reserve(count)
        returns.count = 0
        self._reserve_blind(self._blind_count + count)
        for i in range(count):
            self._place(bearings[i], 1.0 - ages[i] / span if span > 0.0 else 1.0)
            distance: cython.double = ranges[i]
            x: cython.double = ray.x + distance * ray.cos
            y: cython.double = ray.y + distance * ray.sin
            has_range: cython.bint = self._range_min <= distance <= self._range_max
            if has_range and distance > 0.0 and not self._is_on_wall(x, y):
                self._end_blind_run()
                base_x: cython.double = outline.lidar_x + distance * cos(bearings[i])
                base_y: cython.double = outline.lidar_y + distance * sin(bearings[i])
                returns.add(x, y, outline.gap_of(base_x, base_y), ages[i], 0.0)
            else:
                self._add_blind(ray)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_blind(self, room: cython.Py_ssize_t) -> cython.int:
        """Make room for `room` rays without information; those so far stay."""
        i: cython.Py_ssize_t
        if len(self._blind) < _B_FIELDS * room:
            blind = doubles(2 * _B_FIELDS * room)
            for i in range(_B_FIELDS * self._blind_count):
                blind[i] = self._blind[i]
            self._blind = blind
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_blind(self, ray: RayLine) -> cython.int:
        """Add a ray without information, which may hide an obstacle beside."""
        start: cython.Py_ssize_t = _B_FIELDS * self._blind_count
        self._blind[start + _B_X], self._blind[start + _B_Y] = ray.x, ray.y
        self._blind[start + _B_COS], self._blind[start + _B_SIN] = ray.cos, ray.sin
        self._blind[start + _B_HIDES] = 1.0
        self._blind_count += 1
        self._run += 1
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _end_blind_run(self) -> cython.int:
        """Note a return. A few lost rays between two returns hide no obstacle beside (rule 4)."""
        k: cython.Py_ssize_t
        if self._has_return and self._run <= _LOST_RAYS:
            for k in range(self._blind_count - self._run, self._blind_count):
                self._blind[_B_FIELDS * k + _B_HIDES] = 0.0
        self._run, self._has_return = 0, True
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_on_wall(self, x: cython.double, y: cython.double) -> cython.int:
        """1 if a place is near a return of a wall that stands."""
        i: cython.Py_ssize_t
        points: Points = self._near.points
        if not self._near.has_standing():
            return 0
        for i in range(self._near.contacts, points.count):
            if (
                is_standing(points.others[i], self._assumptions.others_speed)
                and hypot(points.x[i] - x, points.y[i] - y) <= _WALL_WIDTH
            ):
                return 1
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _has_passed(self, point: cython.Py_ssize_t) -> cython.int:
        """1 if the sweep has passed every place at which the obstacle of a return may be (rule 2).

        `point`: the index of the return among the near obstacles.
        """
        k: cython.Py_ssize_t
        points: Points = self._near.points
        outline: Outline = self._outline
        x: cython.double = points.x[point]
        y: cython.double = points.y[point]
        measured_at: cython.double = self._motion.measured_at - points.age[point]
        others_speed: cython.double = self._assumptions.others_speed

        # 1. Returns of this sweep stay. By rule 3 the returns of standing walls stay, and hidden
        # obstacles, which are nearer than the lidar can measure.
        is_of_sweep: cython.bint = not measured_at < self._begun_at
        is_wall: cython.bint = is_standing(points.others[point], others_speed)
        from_lidar: cython.double = hypot(x - outline.lidar_x, y - outline.lidar_y)
        is_measurable: cython.bint = from_lidar > self._range_min + _DISC_SLACK
        if is_of_sweep or is_wall or not is_measurable:
            return 0

        # 2. The return stays unless the sweep has passed its disc. The middle of the disc must lie
        # between the first and the last ray: within the angle of the sweep from each of them. The
        # disc must not reach the last ray. With a seam, it must not reach the first ray either.
        reach: cython.double = others_speed * (self._newest_at - measured_at) + _DISC_SLACK
        first: RayLine = self._first
        last: RayLine = self._last
        is_behind_first: cython.bint = (
            _ahead_of(first, x - first.x, y - first.y, self._direction) <= self._swept
        )
        is_before_last: cython.bint = (
            _ahead_of(last, x - last.x, y - last.y, -self._direction) <= self._swept
        )
        if not (is_behind_first and is_before_last):
            return 0
        if _meets(x - last.x, y - last.y, last.cos, last.sin, reach):
            return 0
        if self._has_seam and _meets(x - first.x, y - first.y, first.cos, first.sin, reach):
            return 0

        # 3. The return stays unless each ray through the disc has a return.
        for k in range(0, _B_FIELDS * self._blind_count, _B_FIELDS):
            may_hide: cython.bint = self._blind[k + _B_HIDES] != 0.0
            if _meets(
                x - self._blind[k + _B_X],
                y - self._blind[k + _B_Y],
                self._blind[k + _B_COS],
                self._blind[k + _B_SIN],
                reach if may_hide else _RAY_WIDTH,
            ):
                return 0
        return 1

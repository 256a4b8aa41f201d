"""Obstacles hidden in the blind zone of a sensor that reports nothing closer than range_min.

The blind zone is the circle of range_min around the sensor; its border is the rim. A ray with a
return proves that the part of the ray inside the zone is free. An empty ray (without a return) may
end at an obstacle inside the zone, or see nothing. An empty sector is a run of empty rays.
`HiddenObstacles` works by these rules:

1. An obstacle becomes hidden if it was near the rim, may have crossed it since, has no return near
   its place any more, and the rays there are empty. A hidden obstacle then approaches at the
   assumed speed. A return near its place does not count if so wide a surface vanished at once that
   no obstacle can have moved aside: the return is of a neighbour, or of a part still in view.
2. An obstacle too wide to vanish may cross the rim; returns at the end of an empty sector show
   this. If an obstacle crosses at one end, the part seen there last becomes hidden. If obstacles
   cross at both ends, they count as a single obstacle that fills the sector. The obstacle is no
   nearer than the corner of a box (a right angle) whose faces cross the rim at both ends.
3. A hidden obstacle moves with its empty sector, and fills a sector that is not too wide.
4. A hidden obstacle is forgotten once returns show its place free, once it reappears, or once the
   robot has moved away by its own commands. Motion without commands does not count, since an
   obstacle that pushes the robot moves with it. Without these exits it would hold the robot for
   ever. There is no expiry by time (except by rule 5, and in a sector too narrow for a robot),
   since a robot may be held in contact for minutes.
5. An obstacle has reappeared once more of it came into view beside the rim than noise can show. The
   hidden obstacles near that place are forgotten. Hidden obstacles farther away, which may have
   been the same obstacle, become doubtful, as do obstacles that only continue a face. In the open,
   empty rays cannot show that a doubtful obstacle has left, so such an obstacle expires by time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, angle_between, mod_turn
from swarmd.core.buffers import (
    checked,
    checked_indices,
    doubles,
    flags,
    indices,
    view,
    wrapped_index,
)
from swarmd.core.cython_shadow import (
    INFINITY,
    Doubles,
    Indices,
    atan2,
    cos,
    fabs,
    hypot,
    isfinite,
    isinf,
    sin,
)
from swarmd.core.ray_order import sort_rays
from swarmd.core.values import Array, Pose, Scan
from swarmd.robot.protection.footprint import ScanGeometry

# s for which an empty sector too narrow for a robot, and a doubtful obstacle, are remembered
_NARROW_TIME = 2.0
# s: the age of an obstacle that becomes doubtful; in the open, only ages above 0 grow
_DOUBTFUL = 1e-3
# of range_min: a robot that moved this far has left hidden obstacles behind
_FORGET_DISTANCE = 2.0
_RANGE_NOISE = 0.03  # m
# of range_min: closer than this, obstacles do not move sideways
_MIN_HIDDEN_RANGE = 0.6
# rad by which a hidden obstacle moves around the sensor between two scans, at most
_MAX_SHIFT = 0.25 * math.pi
# m by which the visible part of an obstacle may change beside its motion
_SHAPE_CHANGE = 0.05
# near returns that are compared at most: with so many, neighbours lie within 1 cm
_MAX_POINTS = 720
# empty rays side by side that are an empty sector; fewer are drop-outs
_MIN_EMPTY_RUN = 4
_MIN_WIDTH = 0.07  # m: no robot that a lidar sees is narrower
# m of an obstacle that come into view as it leaves the zone: noise at a rim shows 1 cm in and out
_MIN_EMERGED = 0.035
# a wider empty sector is open space
_MAX_SECTOR = math.radians(120.0)
# a near face hides less of the horizon than this
_MAX_FACE = math.pi
# rays beside an empty sector, at most, from which a face is extrapolated
_EDGE_RAYS = 8
# m by which a face approaches over these rays, more than noise does
_MIN_APPROACH = 0.02
_MAX_SLOPE = 0.06  # m per ray by which a face approaches at most
# half width: an obstacle in a narrower sector is level at its ends
_FLAT = math.radians(20.0)


def _nearest(rising: Doubles, n: int, wanted: float) -> int:
    """The index of the angle nearest to `wanted`, of n > 0 rising angles."""
    angle = mod_turn(wanted)
    low = 0
    high = n
    while low < high:
        middle = (low + high) // 2
        if rising[middle] < angle:
            low = middle + 1
        else:
            high = middle
    after = low if low < n else 0
    before = after - 1 if after else n - 1
    if angle_between(rising[before], wanted) < angle_between(rising[after], wanted):
        return before
    return after


def _has_near(ranges: Doubles, limit: float) -> bool:
    """True if a ray has a return with a range up to `limit` m."""
    for i in range(len(ranges)):  # noqa: SIM110  # Cython makes no loop of C of a generator
        if -INFINITY < ranges[i] <= limit:
            return True
    return False


def _find_match(
    xs: Doubles,
    ys: Doubles,
    point_count: int,
    x: float,
    y: float,
    within: float,
    stride: int,
    begin: int,
) -> int:
    """The first of the points `xs`, `ys` within `within` m of the place (x, y); -1 without one.

    Only every `stride`-th of the `point_count` points is compared. The result and `begin`, at which
    the search begins, are numbers among the compared points. Behind the last point, the search goes
    on at 0.
    """
    count = (point_count + stride - 1) // stride
    point_x = checked(xs, point_count)
    point_y = checked(ys, point_count)
    for j in range(count):
        k = begin + j
        if k >= count:
            k -= count
        difference_x = point_x[k * stride] - x
        difference_y = point_y[k * stride] - y
        if (
            fabs(difference_x) <= within
            and fabs(difference_y) <= within
            and hypot(difference_x, difference_y) <= within
        ):
            return k
    return -1


_NOTHING = np.empty(0)


def _grown(old: Doubles, n: int) -> Doubles:
    """A buffer of n numbers that begins with those of `old`."""
    new = doubles(n)
    for i in range(len(old)):
        new[i] = old[i]
    return new


def _finite_range(ranges: Doubles, ray: int) -> float:
    """The range in m of a ray; 1e9 without a finite range."""
    return ranges[ray] if isfinite(ranges[ray]) else 1e9


def _crosses_rim(
    ranges: Doubles, ray_count: int, radius: float, ray: int, direction: int, is_flat: bool
) -> bool:
    """True if an obstacle beside an empty sector crosses the rim into the sector.

    The rim is the circle of `radius` m around the sensor, which sees nothing nearer. A face through
    a narrow sector (`is_flat`) is nearly at right angles to the rays beside the sector. There the
    range hardly changes from ray to ray, so the range at the ray beside the sector must be near the
    rim. In a wide sector the ranges must fall towards the sector, so that the extrapolated face
    lies within the rim one ray further.

    `ray`: the index of the ray beside the sector. `direction`: 1 or -1, the step of the index away
    from the sector.
    """
    if is_flat:
        return ranges[ray] <= radius + _MAX_SLOPE  # the change of range over one ray, at most
    edge_range = _finite_range(ranges, ray)
    far_range = edge_range
    face_rays = 0
    i = ray
    # 1. Follows the face away from the sector, up to a step in the ranges.
    while face_rays < _EDGE_RAYS:
        i = (i + direction + ray_count) % ray_count
        next_range = _finite_range(ranges, i)
        if not fabs(next_range - far_range) < 2.0 * _MAX_SLOPE:  # a step, or no finite range
            break
        far_range = next_range
        face_rays += 1
    # 2. Extrapolates the face, which at least 3 rays must show, by one ray into the sector.
    approach = far_range - edge_range
    if face_rays < 3 or approach < _MIN_APPROACH:
        return False
    return edge_range - min(approach / face_rays, _MAX_SLOPE) <= radius + _RANGE_NOISE


def _turn_rays(bearings: Doubles, count: int, turned: float, rising: Doubles) -> None:
    """Write into `rising` the angles of the first `count` bearings, less `turned` rad, sorted.

    The bearings rise but for one place, so the sort begins behind this place.
    """
    first = 0
    for i in range(1, count):
        if mod_turn(bearings[i] - turned) < mod_turn(bearings[i - 1] - turned):
            first = i
    for i in range(count):
        k = first + i
        angle = mod_turn(bearings[k - count if k >= count else k] - turned)
        k = i
        while k > 0 and rising[k - 1] > angle:  # by rounding
            rising[k] = rising[k - 1]
            k -= 1
        rising[k] = angle


@cython.cclass
class HiddenObstacles:
    """The hidden obstacles of one sensor, in the base frame of the last scan.

    `bearings` (n,) in rad: a hidden obstacle may lie along each bearing. `nearest` (n,) in m from
    the sensor: the least distance of the obstacle along the bearing.
    """

    bearings: Array
    nearest: Array
    _radius: float  # m, of the rim
    _speed: float  # m/s, the highest speed at which obstacles approach
    _period: float  # s between two scans
    _narrowest_sector: float  # rad, in which a robot may be hidden
    _given_bearings: Array | None  # of the last scan; an array, recognised by its identity
    _ray_count: int
    _reserved: int  # rays for which the buffers have room
    # By ray, in the order of rising bearings. `_order`: the index of the ray in the scan.
    # `_age_by_ray` in s is inf where no obstacle is hidden, 0 for an obstacle that does not expire,
    # and above 0 for an obstacle that may expire: a doubtful obstacle, or a narrow obstacle.
    _order: Indices
    _bearing: Doubles
    _rising: Doubles
    _range: Doubles
    _is_empty: Indices
    _is_in_entered_sector: Indices
    _was_near: Indices  # in the scan before, a return was there that may have vanished
    _is_covered: Indices  # of an empty ray: in a sector that near returns covered
    _age_by_ray: Doubles
    _nearest_by_ray: Doubles
    _is_face_by_ray: Indices  # only a face in view continues there; or nothing is hidden
    _exact_bearing: Doubles
    # Empty sectors: the first ray, the number of rays, at how many ends (0 to 2) an obstacle
    # crosses the rim, and m to the square corner of rule 2.
    _sector_count: int
    _sector_first: Indices
    _sector_width: Indices
    _crossings: Indices
    _corner: Doubles
    # Near points of this scan, of the last one, and rays without return of the last one.
    _point_count: int
    _x: Doubles
    _y: Doubles
    _old_point_count: int
    _old_x: Doubles
    _old_y: Doubles
    _old_empty_count: int
    _old_empty: Doubles
    _turned_angle: Doubles
    # `_angle_total` rising angles, in which `_nearest` searches, and the rays to which they belong.
    _angle_total: int
    _angles: Doubles
    _angle_rays: Indices
    # The hidden obstacles, then the candidates: near returns of the scan before that may have
    # crossed the rim. Of each: bearing in rad, age in s, least range in m, and whether it only
    # continues a face that is in view (1.0).
    _hidden_count: int
    _candidate_count: int
    _bearings: Any
    _ranges: Any
    _hidden_bearing: Doubles
    _age: Doubles
    _nearest_range: Doubles
    _is_face: Doubles
    _is_hidden: Indices
    _entered_x: float  # m, the place at which the last obstacle became hidden
    _entered_y: float
    # m beside the rim that came into view since nothing was hidden, and that went out of view
    _emerged_m: float
    _vanished_m: float

    def __init__(self, range_min: float, speed: float, period: float) -> None:
        """Begin without hidden obstacles.

        `range_min` in m is the radius of the blind zone, `speed` in m/s the highest speed at which
        obstacles approach, `period` in s the time between two scans.
        """
        self._radius = range_min
        self._speed = speed
        self._period = period
        self._narrowest_sector = 2.0 * math.asin(min(0.5 * _MIN_WIDTH / range_min, 1.0))
        self._x = _NOTHING
        self._y = _NOTHING
        self._old_x = _NOTHING
        self._old_y = _NOTHING
        self._old_empty = _NOTHING
        self._hidden_bearing = _NOTHING
        self._age = _NOTHING
        self._nearest_range = _NOTHING
        self._is_face = _NOTHING
        self.bearings = _NOTHING
        self.nearest = _NOTHING
        self._order = indices(0)
        self._sector_first = self._sector_width = indices(0)
        self._crossings = self._sector_first
        self._angle_rays = self._sector_first
        self._bearing = _NOTHING
        self._rising = _NOTHING
        self._range = _NOTHING
        self._age_by_ray = _NOTHING
        self._nearest_by_ray = _NOTHING
        self._exact_bearing = _NOTHING
        self._corner = _NOTHING
        self._turned_angle = _NOTHING
        self._angles = _NOTHING
        self._is_empty = self._is_in_entered_sector = self._was_near = self._is_covered = flags(0)
        self._is_face_by_ray = self._is_empty
        self._is_hidden = self._is_empty

    def check_indices(self) -> None:
        """Nothing is refused: `checked` compares each length with the count of its loop.

        An index that an array states (`_order`, `_angle_rays`) is that of a view with bounds.
        """

    def update(
        self, scan: Scan, geometry: ScanGeometry, moved: Pose, driven: Pose, seconds: float
    ) -> None:
        """Take in a scan, measured `seconds` after the scan before.

        The call updates `bearings` and `nearest`. They stay empty while no obstacle is near, was
        near or is hidden.

        Args:
            scan: the new scan.
            geometry: the mounting of the sensor in the base frame.
            moved: the pose of the base at this scan in the base frame of the scan before.
            driven: the part of `moved` that the robot's own commands explain. Only this part counts
                as moving away from a hidden obstacle (rule 4).
            seconds: s between the two scans.
        """
        ranges: Doubles = view(scan.ranges)
        # 1. m that an obstacle moves between two scans, and the range up to which a return is near.
        # After a pause at most 5 periods count, else all returns would be near.
        counted_s = min(seconds, 5.0 * self._period)
        obstacle_step = self._speed * counted_s + _RANGE_NOISE
        near_range = self._radius + 2.0 * obstacle_step
        # 2. The near points become those of the scan before.
        self._x, self._old_x = self._old_x, self._x
        self._y, self._old_y = self._old_y, self._y
        self._old_point_count = self._point_count
        self._point_count = 0
        if not (self._old_point_count or self._hidden_count or _has_near(ranges, near_range)):
            return  # the usual case: no obstacle is near, was near or is hidden
        if scan.bearings is not self._given_bearings:
            self._set_bearings(scan.bearings)
        # 3. Ranges in the order of rising bearings, and the near points in the base frame. A range
        # of -inf (too close to measure) gives no point: such a ray counts as empty.
        ray_count = self._ray_count
        range_min = scan.range_min
        sensor_x = geometry.offset[0]
        sensor_y = geometry.offset[1]
        if len(ranges) < ray_count:
            raise IndexError(f"{len(ranges)} ranges, but {ray_count} bearings")
        order = checked_indices(self._order, ray_count)
        sorted_range = checked(self._range, ray_count)
        sorted_bearing = checked(self._bearing, ray_count)
        near_x = checked(self._x, ray_count)
        near_y = checked(self._y, ray_count)
        point_count = 0
        for i in range(ray_count):
            ray = order[i]
            distance = ranges[ray]
            sorted_range[i] = distance
            if -INFINITY < distance <= near_range:
                distance = max(distance, range_min)
                near_x[point_count] = sensor_x + distance * cos(sorted_bearing[i])
                near_y[point_count] = sensor_y + distance * sin(sorted_bearing[i])
                point_count += 1
        self._point_count = point_count
        # 4. Updates the place that the robot leaves: by the driven part of the motion alone (rule
        # 4), and by the whole turn, since the base frame turns with the robot.
        self._leave(driven.x, driven.y, moved.yaw)
        # 5. Updates the hidden obstacles.
        self._update_hidden(moved.x, moved.y, moved.yaw, sensor_x, sensor_y, seconds, obstacle_step)
        # 6. Stores the empty rays for the next scan.
        old_empty = checked(self._old_empty, ray_count)
        empty_count = 0
        for i in range(ray_count):
            if isinf(sorted_range[i]):
                old_empty[empty_count] = sorted_bearing[i]
                empty_count += 1
        self._old_empty_count = empty_count

    def _set_bearings(self, bearings: Array) -> None:
        """Take new bearings of the rays, and sort the rays by them."""
        values: Doubles = view(bearings)
        n = len(values)
        if n > self._reserved:
            self._reserve(n + n // 4)
        self._given_bearings = bearings
        self._ray_count = n
        for i in range(n):
            self._turned_angle[i] = mod_turn(values[i])
        sort_rays(self._turned_angle, n, self._rising, self._order)
        for i in range(n):
            self._bearing[i] = values[self._order[i]]

    def _reserve(self, size: int) -> None:
        """Make room for `size` rays; the hidden obstacles and the near points stay."""
        self._reserved = size
        self._order = indices(size)
        self._bearing = doubles(size)
        self._rising = doubles(size)
        self._range = doubles(size)
        self._exact_bearing = doubles(size)
        self._corner = doubles(size)
        self._age_by_ray = doubles(size)
        self._nearest_by_ray = doubles(size)
        self._is_empty = flags(size)
        self._is_in_entered_sector = flags(size)
        self._was_near = flags(size)
        self._is_covered = flags(size)
        self._is_face_by_ray = flags(size)
        self._sector_first = indices(size)
        self._sector_width = indices(size)
        self._crossings = indices(size)
        self._angle_rays = indices(size)
        self._x = _grown(self._x, size)
        self._y = _grown(self._y, size)
        self._old_x = _grown(self._old_x, size)
        self._old_y = _grown(self._old_y, size)
        self._old_empty = _grown(self._old_empty, size)
        self._angles = doubles(size)
        self._turned_angle = doubles(size)
        # Candidates: at most a hidden obstacle for each ray, and one for each earlier near point.
        self._bearings = self._hidden_bearing = _grown(self._hidden_bearing, 2 * size)
        self._ranges = self._nearest_range = _grown(self._nearest_range, 2 * size)
        self._age = _grown(self._age, 2 * size)
        self._is_face = _grown(self._is_face, 2 * size)
        self._is_hidden = flags(2 * size)

    def _leave(self, driven_x: float, driven_y: float, turned: float) -> None:
        """Update the place at which the last obstacle became hidden, in the base frame."""
        cos_turn = cos(turned)
        sin_turn = sin(turned)
        x = self._entered_x - driven_x
        y = self._entered_y - driven_y
        self._entered_x = cos_turn * x + sin_turn * y
        self._entered_y = cos_turn * y - sin_turn * x

    def _update_hidden(
        self,
        moved_x: float,
        moved_y: float,
        turned: float,
        sensor_x: float,
        sensor_y: float,
        seconds: float,
        obstacle_step: float,
    ) -> None:
        """Update the hidden obstacles by this scan, and publish them.

        `moved_x`, `moved_y`, `turned`: m and rad, the motion of the base in the `seconds` since the
        scan before. `sensor_x`, `sensor_y`: m, the place of the sensor in the base frame.
        `obstacle_step`: m that an obstacle moves between two scans.
        """
        ray_count = self._ray_count
        cos_turn = cos(turned)
        sin_turn = sin(turned)
        self._find_sectors()
        if not self._sector_count:  # an obstacle can hide in an empty sector only
            self._publish(0)
            return
        # 1. Marks the rays of each sector at whose end an obstacle crosses the rim.
        is_entered = False
        for i in range(ray_count):
            self._is_in_entered_sector[i] = False
        for k in range(self._sector_count):
            if self._crossings[k]:
                is_entered = True
                for i in range(
                    self._sector_first[k], self._sector_first[k] + self._sector_width[k]
                ):
                    self._is_in_entered_sector[wrapped_index(i, ray_count)] = True
        # 2. The hidden obstacles approach, and vanished returns become candidates.
        self._approach(turned, seconds)
        self._candidate_count = self._hidden_count
        self._add_vanished(
            moved_x, moved_y, cos_turn, sin_turn, sensor_x, sensor_y, obstacle_step, is_entered
        )
        if not (self._candidate_count or is_entered):
            self._publish(0)
            return
        # An obstacle became hidden: the robot leaves hidden obstacles from this place on (rule 4).
        if self._candidate_count > self._hidden_count or is_entered:
            self._entered_x = 0.0
            self._entered_y = 0.0
        # 3. Gives each candidate a ray, and extends obstacles over their sectors.
        self._place(turned, obstacle_step)
        self._fill(seconds)
        # 4. Stores the obstacle of each ray as a hidden obstacle, for the next scan.
        k = 0
        for i in range(ray_count):
            if self._age_by_ray[i] < INFINITY:
                self._hidden_bearing[k] = self._exact_bearing[i]
                self._age[k] = self._age_by_ray[i]
                self._nearest_range[k] = self._nearest_by_ray[i]
                self._is_face[k] = self._is_face_by_ray[i]
                k += 1
        self._publish(k)

    def _approach(self, turned: float, seconds: float) -> None:
        """Turn the hidden obstacles by `-turned` rad, and let them approach for `seconds` s."""
        for i in range(self._hidden_count):
            self._hidden_bearing[i] -= turned
            self._nearest_range[i] = max(self._nearest_range[i] - self._speed * seconds, 0.0)
            # `_fill` moves a face away from the sensor, to the corner. An obstacle that may have
            # reached the sensor must not move away, so the obstacle is no face any more.
            if self._nearest_range[i] == 0.0:
                self._is_face[i] = 0.0

    def _publish(self, count: int) -> None:
        """Set `bearings` and `nearest` to those of the first `count` hidden obstacles.

        All others are forgotten.
        """
        self._hidden_count = count
        if not count:
            self._emerged_m = 0.0
            self._vanished_m = 0.0
        self.bearings = np.array(self._bearings[:count]) if count else _NOTHING
        self.nearest = np.array(self._ranges[:count]) if count else _NOTHING

    def _find_sectors(self) -> None:
        """Find the empty sectors: runs of at least `_MIN_EMPTY_RUN` empty rays.

        An empty ray has no return. Runs continue from the last ray to the first ray.
        """
        ray_count = self._ray_count
        ranges = checked(self._range, ray_count)
        first = 0
        self._sector_count = 0
        for i in range(ray_count):
            self._is_empty[i] = False
        while first < ray_count and isinf(ranges[first]):
            first += 1
        if first == ray_count:  # no ray has a return
            if ray_count >= _MIN_EMPTY_RUN:
                self._add_sector(0, ray_count)
            return
        # Begin at a ray with a return, so that no run spans the end of the arrays.
        last = first + ray_count
        i = first
        while i < last:
            end = i
            while end < last and isinf(ranges[wrapped_index(end, ray_count)]):
                end += 1
            if end - i >= _MIN_EMPTY_RUN:
                self._add_sector(wrapped_index(i, ray_count), end - i)
            i = end + 1

    def _add_sector(self, first: int, width: int) -> None:
        """Add an empty sector of `width` rays; `first` is the index of its first ray.

        Stores at how many ends an obstacle crosses the rim, and the distance in m of the nearest
        right angle whose two sides meet the rim at the ends of the sector (rule 2).
        """
        ray_count = self._ray_count
        k = self._sector_count
        for i in range(first, first + width):
            self._is_empty[wrapped_index(i, ray_count)] = True
        half_angle = width * PI / ray_count
        is_flat = half_angle < _FLAT
        self._sector_first[k] = first
        self._sector_width[k] = width
        self._crossings[k] = 0
        if _crosses_rim(
            self._range, ray_count, self._radius, (first + ray_count - 1) % ray_count, -1, is_flat
        ):
            self._crossings[k] += 1
        if _crosses_rim(
            self._range, ray_count, self._radius, (first + width) % ray_count, 1, is_flat
        ):
            self._crossings[k] += 1
        # The corner lies on the middle line of the sector, its two sides at 45 degrees to this
        # line; in a sector wider than 90 degrees the corner may reach the sensor: 0.
        self._corner[k] = max(self._radius * (cos(half_angle) - sin(half_angle)), 0.0)
        self._sector_count += 1

    def _add_vanished(
        self,
        moved_x: float,
        moved_y: float,
        cos_turn: float,
        sin_turn: float,
        sensor_x: float,
        sensor_y: float,
        obstacle_step: float,
        is_entered: bool,
    ) -> None:
        """Add as candidates the near returns of the scan before that may have crossed the rim.

        A near return of the scan before (an old return) is a candidate if this scan has no return
        near that place, or if an obstacle enters the empty sector there. Also updates `_vanished_m`
        and `_emerged_m`.

        `moved_x`, `moved_y`: m, the motion of the base since the scan before. `cos_turn`,
        `sin_turn`: of its turn since then. `sensor_x`, `sensor_y`: m, the place of the sensor in
        the base frame. `obstacle_step`: m that an obstacle moves between two scans. `is_entered`:
        an obstacle enters an empty sector across the rim.
        """
        stride = 1 + self._point_count // _MAX_POINTS
        match_distance = obstacle_step + _SHAPE_CHANGE
        last_match = 0
        # 1. The old returns in the present base frame, with their bearings and rays. The ray is -1
        # for a return too far from the rim.
        for i in range(self._ray_count):
            self._was_near[i] = False
        for i in range(self._old_point_count):
            old_x = self._old_x[i] - moved_x
            old_y = self._old_y[i] - moved_y
            x = cos_turn * old_x + sin_turn * old_y
            y = cos_turn * old_y - sin_turn * old_x
            self._old_x[i] = x
            self._old_y[i] = y
            self._angle_rays[i] = -1
            if hypot(x - sensor_x, y - sensor_y) < self._radius + obstacle_step:
                self._angles[i] = atan2(y - sensor_y, x - sensor_x)
                ray = _nearest(self._rising, self._ray_count, self._angles[i])
                self._angle_rays[i] = ray
                self._was_near[ray] = True
        self._find_covered(obstacle_step)
        for i in range(self._old_point_count):
            ray = self._angle_rays[i]
            if ray < 0:
                continue
            x = self._old_x[i]
            y = self._old_y[i]
            bearing = self._angles[i]
            # 2. Finds a near return of this scan near this place. The search begins at the match of
            # the old return before, since neighbours lie side by side.
            match = _find_match(
                self._x, self._y, self._point_count, x, y, match_distance, stride, last_match
            )
            is_gone = match < 0 or (self._is_empty[ray] != 0 and self._is_covered[ray] != 0)
            if match >= 0:
                last_match = match
            # 3. An empty ray there: this width of the obstacle went out of view. The width is
            # subtracted from the width that came into view: noise at the rim shows the same width
            # out of view and in view again.
            if isinf(self._range[ray]):
                return_width = hypot(x - sensor_x, y - sensor_y) * TURN / self._ray_count
                self._emerged_m -= return_width
                self._vanished_m += return_width
            # 4. Adds the candidate. The obstacle can be `obstacle_step` within the rim by now. If
            # the return is still in view, the candidate only continues a face, and is doubtful.
            if is_gone or (is_entered and self._is_in_entered_sector[ray]):
                k = self._candidate_count
                self._hidden_bearing[k] = bearing
                self._nearest_range[k] = self._radius - obstacle_step
                self._age[k] = 0.0 if is_gone else _DOUBTFUL
                self._is_face[k] = not is_gone
                self._candidate_count += 1

    def _find_covered(self, obstacle_step: float) -> None:
        """Find the empty sectors that near returns covered in the scan before (`_is_covered`).

        More than half of the rays of a covered sector had a near return (`_was_near`), and the
        sector is wider at the rim than an obstacle moves aside between two scans: half of
        `obstacle_step`, the m that obstacle and robot approach each other. No obstacle crosses the
        rim at its ends (rule 2).
        """
        for k in range(self._sector_count):
            near_count = 0
            width = self._sector_width[k]
            rim_width = width * TURN / self._ray_count * self._radius  # m
            for i in range(self._sector_first[k], self._sector_first[k] + width):
                near_count += self._was_near[wrapped_index(i, self._ray_count)]
            is_covered = 2 * near_count > width and rim_width > 0.5 * obstacle_step
            for i in range(self._sector_first[k], self._sector_first[k] + width):
                self._is_covered[wrapped_index(i, self._ray_count)] = (
                    is_covered and not self._crossings[k]
                )

    def _place(self, turned: float, obstacle_step: float) -> None:
        """Give each candidate that is still hidden its ray, by rules 3 to 5 of the module.

        Sets for each ray the age, the least range and `is_face` of its obstacle (see the fields).

        `turned`: rad by which the base turned since the scan before. `obstacle_step`: m that an
        obstacle moves between two scans.
        """
        ray_count = self._ray_count
        # rad by which an obstacle may have moved around the sensor between two scans
        farthest_shift = obstacle_step / (_MIN_HIDDEN_RANGE * self._radius)
        sideways_shift = min(farthest_shift, _MAX_SHIFT)
        # 1. Drops candidates that the robot has left behind, or that have expired (rule 4).
        is_robot_near = hypot(self._entered_x, self._entered_y) < _FORGET_DISTANCE * self._radius
        for k in range(self._candidate_count):
            self._is_hidden[k] = is_robot_near and self._age[k] < _NARROW_TIME
        # 2. Drops candidates that have reappeared (rule 5).
        self._find_reappeared(turned, obstacle_step)
        self._drop_reappeared(sideways_shift, farthest_shift)
        # 3. Clears the rays. `_angles` become those of the empty rays.
        self._clear_rays()
        # 4. Moves each hidden candidate to the nearest empty ray (rule 3).
        for k in range(self._candidate_count):
            if not self._is_hidden[k]:
                continue
            i = _nearest(self._angles, self._angle_total, self._hidden_bearing[k])
            angle_off = angle_between(self._angles[i], self._hidden_bearing[k])
            if angle_off > sideways_shift:
                continue
            ray = self._angle_rays[i]
            self._age_by_ray[ray] = min(self._age_by_ray[ray], self._age[k])
            self._nearest_by_ray[ray] = min(self._nearest_by_ray[ray], self._nearest_range[k])
            self._is_face_by_ray[ray] = self._is_face_by_ray[ray] and self._is_face[k] != 0.0
            # The bearing is not rounded to that of the ray, which would lose a slow turn.
            if angle_off <= PI / ray_count:
                self._exact_bearing[ray] = self._hidden_bearing[k]

    def _drop_reappeared(self, sideways_shift: float, farthest_shift: float) -> None:
        """Drop the candidates that have reappeared (rule 5).

        `_angles` are those of the returns that came into view. A candidate within `sideways_shift`
        rad of such a return has reappeared. A candidate within `farthest_shift` rad may have
        reappeared, and becomes doubtful.
        """
        self._emerged_m = max(self._emerged_m, 0.0)
        has_emerged = self._emerged_m >= min(_MIN_EMERGED, 0.5 * self._vanished_m)
        if not (has_emerged and self._angle_total):
            return
        # The candidates behind these vanished in this scan, so they have not reappeared.
        for k in range(self._hidden_count):
            i = _nearest(self._angles, self._angle_total, self._hidden_bearing[k])
            angle_off = angle_between(self._angles[i], self._hidden_bearing[k])
            if angle_off <= sideways_shift:
                self._is_hidden[k] = False
            elif angle_off <= farthest_shift:
                self._age[k] = max(self._age[k], _DOUBTFUL)

    def _clear_rays(self) -> None:
        """Set each ray to no obstacle, and `_angles` to the angles of the empty rays."""
        ray_count = self._ray_count
        bearing = checked(self._bearing, ray_count)
        exact_bearing = checked(self._exact_bearing, ray_count)
        age = checked(self._age_by_ray, ray_count)
        nearest = checked(self._nearest_by_ray, ray_count)
        self._angle_total = 0
        for i in range(ray_count):
            exact_bearing[i] = bearing[i]
            age[i] = INFINITY
            nearest[i] = INFINITY
            self._is_face_by_ray[i] = True
            if self._is_empty[i]:
                self._angles[self._angle_total] = self._rising[i]
                self._angle_rays[self._angle_total] = i
                self._angle_total += 1

    def _find_reappeared(self, turned: float, obstacle_step: float) -> None:
        """Find the returns near the rim whose rays were empty in the scan before.

        Sets `_angles` to their angles, `_angle_total` to their number, and adds to `_emerged_m`.
        """
        ray_count = self._ray_count
        old_empty_count = self._old_empty_count
        is_turned = False
        self._angle_total = 0
        if not old_empty_count:
            return
        ranges = checked(self._range, ray_count)
        for i in range(ray_count):
            if -INFINITY < ranges[i] <= self._radius + obstacle_step:
                if not is_turned:
                    _turn_rays(self._old_empty, old_empty_count, turned, self._turned_angle)
                    is_turned = True
                k = _nearest(self._turned_angle, old_empty_count, self._bearing[i])
                if angle_between(self._turned_angle[k], self._bearing[i]) <= PI / ray_count:
                    self._angles[self._angle_total] = self._rising[i]
                    self._angle_total += 1
                    self._emerged_m += self._range[i] * TURN / ray_count

    def _fill(self, seconds: float) -> None:
        """Extend hidden obstacles over their empty sectors, and let some obstacles grow older.

        In a sector too narrow for a robot, and in the open, obstacles grow older until they expire.

        `seconds`: s since the scan before.
        """
        ray_count = self._ray_count
        for k in range(self._sector_count):
            first = self._sector_first[k]
            after_last = self._sector_first[k] + self._sector_width[k]
            least_age = INFINITY  # inf without a hidden obstacle in the sector
            for i in range(first, after_last):
                least_age = min(least_age, self._age_by_ray[wrapped_index(i, ray_count)])
            is_obstacle_hidden = least_age < INFINITY
            width_rad = self._sector_width[k] * 2.0 * PI / ray_count
            if self._crossings[k] == 2 and width_rad < _MAX_FACE:
                self._fill_with_box(k)
            elif is_obstacle_hidden and width_rad <= _MAX_SECTOR:
                is_crossed = self._crossings[k] > 0
                if width_rad >= self._narrowest_sector:
                    least_age = 0.0  # a robot may be hidden: the obstacle does not expire
                elif is_crossed:
                    # A part of the obstacle is in view beside the sector. So the obstacle does not
                    # expire: its age rises no further than that of a doubtful obstacle.
                    least_age = min(least_age, _DOUBTFUL)
                else:
                    least_age += seconds  # too narrow for a robot: the obstacle expires
                self._fill_evenly(k, least_age)
            elif self._crossings[k] == 0:
                # Open space, into which no obstacle reaches: doubtful obstacles will expire.
                for i in range(first, after_last):
                    is_doubtful = 0.0 < self._age_by_ray[wrapped_index(i, ray_count)] < INFINITY
                    if is_doubtful:
                        self._age_by_ray[wrapped_index(i, ray_count)] += seconds

    def _fill_with_box(self, k: int) -> None:
        """Fill sector `k` with an obstacle that crosses the rim at both ends (rule 2).

        Each ray gets an obstacle: a ray without an obstacle gets a doubtful obstacle at the
        distance of the corner. An obstacle that only continues a face moves to the corner, too.
        """
        for i in range(self._sector_first[k], self._sector_first[k] + self._sector_width[k]):
            ray = wrapped_index(i, self._ray_count)
            self._age_by_ray[ray] = min(self._age_by_ray[ray], _DOUBTFUL)  # inf without an obstacle
            if self._is_face_by_ray[ray]:  # True without an obstacle, too
                self._nearest_by_ray[ray] = self._corner[k]

    def _fill_evenly(self, k: int, age: float) -> None:
        """Fill sector `k` with an obstacle of `age` s at the least distance in the sector."""
        first = self._sector_first[k]
        after_last = first + self._sector_width[k]
        nearest = INFINITY
        for i in range(first, after_last):
            nearest = min(nearest, self._nearest_by_ray[wrapped_index(i, self._ray_count)])
        for i in range(first, after_last):
            self._age_by_ray[wrapped_index(i, self._ray_count)] = age
            self._nearest_by_ray[wrapped_index(i, self._ray_count)] = nearest

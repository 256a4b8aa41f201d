"""Tracks: near objects with their velocities, from the scans and the odometry of one robot. Pure.

- A scan is cut into clusters. A compact cluster is an object that may move. A long cluster is a
  wall. A cluster that fits no track, and that nearer clusters hide on both sides, is a part of a
  wall, too: between two nearer objects that move, the visible part of a wall seems to move.
- Each object has a Kalman filter (1960) with constant velocity in the frame of the odometry. A
  cluster belongs to the nearest predicted object within a gate (after Bar-Shalom and Fortmann,
  "Tracking and data association", 1988). The time of a cluster is the time of its own rays, which a
  rotating sensor measures one after the other.
- A place that a peer shares is an object, too, since a lidar may look over the peer. The standard
  deviation of a shared place is three times that of a cluster.

Avoidance and right of way use the tracks. The protection modes do not, so tracks make no gap
smaller.

A kernel (see `core/kernels.py`), since each scan and each decision pass it.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import doubles, indices, view, view_of, wrapped_index
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Doubles,
    Indices,
    Table,
    atan2,
    cos,
    fabs,
    floor,
    hypot,
    isnan,
    sin,
    sqrt,
)
from swarmd.core.odometry_trail import ANEW, OdometryTrail
from swarmd.core.ray_order import sort_rays
from swarmd.core.values import Array, Odometry, Platform, Scan
from swarmd.robot.protection.decision import DecisionContext

REACH = 2.5
"""m from the lidar beyond which no object is tracked."""
# m between neighbouring returns of one surface that faces the lidar
_MAX_STEP = 0.06
# m and rad of odometry, below which places by odometry keep a distance to within a millionth of it
_MAX_EXACT = 1e5
_EXACT = 1e-6
_MAX_LOST_STEPS = 4.5  # angular steps between two returns of one surface at most: rays may be lost
# m, visible part of a new object: a thinner cluster counts as standing
_MIN_WIDTH = 0.03
# m from the outline of an object within which a cluster is a part of the object
_PART_SLACK = 0.05
# Sine of the least angle between a ray and a surface.
_GRAZING = math.sin(math.radians(15.0))
_MAX_COMPACT_SIZE = 3.0  # times the own circumscribed circle: a wider cluster is a wall
# Share of the radius by which the middle lies behind the mean return of an object.
_DEPTH_SHARE = 0.8
_MIN_RADIUS = 0.02  # m
_MAX_RADIUS = 0.6  # m
# Standard deviation of the measured middle: m, plus m for each m of range
_POSITION_NOISE = 0.016
_RANGE_NOISE = 0.006
# Factor of this deviation for an object that a nearer object hides in part.
_HIDDEN_NOISE = 3.0
# m2/s3, density of the change of velocity
_ACCELERATION = 0.03
_FIRST_SPEED = 0.15  # m/s, standard deviation of the velocity of a new track
# Shares by which the radius follows a wider, and a narrower, cluster: parts may be hidden.
_GROWTH = 0.3
_SHRINKAGE = 0.03
_GATE = 2.5  # standard deviations
_GATE_SLACK = 0.03  # m
_MIN_HITS = 2  # scans that must show an object before it is a track
# Scans in a row that show the place of a track empty, which end the track.
_MAX_MISSES = 2
# s for which a hidden object is remembered
_HIDDEN_TIME = 1.5
_SECTORS = 36  # directions in each of which the nearest place of a wall is kept
_MAX_EXTRAPOLATED = 1.0  # s for which a track moves on without a scan

_SECTOR = _SECTORS / (2.0 * math.pi)  # sectors in a rad


def speed_of(linear: float, lateral: float) -> float:
    """The speed in m/s of a twist by `math.hypot`, which rounds differently from C's hypot.

    Most bases do not move sideways, and need no call of Python.
    """
    return fabs(linear) if lateral == 0.0 else math.hypot(linear, lateral)


@cython.cclass
class Track:
    """A moving object as seen now: base frame, m and m/s.

    An extension type, whose numbers are of C: a crowd makes hundreds of tracks a second.
    """

    id: int
    x: float
    y: float
    vx: float
    vy: float
    radius: float

    def __init__(self, *numbers: Any) -> None:
        """Set all numbers, in the order of the attributes."""
        self.id, self.x, self.y, self.vx, self.vy, self.radius = numbers


_no_doubles = doubles(0)


@cython.cclass
class ScanReturns:
    """The returns of the last scan by bearing, which tracks and openings share.

    They are the first `count` of each array.
    """

    count: int
    ranges: Doubles  # m
    bearings: Doubles  # rad, rising
    ages: Doubles  # s; 0 for a scan without ages
    _scan: Scan | None  # the last scan; None before the first
    _order: Indices  # the rays with a return, as they come
    _unsorted: Doubles  # their bearings, as they come; of a scan that was sorted
    _sorted: Indices  # these rays by rising bearing; of a scan that was sorted

    def __init__(self) -> None:
        self._make_room(0)  # a view that is not set ends the process when memory is taken

    def _make_room(self, count: int) -> None:
        self.ranges = doubles(count)
        self.bearings = doubles(count)
        self.ages = doubles(count)
        self._order = indices(count)
        self._unsorted = doubles(count)
        self._sorted = indices(count)

    def take(self, scan: Scan) -> None:
        """Set the returns to those of a conditioned scan, unless it is the last scan.

        The bearings of a conditioned scan rise from ray to ray. In the scan of a turning robot they
        may fall once, from half a turn to minus half a turn. So most scans need no sorting: the
        returns from this fall on come first, then the returns before the fall. Returns of the same
        bearing keep their order.
        """
        if scan is self._scan:
            return
        ranges: Doubles = view(scan.ranges)
        bearings: Doubles = view(scan.bearings)
        has_ages = scan.ages is not None
        # Without ages all ages are 0, and `ages` is not read: any array may take its place.
        ages: Doubles = ranges if scan.ages is None else view(scan.ages)
        count = 0
        falls = 0  # how often the bearing falls from a return to the next
        lowest = 0  # the return behind the last fall; 0 without a fall

        # 1. Rays with a return, and where their bearings fall.
        if len(self._order) < len(ranges):
            self._make_room(len(ranges))
        order = self._order
        for i in range(len(ranges)):
            if ranges[i] > 0.0 and ranges[i] < INFINITY:
                if count > 0 and not bearings[i] >= bearings[order[count - 1]]:
                    falls = falls + 1
                    lowest = count
                order[count] = i
                count += 1

        # 2. The returns in the order of their bearings.
        own_ranges = self.ranges
        own_bearings = self.bearings
        own_ages = self.ages
        if falls > 1 or (falls == 1 and not bearings[order[count - 1]] < bearings[order[0]]):
            for k in range(count):
                self._unsorted[k] = bearings[order[k]]
            sort_rays(self._unsorted, count, own_bearings, self._sorted)
            for k in range(count):
                self._sorted[k] = order[self._sorted[k]]
            order = self._sorted
            lowest = 0
        for k in range(count):
            i = order[wrapped_index(k + lowest, count)]
            own_ranges[k] = ranges[i]
            own_bearings[k] = bearings[i]
            own_ages[k] = ages[i] if has_ages else 0.0
        self.count = count
        self._scan = scan


@cython.cclass
class _Cluster:
    """An object in one scan, or at a shared place, in the frame of the odometry; m and s."""

    x: float  # the mean return
    y: float
    ray_x: float  # unit vector from the lidar
    ray_y: float
    half_width: float  # half of the visible width; the radius of a shared place
    range: float
    visible_ends: int  # number of ends (0 to 2) that no nearer object hides
    measured_at: float  # when it was measured
    is_shared: bool  # a shared place
    is_used: bool  # belongs to a track


@cython.cclass
class _Filter:
    """The Kalman filter of one object in the frame of the odometry."""

    id: int
    fastest: float  # m/s, bound of the speed
    state_at: float  # s, time of the state
    seen_at: float  # s, time of the last cluster
    radius: float
    x: float
    y: float
    vx: float
    vy: float
    # The covariance of place and velocity, the same for both axes.
    pp: float
    pv: float
    vv: float
    hits: int  # clusters so far
    misses: int  # scans since the last cluster

    def begin(self, cluster: _Cluster) -> None:
        """Begin at rest where a cluster shows a new object."""
        self.state_at = cluster.measured_at
        self.seen_at = cluster.measured_at
        self.radius = min(max(cluster.half_width, _MIN_RADIUS), _MAX_RADIUS)
        self.x = cluster.x + _DEPTH_SHARE * self.radius * cluster.ray_x
        self.y = cluster.y + _DEPTH_SHARE * self.radius * cluster.ray_y
        self.pp = 0.03**2
        self.vv = _FIRST_SPEED**2
        self.hits = 1

    def predict(self, time: float) -> None:
        """Move on to `time` in s; never back."""
        dt = time - self.state_at
        if dt <= 0.0:
            return
        self.state_at = time
        self.x += self.vx * dt
        self.y += self.vy * dt
        self.pp += dt * (2.0 * self.pv + dt * (self.vv + _ACCELERATION * dt / 3.0))
        self.pv += dt * (self.vv + 0.5 * _ACCELERATION * dt)
        self.vv += _ACCELERATION * dt

    def distance_to(self, cluster: _Cluster, gate: float) -> float:
        """The distance in m from the predicted middle of this object to the middle of a cluster.

        inf if the distance is greater than `gate`.
        """
        depth = _DEPTH_SHARE * self.radius
        delay = self.state_at - cluster.measured_at
        dx = cluster.x + depth * cluster.ray_x + self.vx * delay - self.x
        dy = cluster.y + depth * cluster.ray_y + self.vy * delay - self.y
        return hypot(dx, dy) if dx * dx + dy * dy <= gate * gate else INFINITY

    def update(self, cluster: _Cluster) -> None:
        """Take in the cluster that shows this object: the update of a Kalman filter.

        The measured place is the middle of the object: _DEPTH_SHARE of the radius behind the mean
        return of the cluster.
        """
        noise = _POSITION_NOISE + _RANGE_NOISE * cluster.range
        if cluster.visible_ends == 2:
            growth = cluster.half_width - self.radius
            self.radius += (_GROWTH if growth > 0.0 else _SHRINKAGE) * growth
            self.radius = min(max(self.radius, _MIN_RADIUS), _MAX_RADIUS)
        else:  # a nearer object hides a part, so neither width nor middle are known well
            noise *= _HIDDEN_NOISE
        # The residual: the measured place, moved on to the time of the state, less the predicted
        # place.
        depth = _DEPTH_SHARE * self.radius
        delay = self.state_at - cluster.measured_at
        off_x = cluster.x + depth * cluster.ray_x + self.vx * delay - self.x
        off_y = cluster.y + depth * cluster.ray_y + self.vy * delay - self.y
        inverse = 1.0 / (self.pp + noise * noise)
        gain = self.pp * inverse
        velocity_gain = self.pv * inverse
        self.x += gain * off_x
        self.y += gain * off_y
        self.vx += velocity_gain * off_x
        self.vy += velocity_gain * off_y
        # The covariance, in this order: each line uses `pv` and `pp` before their update.
        self.vv -= velocity_gain * self.pv
        self.pv *= 1.0 - gain
        self.pp *= 1.0 - gain
        self.seen_at = cluster.measured_at
        speed = hypot(self.vx, self.vy)
        if speed > self.fastest:
            self.vx = self.vx * self.fastest / speed
            self.vy = self.vy * self.fastest / speed
        self.hits += 1
        self.misses = 0


@cython.cclass
class Surroundings:
    """The tracks, and the nearest places (k, 2) of walls, all in the base frame in m.

    Tracks and walls are computed when they are first read, which must be before the tracker takes
    in the next scan. Most decisions in a crowd read neither, and each of 35 decisions a second
    would compute 15 tracks.
    """

    _tracks: tuple[Track, ...] | None  # None: not computed yet
    _walls: Array | None  # (k, 2); None: not computed yet
    _filters: list[_Filter]
    _wall_x: Doubles  # places of walls in the frame of the odometry
    _wall_y: Doubles
    _wall_count: int
    _time: float  # s, on the clock of odometry
    _x: float  # the pose of the robot at this time, by odometry
    _y: float
    _yaw: float

    def __init__(self, tracks: tuple[Track, ...] | None, walls: Array | None) -> None:
        """None: computed later by what the tracker sets."""
        self._tracks = tracks
        self._walls = walls
        self._filters = []
        self._wall_x = _no_doubles
        self._wall_y = _no_doubles

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The objects that at least _MIN_HITS scans have shown.

        The place of a track is extrapolated at its velocity for _MAX_EXTRAPOLATED s at most.
        """
        if self._tracks is not None:
            return self._tracks
        cos_yaw = cos(self._yaw)
        sin_yaw = sin(self._yaw)
        seen: _Filter
        track: Track
        tracks = []
        for seen in self._filters:
            if seen.hits < _MIN_HITS:
                continue
            seconds_ahead = min(max(self._time - seen.state_at, 0.0), _MAX_EXTRAPOLATED)
            dx = seen.x + seen.vx * seconds_ahead - self._x
            dy = seen.y + seen.vy * seconds_ahead - self._y
            track = Track.__new__(Track)  # without objects of Python for its numbers
            track.id = seen.id
            track.radius = seen.radius
            track.x = cos_yaw * dx + sin_yaw * dy
            track.y = cos_yaw * dy - sin_yaw * dx
            track.vx = cos_yaw * seen.vx + sin_yaw * seen.vy
            track.vy = cos_yaw * seen.vy - sin_yaw * seen.vx
            tracks.append(track)
        self._tracks = tuple(tracks)
        return self._tracks

    @property
    def walls(self) -> Array:
        """(k, 2) the nearest places of walls."""
        if self._walls is not None:
            return self._walls
        cos_yaw = cos(self._yaw)
        sin_yaw = sin(self._yaw)
        walls = np.empty((self._wall_count, 2))
        places: Table = view_of(walls)
        for i in range(self._wall_count):
            dx = self._wall_x[i] - self._x
            dy = self._wall_y[i] - self._y
            places[i, 0] = cos_yaw * dx + sin_yaw * dy
            places[i, 1] = cos_yaw * dy - sin_yaw * dx
        self._walls = walls
        return walls


@cython.cclass
class Tracker:
    """Tracks the objects in the scans of one robot. Times are in s on the clock of odometry."""

    _offset_x: float
    _offset_y: float
    _latency: float  # s, of the platform
    _fastest: float  # m/s, of an object
    _widest: float  # m, of an object that is no wall
    _spacing: float  # rad between two rays
    _trail: OdometryTrail
    _filters: list[_Filter]
    _next_id: int
    # Places of walls in the frame of the odometry.
    _wall_x: Doubles
    _wall_y: Doubles
    _wall_count: int
    # The returns of the scan by bearing; of each its place (NaN: not computed yet, see `_place`),
    # and whether a gap in the bearings follows.
    _returns: ScanReturns
    _lidar_x: float  # the pose of the lidar by odometry when the scan was measured
    _lidar_y: float
    _lidar_yaw: float
    _x: Doubles
    _y: Doubles
    _is_gap: Indices
    # The runs of returns of one surface, in order: first and last return of each. The first run may
    # begin at a negative index, which counts from the end.
    _run_first: Indices
    _run_last: Indices

    def __init__(self, platform: Platform, returns: ScanReturns | None = None) -> None:
        """`returns`: what openings share; None: its own."""
        spec = platform.scan
        outer = float(np.hypot(*platform.footprint.T).max())
        self._offset_x, self._offset_y = spec.offset
        self._latency = spec.latency
        barrier = platform.protection.get("barrier") or {}
        self._fastest = float(barrier.get("others_speed", platform.limits.linear))
        self._widest = _MAX_COMPACT_SIZE * outer
        self._spacing = 2.0 * math.pi / max(len(spec.bearings), 1)
        self._trail = OdometryTrail()
        self._filters = []
        self._next_id = 1
        self._returns = returns or ScanReturns()
        self._make_room(0)  # a view that is not set ends the process when memory is taken

    def reset(self) -> None:
        """Forget all objects."""
        self._filters = []
        self._wall_count = 0
        self._trail.clear()

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. A jump of the pose moves the frame: all objects are forgotten."""
        if self._trail.take(odometry) == ANEW:
            self._filters = []
            self._wall_count = 0

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan that has arrived at the time of `context`.

        Cuts the scan into clusters (visible surfaces of objects), updates the filters of known
        objects, and begins a filter for each new object. Does nothing before the first odometry.
        """
        odometry_age = context.odometry_age
        if self._trail.count == 0 or odometry_age is None:
            return

        # 1. When and where the scan was measured, on the clock of odometry.
        newest_age = self._latency if scan.newest_age is None else scan.newest_age
        scan_time = self._trail.latest + odometry_age - newest_age - context.scan_delay
        trail: OdometryTrail = self._trail
        trail.set_pose(scan_time)
        x = trail.x
        y = trail.y
        yaw = trail.yaw
        cluster: _Cluster
        track: _Filter

        # 2. Clusters of the scan, and of places that peers shared.
        self._wall_count = 0
        self._take_returns(scan, x, y, yaw)
        clusters: list[_Cluster] = self._clusters(scan_time)
        self._add_shared_places(clusters, context)

        # 3. Filters of known objects.
        for track in self._filters:
            track.predict(scan_time)
        self._associate(clusters)
        self._end_missed(x, y, yaw, scan_time)

        # 4. A cluster that fits no object is a new object.
        for cluster in clusters:
            if cluster.is_used or self._is_part(cluster):
                continue
            if cluster.visible_ends == 0:  # between two nearer objects: a part of a wall
                self._add_wall(cluster.x, cluster.y)
            else:
                track = _Filter()
                track.id = self._next_id
                track.fastest = self._fastest
                track.begin(cluster)
                self._filters.append(track)
                self._next_id += 1

    def surroundings(self, context: DecisionContext) -> Surroundings:
        """The tracks and the places of walls at the time of `context`, in the base frame.

        Read the result before the tracker takes in the next scan. Empty before the first odometry.
        """
        odometry_age = context.odometry_age
        if self._trail.count == 0 or odometry_age is None:
            return Surroundings((), np.empty((0, 2)))
        time = self._trail.latest + odometry_age
        around: Surroundings = Surroundings(None, None)
        around._filters = self._filters
        around._time = time
        around._wall_x = self._wall_x
        around._wall_y = self._wall_y
        around._wall_count = self._wall_count
        self._trail.set_pose(time)
        around._x = self._trail.x
        around._y = self._trail.y
        around._yaw = self._trail.yaw
        return around

    def _add_shared_places(self, clusters: list[_Cluster], context: DecisionContext) -> None:
        """Add a cluster for each place that a peer shared; its radius contains the error."""
        if not context.told or self._trail.count == 0 or context.odometry_age is None:
            return
        trail: OdometryTrail = self._trail
        now = trail.latest + context.odometry_age
        for obstacle in context.told:
            trail.set_pose(now - obstacle.age)
            c = cos(trail.yaw)
            s = sin(trail.yaw)
            x = obstacle.x
            y = obstacle.y
            cluster: _Cluster = _Cluster()
            cluster.x = trail.x + c * x - s * y
            cluster.y = trail.y + s * x + c * y
            cluster.half_width = obstacle.radius
            cluster.range = hypot(x, y)
            cluster.visible_ends = 1
            cluster.measured_at = now - obstacle.age
            cluster.is_shared = True
            clusters.append(cluster)

    def _add_wall(self, x: float, y: float) -> None:
        k = self._wall_count
        self._wall_x[k] = x
        self._wall_y[k] = y
        self._wall_count = k + 1

    def _take_returns(self, scan: Scan, base_x: float, base_y: float, yaw: float) -> None:
        """Store the returns of a scan, sorted by bearing; `_place` sets their places by odometry.

        `base_x`, `base_y`, `yaw`: the pose of the base when the scan was measured. Sets the arrays
        of returns, and makes the arrays of places, runs and walls long enough.
        """
        returns: ScanReturns = self._returns
        returns.take(scan)
        if len(self._x) < len(returns.ranges):
            self._make_room(len(returns.ranges))
        self._lidar_x = base_x + cos(yaw) * self._offset_x - sin(yaw) * self._offset_y
        self._lidar_y = base_y + sin(yaw) * self._offset_x + cos(yaw) * self._offset_y
        self._lidar_yaw = yaw
        x = self._x
        for k in range(returns.count):
            x[k] = NAN

    def _place(self, k: int) -> None:
        """Set the place of return `k`, unless it is set: most returns need no sine and cosine."""
        if isnan(self._x[k]):
            distance = self._returns.ranges[k]
            angle = self._returns.bearings[k] + self._lidar_yaw
            self._x[k] = self._lidar_x + distance * cos(angle)
            self._y[k] = self._lidar_y + distance * sin(angle)

    def _squared_distance(self, i: int, j: int) -> float:
        """The square of the distance in m between the places of two returns."""
        self._place(i)
        self._place(j)
        dx = self._x[j] - self._x[i]
        dy = self._y[j] - self._y[i]
        return dx * dx + dy * dy

    def _make_room(self, count: int) -> None:
        """Make the arrays of places, runs and walls for `count` rays."""
        self._x = doubles(count)
        self._y = doubles(count)
        self._is_gap = indices(count)
        self._run_first = indices(count)
        self._run_last = indices(count)
        # Each place of a wall is a return, or the mean of a run.
        self._wall_x = doubles(count)
        self._wall_y = doubles(count)

    def _cut_into_runs(self) -> int:
        """Cut the returns into runs, each of a single surface; return the number of cuts.

        A cut is where rays are missing, or where the next return is farther away than on a surface
        that faces the lidar at a grazing angle. Returns lie all around, so there are as many runs
        as cuts. Without a cut (0), all returns are of a single surface.

        The distance is that of places, for which most returns need no place: ranges and the step
        between two bearings bound its square from both sides (law of cosines; 1 - cos step lies
        between two and one terms of its series), and so nearly always decide as the places would.

        Sets `_is_gap`, and the first and last return of each run (`_run_first`, `_run_last`).
        """
        count = self._returns.count
        ranges = self._returns.ranges
        bearings = self._returns.bearings
        is_gap = self._is_gap
        size = fabs(self._lidar_x) + fabs(self._lidar_y) + fabs(self._lidar_yaw)
        is_exact = size < _MAX_EXACT
        # Shares of the squared bound below and above which the places are not asked.
        surely_near = 1.0 - _EXACT if is_exact else 0.0
        surely_far = 1.0 + _EXACT if is_exact else INFINITY
        cuts = 0
        first = 0
        max_step = _MAX_LOST_STEPS * self._spacing
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            step = bearings[j] - bearings[i]
            if j == 0:
                step -= floor(step / TURN) * TURN
            is_cut = step > max_step
            is_gap[i] = is_cut
            if not is_cut:
                near = min(ranges[i], ranges[j])
                max_distance = _MAX_STEP + near * step / _GRAZING
                bound = max_distance * max_distance
                across = ranges[i] * ranges[j] * step * step
                most = (ranges[j] - ranges[i]) * (ranges[j] - ranges[i]) + across
                if not most < bound * surely_near:
                    least = most - across * step * step / 12.0
                    is_cut = least > bound * surely_far or self._squared_distance(i, j) > bound
            if is_cut:
                self._run_first[cuts] = first
                self._run_last[cuts] = i
                first = i + 1
                cuts += 1
        if cuts > 0:  # the returns behind the last cut are the begin of the first run
            self._run_first[0] = first - count
        return cuts

    def _clusters(self, at: float) -> list[_Cluster]:
        """The clusters that are compact objects; also adds the places of walls."""
        clusters: list[_Cluster] = []
        n = self._returns.count
        if n < 2:
            return clusters
        runs = self._cut_into_runs()
        if runs == 0:
            for i in range(0, n, 10):
                self._place(i)
                self._add_wall(self._x[i], self._y[i])
            return clusters
        index = 0
        while index < runs:
            end = self._end_of_surface(index, runs)
            self._add_surface(clusters, index, end, at)
            index = end + 1
        return clusters

    def _end_of_surface(self, index: int, run_count: int) -> int:
        """The index of the last run of the surface that begins with run `index`.

        A run of a single return between two runs may be an outlier: if the runs on both sides of
        this return fit together, they are of one surface. So the surface consists of every second
        run from `index` to the result, and the runs between them are outliers.
        """
        while index + 2 < run_count and self._run_first[index + 1] == self._run_last[index + 1]:
            i = self._run_last[index]
            j = self._run_first[index + 2]
            near = min(self._returns.ranges[i], self._returns.ranges[j])
            max_distance = _MAX_STEP + 2.0 * near * self._spacing / _GRAZING
            if self._squared_distance(j, i) > max_distance * max_distance:
                break
            index += 2
        return index

    def _add_surface(
        self, clusters: list[_Cluster], index: int, end: int, scan_time: float
    ) -> None:
        """Add a surface as a cluster (a compact object that may move), or as a wall.

        A surface wider than a few robots is a wall. A surface narrower than _MIN_WIDTH counts as
        standing, so as a wall. A surface beyond REACH is left out.

        Args:
            clusters: the list to which the cluster is added.
            index: the first run of the surface.
            end: the last run of the surface. The surface has every second run from `index` to
                `end`; the runs between these are outliers (see `_end_of_surface`).
            scan_time: s, the time of the newest ray of the scan.
        """
        ranges = self._returns.ranges
        return_count = self._returns.count
        nearest = INFINITY
        farthest = 0.0

        # 1. The nearest and the farthest return.
        for k in range(index, end + 1, 2):
            for i in range(self._run_first[k], self._run_last[k] + 1):
                ray = i if i >= 0 else i + return_count  # the first run may begin below 0
                nearest = min(nearest, ranges[ray])
                farthest = max(farthest, ranges[ray])
        if nearest > REACH:
            return

        # 2. A surface too wide for an object.
        first = (self._run_first[index] + return_count) % return_count
        last = self._run_last[end]
        self._place(first)
        self._place(last)
        chord = hypot(self._x[first] - self._x[last], self._y[first] - self._y[last])
        if chord > self._widest or farthest - nearest > self._widest:
            self._add_wall_sectors(index, end)
            return

        # 3. A single return, or a surface too narrow for an object.
        cluster: _Cluster = self._mean_return(index, end, scan_time)
        if first == last or chord < _MIN_WIDTH:
            self._add_wall(cluster.x, cluster.y)
            return

        # 4. An object that may move. The object reaches half of the distance between two rays
        # beyond the return at each end, on average.
        cluster.half_width = 0.5 * (chord + cluster.range * self._spacing)
        cluster.visible_ends = self._visible_ends(first, last)
        dx = cluster.x - self._lidar_x
        dy = cluster.y - self._lidar_y
        to_lidar = max(hypot(dx, dy), 1e-6)
        cluster.ray_x = dx / to_lidar
        cluster.ray_y = dy / to_lidar
        clusters.append(cluster)

    def _mean_return(self, index: int, end: int, scan_time: float) -> _Cluster:
        """A cluster at the mean place, range and time of the returns of a surface.

        `index`, `end`: the first and the last run of the surface, which has every second run from
        `index` to `end`. `scan_time`: s, the time of the newest ray of the scan.
        """
        x = 0.0
        y = 0.0
        distance = 0.0
        age = 0.0
        count = 0
        for k in range(index, end + 1, 2):
            for i in range(self._run_first[k], self._run_last[k] + 1):
                ray = i if i >= 0 else i + self._returns.count
                self._place(ray)
                x = x + self._x[ray]
                y = y + self._y[ray]
                distance = distance + self._returns.ranges[ray]
                age = age + self._returns.ages[ray]
                count += 1
        cluster: _Cluster = _Cluster()
        cluster.x = x / count
        cluster.y = y / count
        cluster.range = distance / count
        cluster.measured_at = scan_time - age / count
        return cluster

    def _visible_ends(self, first: int, last: int) -> int:
        """The number of ends (0 to 2) of a surface that no nearer object hides.

        `first`, `last`: the returns at the ends. An end is hidden if the next return beyond the end
        is nearer than the end.
        """
        count = self._returns.count
        before = first - 1 if first > 0 else count - 1
        after = last + 1 if last + 1 < count else 0
        visible_ends = 0
        if self._is_gap[before] or self._returns.ranges[before] > self._returns.ranges[first]:
            visible_ends += 1
        if self._is_gap[last] or self._returns.ranges[after] > self._returns.ranges[last]:
            visible_ends += 1
        return visible_ends

    def _add_wall_sectors(self, index: int, end: int) -> None:
        """Add the nearest place of a wall in each of _SECTORS directions, in order of bearing."""
        ranges = self._returns.ranges
        bearings = self._returns.bearings
        n = self._returns.count
        nearest = -1
        sector = 0.0
        for k in range(index, end + 3, 2):
            # Returns of the first run that lie at the end of the arrays come last.
            first = self._run_first[k] if k <= end else self._run_first[index] + n
            last = self._run_last[k] if k <= end else n - 1
            for i in range(max(first, 0), last + 1):
                ray_sector = floor(bearings[i] * _SECTOR)
                if nearest < 0 or ray_sector != sector:
                    self._add_near_wall(nearest)
                    nearest = i
                    sector = ray_sector
                elif ranges[i] < ranges[nearest]:
                    nearest = i
        self._add_near_wall(nearest)

    def _add_near_wall(self, i: int) -> None:
        """Add the place of return `i` of a wall if it is within REACH; -1: no return."""
        if i >= 0 and self._returns.ranges[i] <= REACH:
            self._place(i)
            self._add_wall(self._x[i], self._y[i])
            return

    def _associate(self, clusters: list[_Cluster]) -> None:
        """Update each filter by the nearest cluster within its gate."""
        track: _Filter
        cluster: _Cluster
        pairs: list[Any] = []
        for filter_index in range(len(self._filters)):
            track = self._filters[filter_index]
            track.misses += 1
            gate = _GATE * sqrt(track.pp + _POSITION_NOISE * _POSITION_NOISE)
            gate += _GATE_SLACK
            for cluster_index in range(len(clusters)):
                cluster = clusters[cluster_index]
                distance = track.distance_to(cluster, gate)
                if distance <= gate:
                    pairs.append((distance / gate, filter_index, cluster_index))
        pairs.sort()
        for _, filter_index, cluster_index in pairs:
            track = self._filters[filter_index]
            cluster = clusters[cluster_index]
            if track.misses and not cluster.is_used:
                cluster.is_used = True
                track.update(cluster)

    def _is_part(self, cluster: _Cluster) -> bool:
        """True if the mean return of a cluster lies within a track: a part of the same object."""
        track: _Filter
        for track in self._filters:
            radius = track.radius
            if cluster.is_shared:
                radius = max(radius, cluster.half_width)
            radius += _PART_SLACK
            dx = track.x - cluster.x
            dy = track.y - cluster.y
            if dx * dx + dy * dy < radius * radius:
                return True
        return False

    def _end_missed(self, x: float, y: float, yaw: float, at: float) -> None:
        """End the tracks whose place was seen empty, or that were hidden for too long."""
        track: _Filter
        kept: list[_Filter] = []
        for track in self._filters:
            if track.misses and not self._is_hidden(track, x, y, yaw):
                if track.misses >= _MAX_MISSES or track.hits < _MIN_HITS:
                    continue
            elif track.misses:
                track.misses = 0
            if at - track.seen_at <= _HIDDEN_TIME:
                kept.append(track)
        self._filters = kept

    def _is_hidden(self, track: _Filter, base_x: float, base_y: float, yaw: float) -> bool:
        """True if a return in front of a track hides its middle from the pose of the base."""
        n = self._returns.count
        if n == 0:
            return False
        cos_yaw = cos(yaw)
        sin_yaw = sin(yaw)
        dx = track.x - base_x
        dy = track.y - base_y
        x = cos_yaw * dx + sin_yaw * dy - self._offset_x
        y = cos_yaw * dy - sin_yaw * dx - self._offset_y
        # The first return whose bearing is not below; the bearings rise.
        first = bisect_left(self._returns.bearings, atan2(y, x), 0, n)
        return self._returns.ranges[first if first < n else 0] < hypot(x, y) - track.radius

"""Tracks: near objects with their velocities, from the scans and the odometry of one robot. Pure.

A scan is cut into clusters. A compact cluster is an object that may move; a long one is a wall, and
so is each cluster that fits no track and that nearer ones hide on both sides, since the visible
part of a wall moves with what hides it. Each object has a filter with constant velocity (Kalman,
1960; association by the nearest prediction within a gate, after Bar-Shalom and Fortmann, "Tracking
and data association", 1988) in the frame of the odometry. The time of a cluster is that of its own
rays, which a rotating sensor measures one after the other.

A place that others tell is an object, too: a lidar may look over them. Its error counts three times
that of a seen one.

Tracks choose a way and never make a gap smaller: protection does not read them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Odometry, Platform, Pose, Scan
from swarmd.protection.decision import DecisionContext
from swarmd.sensing.odometry_history import HISTORY, MAX_EXTRAPOLATION

REACH = 2.5  # m from the lidar beyond which no object is tracked
_JUMP = 0.06  # m between neighbouring returns of one surface that faces the lidar
_LOST = 4.5  # steps between two returns of one surface at most: rays may be lost
_LEAST_WIDTH = 0.03  # m, visible part of a new object: what is thinner counts as standing
_PART = 0.05  # m from the outline of an object within which a cluster is a part of it
_GRAZING = math.sin(math.radians(15.0))  # of the least angle between a ray and a surface
_COMPACT = 3.0  # times the own circumscribed circle: what is wider is a wall
_DEPTH = 0.8  # of the radius: how far the middle lies behind the mean return of an object
_LEAST_RADIUS, _MOST_RADIUS = 0.02, 0.6  # m
_POSITION_NOISE, _RANGE_NOISE = 0.016, 0.006  # m, and m a m of range: of a middle
_HIDDEN_NOISE = 3.0  # times more for an object that a nearer one hides in part
_ACCELERATION = 0.03  # m2/s3, density of the change of velocity
_FIRST_SPEED = 0.15  # m/s, deviation of the velocity of a new track
_GATE = 2.5  # deviations
_GATE_SLACK = 0.03  # m
_CONFIRMED = 2  # scans that show an object before it counts
_MISSES = 2  # scans in a row that show its place to be empty end a track
_HIDDEN_TIME = 1.5  # s for which a hidden object is remembered
_SECTORS = 36  # directions in each of which the nearest place of a wall is kept


_Rows: TypeAlias = NDArray[np.intp]


class Track(NamedTuple):
    """A moving object as seen now: base frame, m and m/s.

    `speed_error`: standard deviation of each component of the velocity.
    """

    id: int
    x: float
    y: float
    vx: float
    vy: float
    radius: float
    speed_error: float


class Surroundings(NamedTuple):
    """The tracks, and the nearest places (k, 2) of walls, all in the base frame in m."""

    tracks: tuple[Track, ...]
    walls: Array


class _Cluster(NamedTuple):
    """An object of one scan, or a told one, in the frame of the odometry, m, and s.

    The mean return `x`, `y`, the direction `dx`, `dy` from the lidar, half of the visible width,
    the range, and the number of ends (0 to 2) that no nearer object hides.
    """

    x: float
    y: float
    dx: float
    dy: float
    half: float
    range: float
    ends: int
    at: float
    is_told: bool = False


class _Filter:
    """One object: state in the frame of the odometry, with one covariance for both axes.

    `fastest` in m/s bounds its speed.
    """

    def __init__(self, id: int, seen: _Cluster, fastest: float) -> None:
        self.fastest = fastest
        self.id, self.at, self.seen_at = id, seen.at, seen.at
        self.radius = min(max(seen.half, _LEAST_RADIUS), _MOST_RADIUS)
        self.x = seen.x + _DEPTH * self.radius * seen.dx
        self.y = seen.y + _DEPTH * self.radius * seen.dy
        self.vx = self.vy = 0.0
        self.pp, self.pv, self.vv = 0.03**2, 0.0, _FIRST_SPEED**2
        self.hits, self.misses = 1, 0

    def predict(self, at: float) -> None:
        """Move on to the time `at` in s; never back."""
        dt = at - self.at
        if dt <= 0.0:
            return
        self.at = at
        self.x += self.vx * dt
        self.y += self.vy * dt
        self.pp += dt * (2.0 * self.pv + dt * (self.vv + _ACCELERATION * dt / 3.0))
        self.pv += dt * (self.vv + 0.5 * _ACCELERATION * dt)
        self.vv += _ACCELERATION * dt

    def middle(self, seen: _Cluster) -> tuple[float, float]:
        """Where the middle of this object is by a cluster."""
        depth = _DEPTH * self.radius
        return seen.x + depth * seen.dx, seen.y + depth * seen.dy

    def update(self, seen: _Cluster) -> None:
        """Take in the cluster that shows this object."""
        if seen.ends == 2:
            grown = seen.half - self.radius
            self.radius += (0.3 if grown > 0.0 else 0.03) * grown
            self.radius = min(max(self.radius, _LEAST_RADIUS), _MOST_RADIUS)
        x, y = self.middle(seen)
        noise = _POSITION_NOISE + _RANGE_NOISE * seen.range
        if seen.ends < 2:
            noise *= _HIDDEN_NOISE
        late = self.at - seen.at  # clusters of one scan have times of their own
        inverse = 1.0 / (self.pp + noise * noise)
        gain, rise = self.pp * inverse, self.pv * inverse
        off_x, off_y = x + self.vx * late - self.x, y + self.vy * late - self.y
        self.x += gain * off_x
        self.y += gain * off_y
        self.vx += rise * off_x
        self.vy += rise * off_y
        self.vv -= rise * self.pv
        self.pv *= 1.0 - gain
        self.pp *= 1.0 - gain
        self.seen_at = seen.at
        speed = math.hypot(self.vx, self.vy)
        if speed > self.fastest:
            self.vx, self.vy = self.vx * self.fastest / speed, self.vy * self.fastest / speed
        self.hits += 1
        self.misses = 0


class Tracker:
    """Follows what the scans of one robot show. Times in s on the clock of odometry's stamps."""

    def __init__(self, platform: Platform) -> None:
        spec = platform.scan
        outer = float(np.hypot(*platform.footprint.T).max())
        self._offset, self._latency = spec.offset, spec.latency
        barrier = platform.protection.get("barrier") or {}
        self._fastest = float(barrier.get("others_speed", platform.limits.linear))
        self._widest = _COMPACT * outer
        self._spacing = 2.0 * math.pi / max(len(spec.bearings), 1)
        self._history: deque[Odometry] = deque(maxlen=HISTORY)
        self._filters: list[_Filter] = []
        self._walls = np.empty((0, 2))  # in the frame of the odometry
        self._next = 1

    def reset(self) -> None:
        """Forget all objects."""
        self._filters, self._walls = [], np.empty((0, 2))
        self._history.clear()

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. A jump of the pose moves the frame: all objects are forgotten."""
        history = self._history
        if history and (odometry.stamp <= history[-1].stamp or odometry.jumps_from(history[-1])):
            if odometry.stamp == history[-1].stamp:
                return
            self.reset()
        history.append(odometry)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan that has arrived at the time of `context`."""
        if not self._history or context.odometry_age is None:
            return
        newest = self._latency if scan.newest_age is None else scan.newest_age
        at = self._history[-1].stamp + context.odometry_age - newest - context.scan_delay
        pose = self._pose(at)
        clusters, ranges, bearings, walls = self._clusters(scan, pose, at)
        clusters += self._told(context)
        for one in self._filters:
            one.predict(at)
        is_used = self._associate(clusters)
        self._end_missed(pose, at, ranges, bearings)
        for cluster, is_known in zip(clusters, is_used, strict=True):
            if is_known:
                continue
            if self._is_part(cluster):
                continue
            if cluster.ends == 0:  # the part of a wall between two nearer objects
                walls.append((cluster.x, cluster.y))
            else:
                self._filters.append(_Filter(self._next, cluster, self._fastest))
                self._next += 1
        self._walls = np.array(walls, np.float64).reshape(-1, 2)

    def surroundings(self, context: DecisionContext) -> Surroundings:
        """The objects at the time of `context`, and the walls, in the base frame."""
        if not self._history or context.odometry_age is None:
            return Surroundings((), np.empty((0, 2)))
        at = self._history[-1].stamp + context.odometry_age
        pose = self._pose(at)
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        tracks = []
        for one in self._filters:
            if one.hits < _CONFIRMED:
                continue
            ahead = min(max(at - one.at, 0.0), 1.0)
            dx, dy = one.x + one.vx * ahead - pose.x, one.y + one.vy * ahead - pose.y
            tracks.append(
                Track(
                    one.id,
                    cos * dx + sin * dy,
                    cos * dy - sin * dx,
                    cos * one.vx + sin * one.vy,
                    cos * one.vy - sin * one.vx,
                    one.radius,
                    math.sqrt(one.vv),
                )
            )
        walls = self._walls - (pose.x, pose.y)
        walls = np.stack(
            (cos * walls[:, 0] + sin * walls[:, 1], cos * walls[:, 1] - sin * walls[:, 0]), axis=1
        )
        return Surroundings(tuple(tracks), walls)

    def _pose(self, at: float) -> Pose:
        """The pose at a time, interpolated, or extrapolated from the last reading."""
        later = self._history[-1]
        if at >= later.stamp or len(self._history) == 1:
            seconds = min(max(at - later.stamp, -MAX_EXTRAPOLATION), MAX_EXTRAPOLATION)
            twist, pose = later.twist, later.pose
            yaw = pose.yaw + 0.5 * seconds * twist.angular
            cos, sin = math.cos(yaw), math.sin(yaw)
            return Pose(
                pose.x + seconds * (cos * twist.linear - sin * twist.lateral),
                pose.y + seconds * (sin * twist.linear + cos * twist.lateral),
                pose.yaw + seconds * twist.angular,
            )
        for earlier in reversed(self._history):
            if earlier.stamp <= at:
                share = (at - earlier.stamp) / max(later.stamp - earlier.stamp, 1e-9)
                here, there = earlier.pose, later.pose
                turn = math.remainder(there.yaw - here.yaw, 2.0 * math.pi)
                return Pose(
                    here.x + share * (there.x - here.x),
                    here.y + share * (there.y - here.y),
                    here.yaw + share * turn,
                )
            later = earlier
        return later.pose

    def _told(self, context: DecisionContext) -> list[_Cluster]:
        """The obstacles that others tell of; a told radius contains the error."""
        found, now = [], self._history[-1].stamp + (context.odometry_age or 0.0)
        for one in context.told:
            pose = self._pose(now - one.age)
            cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
            x, y = pose.x + cos * one.x - sin * one.y, pose.y + sin * one.x + cos * one.y
            way = math.hypot(one.x, one.y)
            found.append(_Cluster(x, y, 0.0, 0.0, one.radius, way, 1, now - one.age, True))
        return found

    def _clusters(
        self, scan: Scan, pose: Pose, at: float
    ) -> tuple[list[_Cluster], Array, Array, list[tuple[float, float]]]:
        """The compact objects, the returns in order of bearings, and places of walls."""
        ranges, bearings = scan.ranges, scan.bearings
        rays = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0))
        rays = rays[np.argsort(bearings[rays], kind="stable")]
        ranges, bearings = ranges[rays], bearings[rays]
        n, walls = len(rays), list[tuple[float, float]]()
        if n < 2:
            return [], ranges, bearings, walls
        angles = bearings + pose.yaw
        directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        ox, oy = self._offset
        lidar = pose.x + cos * ox - sin * oy, pose.y + sin * ox + cos * oy
        points = lidar + ranges[:, None] * directions
        ages = np.zeros(n) if scan.ages is None else scan.ages[rays]
        after = np.roll(points, -1, axis=0) - points
        near = np.minimum(ranges, np.roll(ranges, -1))
        steps = (np.roll(bearings, -1) - bearings) % (2.0 * math.pi)
        apart = np.hypot(after[:, 0], after[:, 1])
        is_last = apart > _JUMP + near * steps / _GRAZING
        is_gap = steps > _LOST * self._spacing
        is_last |= is_gap
        ends = np.flatnonzero(is_last)
        if not len(ends):
            return [], ranges, bearings, [(float(x), float(y)) for x, y in points[::10]]
        clusters, width = [], self._widest
        for rows in self._bridged(points, ranges, ends):
            some = ranges[rows]
            if some.min() > REACH:
                continue
            one, other = points[rows[0]], points[rows[-1]]
            mean = points[rows].mean(axis=0)
            chord = math.hypot(one[0] - other[0], one[1] - other[1])
            distance = float(some.mean())
            if chord > width or some.max() - some.min() > width:
                walls += self._nearest_places(points[rows], some, bearings[rows])
                continue
            if len(rows) == 1 or chord < _LEAST_WIDTH:
                walls.append((float(mean[0]), float(mean[1])))
                continue
            one_end, other_end = int(rows[0]), int(rows[-1])
            free = int(is_gap[one_end - 1] or ranges[one_end - 1] > ranges[one_end])
            free += int(is_gap[other_end] or ranges[(other_end + 1) % n] > ranges[other_end])
            dx, dy = mean[0] - lidar[0], mean[1] - lidar[1]
            way = max(math.hypot(dx, dy), 1e-6)
            half = 0.5 * (chord + distance * self._spacing)
            seen = at - float(ages[rows].mean())
            place = float(mean[0]), float(mean[1]), float(dx / way), float(dy / way)
            clusters.append(_Cluster(*place, half, distance, free, seen))
        return clusters, ranges, bearings, walls

    def _bridged(self, points: Array, ranges: Array, ends: NDArray[np.intp]) -> Iterator[_Rows]:
        """The rows of the surfaces that end at `ends`; one outlier does not cut a surface."""
        n = len(ranges)
        runs: list[list[int]] = []
        last = int(ends[-1]) - n
        for end in ends.tolist():
            runs.append([last + 1, end])
            last = end
        index = 0
        while index < len(runs):
            rows = [runs[index]]
            while index + 2 < len(runs) and runs[index + 1][0] == runs[index + 1][1]:
                one, other = points[runs[index][1]], points[runs[index + 2][0]]
                near = min(ranges[runs[index][1]], ranges[runs[index + 2][0]])
                off = math.hypot(one[0] - other[0], one[1] - other[1])
                if off > _JUMP + 2.0 * near * self._spacing / _GRAZING:
                    break
                index += 2
                rows.append(runs[index])
            yield np.concatenate([np.arange(first, end + 1) for first, end in rows]) % n
            index += 1

    def _nearest_places(
        self, points: Array, ranges: Array, bearings: Array
    ) -> list[tuple[float, float]]:
        """The nearest place of a wall in each of some directions."""
        sectors = np.floor(bearings * (_SECTORS / (2.0 * math.pi))).astype(np.int64)
        order = np.lexsort((ranges, sectors))
        first = np.concatenate(([True], np.diff(sectors[order]) != 0))
        near = order[first]
        near = near[ranges[near] <= REACH]
        return [(float(x), float(y)) for x, y in points[near]]

    def _associate(self, clusters: list[_Cluster]) -> list[bool]:
        """Update each filter by the nearest cluster within its gate; which clusters were used."""
        pairs = []
        for row, one in enumerate(self._filters):
            one.misses += 1
            for index, seen in enumerate(clusters):
                x, y = one.middle(seen)
                late = one.at - seen.at
                off = math.hypot(x + one.vx * late - one.x, y + one.vy * late - one.y)
                gate = _GATE * math.sqrt(one.pp + _POSITION_NOISE**2) + _GATE_SLACK
                if off <= gate:
                    pairs.append((off / gate, row, index))
        is_used, done = [False] * len(clusters), set[int]()
        for _, row, index in sorted(pairs):
            if row not in done and not is_used[index]:
                done.add(row)
                is_used[index] = True
                self._filters[row].update(clusters[index])
        return is_used

    def _is_part(self, cluster: _Cluster) -> bool:
        """True if a cluster is a part of an object that another part has shown."""
        return any(
            math.hypot(one.x - cluster.x, one.y - cluster.y)
            < (max(one.radius, cluster.half) if cluster.is_told else one.radius) + _PART
            for one in self._filters
        )

    def _end_missed(self, pose: Pose, at: float, ranges: Array, bearings: Array) -> None:
        """End each track whose place is seen to be empty, or that was hidden for too long."""
        kept = []
        for one in self._filters:
            if one.misses and not self._is_hidden(one, pose, ranges, bearings):
                if one.misses >= _MISSES or one.hits < _CONFIRMED:
                    continue
            elif one.misses:
                one.misses = 0
            if at - one.seen_at <= _HIDDEN_TIME:
                kept.append(one)
        self._filters = kept

    def _is_hidden(self, one: _Filter, pose: Pose, ranges: Array, bearings: Array) -> bool:
        """True if a nearer object hides the middle of a track, given the returns by bearing."""
        if not len(ranges):
            return False
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        dx, dy = one.x - pose.x, one.y - pose.y
        x, y = cos * dx + sin * dy - self._offset[0], cos * dy - sin * dx - self._offset[1]
        index = int(np.searchsorted(bearings, math.atan2(y, x))) % len(ranges)
        return bool(ranges[index] < math.hypot(x, y) - one.radius)

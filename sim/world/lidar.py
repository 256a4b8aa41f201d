"""Exact 2-D range sensors of a swarm: rays against the flat and round shapes in their plane.

Each shape covers one interval of bearings seen from the sensor. Its distance is computed only for
the rays within that interval, so a scan costs the shapes nearby and not rays times shapes. The
tests compare the result with MuJoCo's ray caster to 1e-9 m.

Each coordinate has one array, and the arithmetic uses one over the distance, which along a surface
is the sum of a cosine and a sine: both are several times faster. `lidar_kernel.py` has the same
operations in C, and gives the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Platform, ScanSpec, Sweep
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.bodies import heights, value
from swarmd.sim.world.geometry import Indices

if TYPE_CHECKING:  # where it is not compiled the numpy code runs
    from swarmd.sim.world.lidar_kernel import Caster

Places = NDArray[np.intp]
Visibility = Literal["body", "real"]

_TURNS = 2.0 * np.pi * np.array([-2.0, -1.0, 0.0, 1.0])
# Rad added to each interval, so that no ray passes between two surfaces that share a corner.
BEARING_MARGIN = 1e-12
# Rad by which rays may differ from equal steps for their places to be computed, not searched.
_MAX_UNEVENNESS = 1e-13
_AT_START = 1e-9  # rad
# m2: a surface whose side (see `Lidar`) is smaller than this is seen edge-on and ignored.
MIN_SIDE = 1e-10
# m added to ranges of interest, which are compared in single precision.
_ROUNDING = 0.01
_BATCH = 50  # sensors a step, so that its arrays stay within a processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """The shapes that one kind of sensor detects; lengths in m.

    Fixed, in the world frame: `walls` (w, 2, 2), flat surfaces by start and end with the solid on
    their left, visible from the right alone; `poles` (p, 3) x, y, radius. Moving, in the frames of
    their owners: `polygons` (b, k, 2), convex and counter-clockwise, padded by repeating the last
    corner, and `discs` (d, 3) x, y, radius. `polygon_owners` (b,) and `disc_owners` (d,) are the
    rows of robots, then of boxes. No robot sees its own shapes.
    """

    walls: Array
    poles: Array
    polygons: Array
    polygon_owners: Indices
    discs: Array
    disc_owners: Indices


def shapes_of(arena: Arena, platforms: Sequence[Platform], *, plane: float | None) -> Shapes:
    """The shapes for one kind of sensor; row i is the robot of `platforms[i]`, then come boxes.

    `plane`: the height in m of the scan plane; None: every footprint is visible. A plane within a
    robot's height shows its footprint, above that the housing of its lidar, above that nothing.
    Walls, boxes and poles reach any plane.
    """
    whole = [i for i, p in enumerate(platforms) if plane is None or plane <= value(p, "height")]
    housed = [
        i
        for i, p in enumerate(platforms)
        if i not in whole and plane is not None and plane <= heights(p).highest
    ]
    boxes = [box.shape for _, box in arena.movable_boxes]
    box_rows = range(len(platforms), len(platforms) + len(boxes))
    outlines = [*(platforms[i].footprint for i in whole), *boxes]
    discs = [(*platforms[i].scan.offset, value(platforms[i], "target_radius")) for i in housed]
    return Shapes(
        walls=arena.surfaces,
        poles=arena.circles,
        polygons=_padded(outlines),
        polygon_owners=np.array([*whole, *box_rows], dtype=np.intp),
        discs=np.array(discs, dtype=np.float64).reshape(-1, 3),
        disc_owners=np.array(housed, dtype=np.intp),
    )


def _padded(polygons: Sequence[Array]) -> Array:
    """(b, k, 2) with the last corner of those of fewer than k repeated."""
    most = max((len(polygon) for polygon in polygons), default=0)
    padded = [
        np.concatenate((polygon, np.repeat(polygon[-1:], most - len(polygon), axis=0)))
        for polygon in polygons
    ]
    return np.array(padded, dtype=np.float64).reshape(len(polygons), most, 2)


class Rays:
    """The rays of a scan in order of bearing, repeated over four turns so that no interval is cut.

    By place in that order: `number` in the scan, `bearings` in rad, their `cos` and `sin`.
    `is_even`: they differ by equal steps of `step` rad.
    """

    def __init__(self, bearings: Array) -> None:
        """`bearings` (n,) rad of a scan, in any order."""
        wrapped = np.mod(bearings + np.pi, 2.0 * np.pi) - np.pi
        order = np.argsort(wrapped, kind="stable")
        self.number = np.tile(order, len(_TURNS))
        self.cos = np.tile(np.cos(bearings[order]), len(_TURNS))
        self.sin = np.tile(np.sin(bearings[order]), len(_TURNS))
        self.bearings = np.add.outer(_TURNS, wrapped[order]).ravel()
        self.step = 2.0 * np.pi / max(len(order), 1)
        even = self.bearings[:1] + self.step * np.arange(len(self.bearings))
        self.is_even = np.allclose(even, self.bearings, rtol=0.0, atol=_MAX_UNEVENNESS)

    def within(self, low: Array, high: Array) -> tuple[Places, Places]:
        """The places of the rays in each interval (k,) of bearings, and their number (k,).

        The places of all intervals are concatenated. Bearings lie within -5 pi and 3 pi.
        """
        first = self._place(low - BEARING_MARGIN)
        counts = self._place(high + BEARING_MARGIN) - first
        end = counts.cumsum()
        places = (first - end + counts).repeat(counts)
        places += np.arange(len(places))
        return places, counts

    def place_of(self, number: int) -> int:
        """The place of the ray with this number in the scan."""
        return int(np.flatnonzero(self.number == number)[0])

    def _place(self, bearing: Array) -> Places:
        """The number of rays with smaller bearings."""
        if not self.is_even:
            return np.searchsorted(self.bearings, bearing)
        place: Array = np.ceil((bearing - self.bearings[0]) / self.step)
        return place.astype(np.intp)


def sweep_order(bearings: Array, sweep: Sweep) -> tuple[Indices, Array]:
    """The rays (n,) in the order in which a sweep measures them, and the time of each in s."""
    turned = sweep.direction * (bearings - sweep.start)
    # A ray at the start is the first one, also if rounding places it before.
    turned = np.mod(turned + _AT_START, 2.0 * np.pi)
    order = np.argsort(turned, kind="stable")
    return order, sweep.duration / (2.0 * np.pi) * turned[order]


@dataclass(frozen=True, slots=True, eq=False)
class _Sensors:
    """The poses of m sensors and the rows of their robots; `yaw` is within -pi and pi."""

    x: Array
    y: Array
    yaw: Array
    cos: Array
    sin: Array
    carriers: Indices


class Lidar:
    """Casts the scans of all sensors of one kind at once.

    Surfaces are arrays (4, ...): x and y of the start, x and y from there to the end, world frame.
    The `side` of a surface is the sensor's distance from its line times its length, negative where
    the sensor faces its front.
    """

    def __init__(self, spec: ScanSpec, shapes: Shapes) -> None:
        self._spec, self._shapes = spec, shapes
        self._rays = Rays(spec.bearings)
        start, end = shapes.walls[:, 0], shapes.walls[:, 1]
        self._walls = np.concatenate((start, end - start), axis=1).T.copy()
        self._seen_walls = -spec.range_max * np.hypot(self._walls[2], self._walls[3])
        corners = shapes.polygons
        edges = np.concatenate((corners, np.roll(corners, -1, axis=1) - corners), axis=2)
        self._edges = np.moveaxis(edges, 2, 0).copy()
        self._reach = np.hypot(corners[..., 0], corners[..., 1]).max(axis=1, initial=0.0)
        kernel = compiled_kernel("swarmd.sim.world.lidar_kernel")
        self._caster: Caster | None = kernel and kernel.Caster(
            spec,
            self._rays,
            np.concatenate((self._walls, self._seen_walls[None])).T,
            shapes.poles,
            np.moveaxis(self._edges, 0, 2),
            self._reach,
            shapes.polygon_owners,
            shapes.discs,
            shapes.disc_owners,
        )

    def cast(self, poses: Array, observers: Indices) -> Array:
        """Ranges (m, rays) in m of robots `observers` (m,), with all bodies at `poses` (n, 3).

        A row of NaN is absent. +inf: no return within range_max, -inf: nearer than range_min.
        """
        count, rays = len(observers), len(self._spec.bearings)
        ranges = np.full((count, rays), np.inf)
        if self._caster is not None:
            first, counts = np.zeros(count, dtype=np.intp), np.full(count, rays)
            observers = np.ascontiguousarray(observers)
            self._caster.cast(poses, observers, first, counts, np.arange(count), ranges)
            return ranges
        for begin in range(0, count, _BATCH):
            some = slice(begin, begin + _BATCH)
            self._cast(ranges[some], poses, observers[some])
        return ranges

    def sectors(self, ends: Indices) -> tuple[Indices, Indices]:
        """Sectors of a sweep that end after `ends` (k,) rays: the first place and the rays (k,).

        A place is that of a ray in order of bearing.
        """
        sweep, bearings = self._spec.sweep, self._spec.bearings
        assert sweep is not None
        counts = np.diff(ends, prepend=0)
        start = self._rays.place_of(sweep_order(bearings, sweep)[0][0])
        first = start + ends - counts if sweep.direction > 0.0 else start + 1 - ends
        return first % len(bearings), counts

    def cast_sectors(
        self,
        ranges: Array,
        rows: Indices,
        poses: Array,
        observers: Indices,
        first: Indices,
        counts: Indices,
    ) -> None:
        """Put sectors `first`, `counts` (m,) of robots `observers` (m,) in `rows` of `ranges`.

        `ranges` (r, rays), `rows` (m,); `poses` as in `cast`.
        """
        if self._caster is not None:
            self._caster.cast(poses, observers, first, counts, rows, ranges)
            return
        due = np.flatnonzero(counts)
        seen_by_row = self.cast(poses, observers[due])
        for row, place, count, seen in zip(
            rows[due], first[due], counts[due], seen_by_row, strict=True
        ):
            some = self._rays.number[place : place + count]
            ranges[row, some] = seen[some]

    def _cast(self, ranges: Array, poses: Array, observers: Indices) -> None:
        sensors = self._sensors(poses, observers)
        nearness = np.zeros(ranges.shape)
        self._meet_surfaces(nearness, sensors, poses)
        if len(self._shapes.poles) or len(self._shapes.discs):
            self._meet_circles(nearness, sensors, poses)
        np.divide(1.0, nearness, out=ranges, where=nearness > 0.0)
        ranges[ranges > self._spec.range_max] = np.inf
        ranges[ranges < self._spec.range_min] = -np.inf

    def _sensors(self, poses: Array, observers: Indices) -> _Sensors:
        x, y, yaw = poses[observers].T
        cos, sin = np.cos(yaw), np.sin(yaw)
        ahead, left = self._spec.offset
        return _Sensors(
            x + (cos * ahead - sin * left),
            y + (sin * ahead + cos * left),
            np.mod(yaw + np.pi, 2.0 * np.pi) - np.pi,
            cos,
            sin,
            observers,
        )

    def _meet_surfaces(self, nearness: Array, sensors: _Sensors, poses: Array) -> None:
        scan, surfaces, side = self._facing_walls(sensors)
        if len(self._shapes.polygons):
            carried = self._facing_edges(sensors, poses)
            scan, side = np.concatenate((scan, carried[0])), np.concatenate((side, carried[2]))
            surfaces = np.concatenate((surfaces, carried[1]), axis=1)
        x, y, along_x, along_y = surfaces
        x -= sensors.x.take(scan)
        y -= sensors.y.take(scan)
        high = np.arctan2(y, x) - sensors.yaw.take(scan)
        turn = np.arctan2(-side, x * (x + along_x) + y * (y + along_y))
        cos, sin = sensors.cos.take(scan), sensors.sin.take(scan)
        by_cos = (cos * along_y - sin * along_x) / side
        by_sin = (cos * along_x + sin * along_y) / -side
        places, counts = self._rays.within(high - turn, high)
        near = by_cos.repeat(counts)
        near *= self._rays.cos.take(places)
        more = by_sin.repeat(counts)
        more *= self._rays.sin.take(places)
        near += more
        self._raise(nearness, scan.repeat(counts), places, near)

    def _facing_walls(self, sensors: _Sensors) -> tuple[Indices, Array, Array]:
        """For each pair that faces: the sensor (e,), the wall (4, e) and its side (e,)."""
        x, y, along_x, along_y = self._walls
        side = (x - sensors.x[:, None]) * along_y - (y - sensors.y[:, None]) * along_x
        seen = _places((side < -MIN_SIDE) & (side >= self._seen_walls))
        scan, wall = _divided(seen, len(x))
        return scan, self._walls.take(wall, axis=1), side.take(seen)

    def _facing_edges(self, sensors: _Sensors, poses: Array) -> tuple[Indices, Array, Array]:
        """As `_facing_walls` for the edges of polygons, without those of the sensor's own robot."""
        owners, corners = self._shapes.polygon_owners, self._edges.shape[2]
        at = poses[owners]
        scan, polygon = _near(sensors, at[:, 0], at[:, 1], self._reach + self._spec.range_max)
        other = _places(owners.take(polygon) != sensors.carriers.take(scan))
        scan, polygon = scan.take(other), polygon.take(other)
        is_near = np.zeros(len(owners), dtype=np.bool_)
        is_near[polygon] = True
        edges = _placed(self._edges[:, is_near], at[is_near])
        row = (is_near.cumsum() - 1).take(polygon)
        x, y, along_x, along_y = edges
        side = along_x.take(row, axis=0) * sensors.y.take(scan)[:, None]
        side -= along_y.take(row, axis=0) * sensors.x.take(scan)[:, None]
        side += (x * along_y - y * along_x).take(row, axis=0)
        seen = _places(side < -MIN_SIDE)
        pair, edge = _divided(seen, corners)
        surfaces = edges.reshape(4, -1).take(row.take(pair) * corners + edge, axis=1)
        return scan.take(pair), surfaces, side.take(seen)

    def _meet_circles(self, nearness: Array, sensors: _Sensors, poses: Array) -> None:
        shapes = self._shapes
        at = poses[shapes.disc_owners]
        discs = _placed(shapes.discs[:, :2].T[..., None], at)[..., 0]
        x, y = np.concatenate((shapes.poles[:, :2].T, discs), axis=1)
        radius = np.concatenate((shapes.poles[:, 2], shapes.discs[:, 2]))
        scan, circle = _near(sensors, x, y, radius + self._spec.range_max)
        x = x.take(circle) - sensors.x.take(scan)
        y = y.take(circle) - sensors.y.take(scan)
        radius = radius.take(circle)
        beyond = x * x + y * y - radius * radius
        seen = _places(beyond > 0.0)  # not from inside: no sensor sees its own housing
        scan, x, y = scan.take(seen), x.take(seen), y.take(seen)
        radius, beyond = radius.take(seen), beyond.take(seen)
        middle = np.arctan2(y, x) - sensors.yaw.take(scan)
        half = np.arcsin(radius / np.hypot(x, y))
        places, counts = self._rays.within(middle - half, middle + half)
        cos, sin = sensors.cos.take(scan), sensors.sin.take(scan)
        ahead, left = np.repeat((cos * x + sin * y, cos * y - sin * x), counts, axis=1)
        cos, sin = self._rays.cos.take(places), self._rays.sin.take(places)
        aside = cos * left - sin * ahead
        depth = np.sqrt(np.maximum((radius * radius).repeat(counts) - aside * aside, 0.0))
        # One over (distance to the middle - depth), without the difference of nearly equal ones.
        near = (cos * ahead + sin * left + depth) / beyond.repeat(counts)
        self._raise(nearness, scan.repeat(counts), places, near)

    def _raise(self, nearness: Array, scan: Indices, places: Indices, near: Array) -> None:
        """Keep the nearest return of each ray: the largest of one over the distances."""
        ray = scan * nearness.shape[1] + self._rays.number.take(places)
        np.maximum.at(nearness.reshape(-1), ray, near)


def _near(sensors: _Sensors, x: Array, y: Array, reach: Array) -> tuple[Indices, Indices]:
    """The pairs of sensors and shapes at x, y (b,) within `reach` (b,), and a few more."""
    single = np.float32
    squared = x.astype(single) - sensors.x.astype(single)[:, None]
    squared *= squared
    aside = y.astype(single) - sensors.y.astype(single)[:, None]
    aside *= aside
    squared += aside
    most = (reach + _ROUNDING).astype(single)
    return _divided(_places(squared <= most * most), len(x))


def _places(is_one: NDArray[np.bool_]) -> Indices:
    """The indices at which the flattened array is true."""
    return is_one.ravel().nonzero()[0]


def _divided(places: Indices, width: int) -> tuple[Indices, Indices]:
    """The rows and columns of places in an array of that width; np.divmod takes thrice as long."""
    row = places // max(width, 1)
    return row, places - row * width


def _placed(vectors: Array, poses: Array) -> Array:
    """Points (2, b, k) of frames at `poses` (b, 3), in the world frame.

    In an array (4, b, k) the last two rows are directions, which are rotated only.
    """
    cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = vectors[0::2], vectors[1::2]
    placed = np.empty_like(vectors)
    placed[0::2] = cos * x - sin * y
    placed[1::2] = sin * x + cos * y
    placed[:2] += poses[:, :2].T[..., None]
    return placed


class RangeSensors:
    """The range sensors of a whole swarm: one `Lidar` for each platform."""

    def __init__(self, platforms: Sequence[Platform], arena: Arena, visibility: Visibility) -> None:
        """`platforms` (n,) in the order of rows; `visibility` as `World` explains it.

        `lidars`: each `Lidar` with the rows of its robots.
        """
        kinds = {platform.name: platform for platform in platforms}
        names = list(kinds)
        self._kinds = np.array([names.index(p.name) for p in platforms], dtype=np.intp)
        self.lidars: list[tuple[Lidar, Indices]] = []
        for number, platform in enumerate(kinds.values()):
            plane = heights(platform).scan_plane if visibility == "real" else None
            shapes = shapes_of(arena, platforms, plane=plane)
            self.lidars.append((Lidar(platform.scan, shapes), _places(self._kinds == number)))

    def cast(self, poses: Array, robots: Indices) -> list[Array]:
        """Ranges (rays,) for each of `robots` (m,) with all robots at base `poses` (n, 3)."""
        if len(self.lidars) == 1:
            return list(self.lidars[0][0].cast(poses, robots))
        rows: dict[int, Array] = {}
        for kind in np.unique(self._kinds[robots]):
            observers = robots[self._kinds[robots] == kind]
            ranges = self.lidars[kind][0].cast(poses, observers)
            rows.update(zip(observers.tolist(), ranges, strict=True))
        return [rows[robot] for robot in robots.tolist()]

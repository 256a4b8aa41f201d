"""Exact 2-D range sensors of a swarm, by ray casting against walls, polygons and circles.

`ray_caster.py` has the arithmetic. The tests compare the result with MuJoCo's ray caster to 1e-9 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from swarmd.core.values import Array, Platform, ScanSpec, Sweep
from swarmd.sim.world import ray_caster
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.bodies import heights, value
from swarmd.sim.world.geometry import Indices

Visibility = Literal["body", "real"]


@dataclass(frozen=True, slots=True)
class LidarModel:
    """What the lidars of a world detect of robots, and the number of sectors of a revolution.

    The default visibility is `body`, in which lidars see whole footprints, because the published
    behaviours need it. With true heights, the part of a Waffle Pi that other lidars see is a
    housing 0.11 m wide. At a distance of 2 m only 3 rays hit the housing. Protection needs more
    than 5 rays, so it detects the robot at 1 m only.
    """

    visibility: Visibility = "body"
    """The shape of a robot for a lidar: its footprint (`body`), or its section in the scan plane
    (`real`)."""
    sectors: int = 10
    """The least number of sectors of a rolling scan; the rays of a sector are measured together."""


_TURNS = 2.0 * np.pi * np.array([-2.0, -1.0, 0.0, 1.0])
# rad; bearings that differ less from equal steps count as even: indices are computed, not searched.
_MAX_UNEVENNESS = 1e-13
_AT_START = 1e-9  # rad
_RAYS_IN_BEAM = 9  # at a cone of 27 deg a ray each 3.4 deg: 6 cm apart at 1 m


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """The shapes that one kind of sensor detects; lengths in m. No robot detects its own shapes."""

    walls: Array
    """(w, 2, 2) start and end of fixed flat surfaces in the world frame.

    The solid is on the left; a surface is visible from its right side alone."""
    poles: Array
    """(p, 3) x, y, radius of fixed poles in the world frame."""
    polygons: Array
    """(b, k, 2) convex counter-clockwise polygons in the frames of their owners.

    Polygons with fewer than k corners repeat their last corner."""
    polygon_owners: Indices
    """(b,) rows of the owners: robots, then boxes."""
    discs: Array
    """(d, 3) x, y, radius in the frames of their owners."""
    disc_owners: Indices
    """(d,) rows of the owners."""


def shapes_of(arena: Arena, platforms: Sequence[Platform], *, plane: float | None) -> Shapes:
    """The shapes for one kind of sensor; owner i is the robot of `platforms[i]`, then come boxes.

    `plane`: the height in m of the scan plane; None: all footprints are visible. What a robot shows
    depends on the height of the plane:

    - Up to the top of its body: its footprint.
    - Above, up to its highest point: the housing of its lidar.
    - Higher: nothing.

    Walls, boxes and poles are visible in any plane.
    """
    body_rows: list[int] = []  # robots whose footprint is visible
    housing_rows: list[int] = []  # robots of which only the lidar's housing is visible
    for row, platform in enumerate(platforms):
        if plane is None or plane <= value(platform, "height"):
            body_rows.append(row)
        elif plane <= heights(platform).highest:
            housing_rows.append(row)
    boxes = [box.shape for _, box in arena.movable_boxes]
    box_rows = range(len(platforms), len(platforms) + len(boxes))
    outlines = [*(platforms[row].footprint for row in body_rows), *boxes]
    # `target_radius`: the radius of the housing, the target of other lidars.
    discs = [
        (*platforms[row].scan.offset, value(platforms[row], "target_radius"))
        for row in housing_rows
    ]
    return Shapes(
        walls=arena.surfaces,
        poles=arena.circles,
        polygons=_padded(outlines),
        polygon_owners=np.array([*body_rows, *box_rows], dtype=np.intp),
        discs=np.array(discs, dtype=np.float64).reshape(-1, 3),
        disc_owners=np.array(housing_rows, dtype=np.intp),
    )


def _padded(polygons: Sequence[Array]) -> Array:
    """(b, k, 2) the polygons; a polygon with fewer than k corners repeats its last corner."""
    most = max((len(polygon) for polygon in polygons), default=0)
    padded = [
        np.concatenate((polygon, np.repeat(polygon[-1:], most - len(polygon), axis=0)))
        for polygon in polygons
    ]
    return np.array(padded, dtype=np.float64).reshape(len(polygons), most, 2)


class SortedRays:
    """The rays of a scan in order of bearing, repeated over four revolutions.

    So the rays between two bearings have consecutive indices, also if the bearings are not within
    one revolution. Each array has an element for each index: `number` of the ray in the scan,
    `bearings` in rad, and their `cos` and `sin`. `is_even`: bearings differ by equal steps of
    `step` rad.
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

    def place_of(self, number: int) -> int:
        """The first index of the ray with this number in the scan."""
        return int(np.flatnonzero(self.number == number)[0])


def sweep_order(bearings: Array, sweep: Sweep) -> tuple[Indices, Array]:
    """The rays (n,) in the order in which a sweep measures them, and their times in s."""
    turned = sweep.direction * (bearings - sweep.start)
    # A ray at the start comes first, even if rounding puts it just before the start.
    turned = np.mod(turned + _AT_START, 2.0 * np.pi)
    order = np.argsort(turned, kind="stable")
    return order, sweep.duration / (2.0 * np.pi) * turned[order]


class Lidar:
    """Casts the scans of all sensors of one kind at once."""

    def __init__(self, spec: ScanSpec, shapes: Shapes) -> None:
        if spec.cone > 0.0:
            across = np.linspace(-0.5, 0.5, _RAYS_IN_BEAM) * spec.cone
            spec = replace(spec, bearings=np.add.outer(spec.bearings, across).ravel())
        self._spec = spec
        self._rays = SortedRays(spec.bearings)
        # Surfaces: x and y of the start, x and y from there to the end.
        start = shapes.walls[:, 0]
        end = shapes.walls[:, 1]
        walls = np.concatenate((start, end - start), axis=1)
        farthest_sides = -spec.range_max * np.hypot(walls[:, 2], walls[:, 3])
        corners = shapes.polygons
        self._caster = ray_caster.Caster(
            spec,
            self._rays,
            np.concatenate((walls, farthest_sides[:, None]), axis=1),
            shapes.poles,
            np.concatenate((corners, np.roll(corners, -1, axis=1) - corners), axis=2),
            shapes.polygon_owners,
            shapes.discs,
            shapes.disc_owners,
        )

    def cast(self, poses: Array, observers: Indices) -> Array:
        """Ranges (m, rays) in m of robots `observers` (m,), with all bodies at `poses` (n, 3).

        The range of a beam with a cone is the least of _RAYS_IN_BEAM rays across the cone. A body
        whose pose is NaN is absent. +inf: no return within range_max, -inf: nearer than range_min.
        """
        ranges = np.full((len(observers), len(self._spec.bearings)), np.inf)
        self._caster.cast(poses, np.ascontiguousarray(observers), ranges)
        if self._spec.cone > 0.0:
            ranges = ranges.reshape(len(observers), -1, _RAYS_IN_BEAM).min(axis=2)
        return ranges

    def sweeps(self, ends: Indices, ranges: Array) -> Any:
        """The kernel `Sweeps` of this sensor, which casts scans sector by sector into `ranges`.

        `ends` (steps + 1,): the number of rays that are measured from the begin of a sweep up to
        each of its steps. `ranges` (2 n, rays) in m: two rows for each of n robots.
        """
        sweep = self._spec.sweep
        bearings = self._spec.bearings
        assert sweep is not None
        counts = np.diff(ends, prepend=0)
        start = self._rays.place_of(sweep_order(bearings, sweep)[0][0])
        first = start + ends - counts if sweep.direction > 0.0 else start + 1 - ends
        return ray_caster.Sweeps(self._caster, first % len(bearings), counts, ranges)


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
            self.lidars.append(
                (Lidar(platform.scan, shapes), np.flatnonzero(self._kinds == number))
            )

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

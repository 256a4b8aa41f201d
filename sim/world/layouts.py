"""Layouts: where the robots of a run start, checked to be inside the arena and apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.errors import ConfigError, unknown
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import gaps, radius, transform
from swarmd.values import Array

NAMES = ("row", "paper", "grid", "ring", "random", "list")
_TRIES = 2000
_CORNERS_OF_A_POLE = 16


def parse_layout(text: str, footprints: Sequence[Array], arena: Arena, *, seed: int) -> Array:
    """Start poses (n, 3) x, y in m and yaw in rad, one for each footprint.

    `row:1.0` along y through the middle, `paper:1.0` along y from the middle on (experiment 1),
    `grid:1.0` by spacing, all heading along x; `ring:1.5` by radius, heading inwards;
    `random:0.2` by clearance, seeded; `list:0:0:90,1:0:0` by x, y and heading in degrees.
    ConfigError if it cannot be read, or if a robot would stand in a wall or another robot.
    """
    name, _, rest = text.partition(":")
    n = len(footprints)
    if name == "list":
        poses = _listed(text, rest, n)
    elif name == "random":
        return _random(footprints, arena, _number(text, rest, 0.2), seed)
    elif name in NAMES:
        poses = _regular(name, n, _number(text, rest, 1.5 if name == "ring" else 1.0))
    else:
        raise ConfigError(unknown("layout", name, NAMES))
    floor = _Floor(footprints, arena)
    for index in range(n):
        fault = floor.fault(index, poses)
        if fault:
            raise ConfigError(f"layout {text!r}: robot {index} {fault}; take more space or fewer")
    return poses


def _regular(name: str, n: int, size: float) -> Array:
    index = np.arange(n, dtype=np.float64)
    poses = np.zeros((n, 3))
    if name == "row":
        poses[:, 1] = (index - (n - 1) / 2.0) * size
    elif name == "paper":
        poses[:, 1] = index * size
    elif name == "grid":
        columns = math.ceil(math.sqrt(n))
        rows = math.ceil(n / columns)
        poses[:, 0] = (index // columns - (rows - 1) / 2.0) * size
        poses[:, 1] = (index % columns - (columns - 1) / 2.0) * size
    else:
        angle = 2.0 * math.pi * index / max(n, 1)
        poses[:, 0], poses[:, 1] = size * np.cos(angle), size * np.sin(angle)
        poses[:, 2] = angle - math.pi
    return poses


def _listed(text: str, rest: str, n: int) -> Array:
    rows = [[_number(text, word, math.nan) for word in row.split(":")] for row in rest.split(",")]
    if len(rows) != n or any(len(row) != 3 for row in rows):
        raise ConfigError(f"layout {text!r} has {len(rows)} poses; wanted are {n} of x:y:degrees")
    poses = np.array(rows)
    poses[:, 2] = np.radians(poses[:, 2])
    return poses


def _random(footprints: Sequence[Array], arena: Arena, clearance: float, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    low = np.array([-arena.length / 2.0, -arena.width / 2.0, -math.pi])
    poses = np.zeros((len(footprints), 3))
    floor = _Floor(footprints, arena)
    for index in range(len(footprints)):
        for _ in range(_TRIES):
            poses[index] = rng.uniform(low, -low)
            if not floor.fault(index, poses, clearance):
                break
        else:
            raise ConfigError(
                f"no room for robot {index} of {len(footprints)} with {clearance:g} m around each"
                f" in {arena.length:g}x{arena.width:g} m; take a larger arena or fewer robots"
            )
    return poses


class _Floor:
    """Knows what stands where, to tell what a robot would be too near to."""

    def __init__(self, footprints: Sequence[Array], arena: Arena) -> None:
        self._footprints, self._arena = footprints, arena
        self._reaches = np.array([radius(footprint) for footprint in footprints])
        self._things = [box.corners for box in arena.boxes]
        self._things += [_polygon_around(circle) for circle in arena.circles]

    def fault(self, index: int, poses: Array, clearance: float = 0.0) -> str:
        """What is wrong with the pose of robot `index`, given those before it; empty if nothing."""
        body = transform(self._footprints[index], poses[index])
        inside = np.array([self._arena.length, self._arena.width]) / 2.0 - clearance
        if not np.isfinite(poses[index]).all() or (np.abs(body) >= inside).any():
            return "is not inside the walls"
        if any(float(gaps(body, thing)) <= clearance for thing in self._things):
            return "stands in a box or pole"
        apart = np.hypot(*(poses[:index, :2] - poses[index, :2]).T)
        apart -= self._reaches[:index] + self._reaches[index]
        for other in np.nonzero(apart <= clearance)[0].tolist():
            shape = transform(self._footprints[other], poses[other])
            if float(gaps(body, shape)) <= clearance:
                return f"touches robot {other}"
        return ""


def _polygon_around(circle: Array) -> Array:
    angle = 2.0 * math.pi * np.arange(_CORNERS_OF_A_POLE) / _CORNERS_OF_A_POLE
    reach = circle[2] / math.cos(math.pi / _CORNERS_OF_A_POLE)
    corners: Array = circle[:2] + reach * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return corners


def _number(text: str, word: str, default: float) -> float:
    if not word:
        return default
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"layout {text!r}: {word!r} is no number; wanted is such as row:1.0")
    return value

"""Start layouts of robots, checked to be inside the arena and without overlap."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.random import Generator

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import gaps, radius, transform

NAMES = ("row", "paper", "grid", "ring", "random", "list")
_TRIES = 2000


def parse_layout(text: str, footprints: Sequence[Array], arena: Arena, *, seed: int) -> Array:
    """Start poses (n, 3) x, y in m and yaw in rad, one for each footprint.

    Defaults in m: SPACING 1.0, RADIUS 1.5, CLEARANCE 0.2.

    - `row:SPACING`: along y, centred at the origin, heading along x.
    - `paper:SPACING`: along y from the origin on, heading along x, as in experiment 1 of the paper
      that docs/paper.md reproduces.
    - `grid:SPACING`: heading along x.
    - `ring:RADIUS`: heading inwards.
    - `random:CLEARANCE`: at random by `seed`.
    - `list:X:Y:DEGREES,X:Y:DEGREES,...`: given poses.

    Raises ConfigError for an unknown layout or a robot that overlaps a wall or another robot.
    """
    name, _, argument = text.partition(":")
    n = len(footprints)
    placement = Placement([f"robot {index}" for index in range(n)], footprints, arena)
    try:
        if name == "random":
            clearance = _number(argument, 0.2)
            scatter(placement, range(n), np.random.default_rng(seed), clearance=clearance)
        elif name == "list":
            placement.place_all(range(n), _listed(argument, n))
        elif name in REGULAR:
            size = _number(argument, 1.5 if name == "ring" else 1.0)
            placement.place_all(range(n), REGULAR[name](n, size))
        else:
            raise ConfigError(unknown("layout", name, NAMES))
    except ConfigError as error:
        raise ConfigError(f"layout {text!r}: {error}") from error
    return placement.poses


def row(n: int, spacing: float) -> Array:
    """Poses (n, 3) along y with their middle at the origin, heading along x."""
    poses = np.zeros((n, 3))
    poses[:, 1] = (np.arange(n) - (n - 1) / 2.0) * spacing
    return poses


def paper_row(n: int, spacing: float) -> Array:
    """Poses (n, 3) along y from the origin on, heading along x: experiment 1 of the paper."""
    poses = np.zeros((n, 3))
    poses[:, 1] = np.arange(n) * spacing
    return poses


def grid(n: int, spacing: float) -> Array:
    """Poses (n, 3) in a grid, as square as possible, around the origin, heading along x."""
    columns = max(math.ceil(math.sqrt(n)), 1)
    rows = math.ceil(n / columns)
    index = np.arange(n)
    poses = np.zeros((n, 3))
    poses[:, 0] = (index // columns - (rows - 1) / 2.0) * spacing
    poses[:, 1] = (index % columns - (columns - 1) / 2.0) * spacing
    return poses


def ring(n: int, radius: float) -> Array:
    """Poses (n, 3) on a circle around the origin, heading inwards."""
    angle = 2.0 * math.pi * np.arange(n) / max(n, 1)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), angle - math.pi), axis=-1)


REGULAR: Mapping[str, Callable[[int, float], Array]] = {
    "row": row,
    "paper": paper_row,
    "grid": grid,
    "ring": ring,
}


def moved(poses: Array, center: tuple[float, float], heading: float) -> Array:
    """Poses (n, 3) rotated by `heading` rad around the origin, then shifted to `center`."""
    places = transform(poses[:, :2], np.array([*center, heading]))
    return np.column_stack((places, poses[:, 2] + heading))


class Placement:
    """The robots and obstacles placed so far, against which a new pose is checked.

    `poses` (n, 3) of the robots, NaN for those not yet placed.
    """

    def __init__(self, names: Sequence[str], footprints: Sequence[Array], arena: Arena) -> None:
        self.arena = arena
        self.names = names
        self.poses = np.full((len(names), 3), math.nan)
        self._footprints = footprints
        self._reaches = np.array([radius(footprint) for footprint in footprints])
        self._obstacles = [box.corners for box in arena.boxes if box.is_placed]
        self._obstacles += [pole.corners for pole in arena.poles]
        self._obstacles += [wall.corners for wall in arena.segments]

    def place_all(self, robots: Sequence[int], poses: Array) -> None:
        """Place robots (rows) at `poses` (k, 3); ConfigError if one does not fit."""
        for row, pose in zip(robots, poses, strict=True):
            fault = self.fault(row, pose)
            if fault:
                raise ConfigError(f"{fault}; take more space or fewer robots")
            self.poses[row] = pose

    def fault(self, index: int, pose: Array, clearance: float = 0.0) -> str:
        """Why the robot does not fit at the pose, with its name; empty if it fits."""
        robot = f"{self.names[index]} at ({pose[0]:.3g}, {pose[1]:.3g})"
        body = transform(self._footprints[index], pose)
        inside = np.array([self.arena.length, self.arena.width]) / 2.0 - clearance
        if not np.isfinite(pose).all() or (np.abs(body) >= inside).any():
            return f"{robot} is not inside the walls"
        if any(float(gaps(body, obstacle)) <= clearance for obstacle in self._obstacles):
            return f"{robot} stands in a box, pole or segment"
        # Only robots whose circles are near are compared by their footprints.
        apart = np.hypot(*(self.poses[:, :2] - pose[:2]).T) - self._reaches - self._reaches[index]
        for near in np.nonzero(apart <= clearance)[0].tolist():
            shape = transform(self._footprints[near], self.poses[near])
            if float(gaps(body, shape)) <= clearance:
                return f"{robot} touches {self.names[near]}"
        return ""


def scatter(
    placement: Placement,
    robots: Sequence[int],
    rng: Generator,
    *,
    clearance: float,
    center: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float] | None = None,
    heading: float | None = None,
) -> None:
    """Place the robots (rows) at random within `size` m around `center`, `clearance` m apart.

    The robots are placed in a random order, so that no row has systematically less room. Without
    `size` the robots lie in the whole arena; without `heading` (rad) they have random headings.
    ConfigError if there is no room.
    """
    arena_size = (placement.arena.length, placement.arena.width)
    # A pose (x, y, yaw) is uniform within `middle` +- `half_width`.
    half_width = np.array([*(size or arena_size), 2.0 * math.pi]) / 2.0
    middle = np.array([*(center if size else (0.0, 0.0)), 0.0])

    def candidates() -> Iterator[Array]:
        while True:
            yield _headed(middle + rng.uniform(-half_width, half_width), heading)

    spacing_text = f"{clearance:g} m around each"
    shuffled = rng.permutation(robots).tolist()
    _place_each(placement, shuffled, candidates(), clearance, spacing_text)


def chain(
    placement: Placement,
    robots: Sequence[int],
    rng: Generator,
    *,
    near: float,
    far: float,
    center: tuple[float, float] = (0.0, 0.0),
    heading: float | None = None,
) -> None:
    """Place the robots (rows) so that each is `near` to `far` m from a robot placed before it.

    No two robots are nearer than `near`. The robots are placed in a random order, the first of them
    at `center`. Without `heading` (rad) they have random headings. ConfigError if there is no room.
    """
    robots = rng.permutation(robots).tolist()

    def candidates() -> Iterator[Array]:
        yield _headed(np.array([*center, rng.uniform(-math.pi, math.pi)]), heading)
        while True:
            # `_place_each` sets the pose of a robot once a candidate fits.
            poses = placement.poses[robots]
            placed = poses[np.isfinite(poses[:, 0])]
            if not len(placed):  # the first robot does not fit at `center`: no further candidates
                return
            base = placed[int(rng.integers(len(placed)))][:2]
            distance, angle, yaw = rng.uniform([near, -math.pi, -math.pi], [far, math.pi, math.pi])
            place = base + distance * np.array([math.cos(angle), math.sin(angle)])
            if all(math.dist(place, pose[:2]) >= near for pose in placed):
                yield _headed(np.array([*place, yaw]), heading)

    spacing_text = f"{near:g} to {far:g} m from the nearest"
    _place_each(placement, robots, candidates(), clearance=0.0, spacing_text=spacing_text)


def _place_each(
    placement: Placement,
    robots: Sequence[int],
    candidates: Iterator[Array],
    clearance: float,
    spacing_text: str,
) -> None:
    """Place each robot at the next candidate pose that fits; ConfigError after _TRIES of a robot.

    `spacing_text`: the wanted distances, for the error.
    """
    arena = placement.arena
    for row in robots:
        for _, pose in zip(range(_TRIES), candidates, strict=False):
            if not placement.fault(row, pose, clearance):
                placement.poses[row] = pose
                break
        else:
            raise ConfigError(
                f"no room for {placement.names[row]}, one of {len(robots)}, with {spacing_text} in"
                f" {arena.length:g}x{arena.width:g} m; take more space or fewer robots"
            )


def _headed(pose: Array, heading: float | None) -> Array:
    return pose if heading is None else np.array([pose[0], pose[1], heading])


def _listed(rest: str, n: int) -> Array:
    rows = [[_number(word, math.nan) for word in row.split(":")] for row in rest.split(",")]
    if len(rows) != n or any(len(row) != 3 for row in rows):
        count = len(rows) if rest else 0
        text = f"{count} poses; expected {n} of x:y:degrees, such as list:0:0:90,1:0:0"
        raise ConfigError(f"{text}, or another layout")
    poses = np.array(rows)
    poses[:, 2] = np.radians(poses[:, 2])
    return poses


def _number(word: str, default: float) -> float:
    if not word:
        return default
    value = finite_number(word)
    if math.isnan(value):
        raise ConfigError(f"{word!r} is no number; expected a value such as row:1.0")
    return value

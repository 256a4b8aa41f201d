"""A run from above, painted onto axes: the arena, its obstacles and fields, and the robots.

`trajectories.py` makes figures and legends of them, `film.py` frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.metrics.window import arena_of, presence
from swarmd.sim.plots.theme import ROBOT_COLOURS
from swarmd.sim.trace import Trace
from swarmd.sim.world.floor import FloorField, floor_pixels
from swarmd.sim.world.geometry import radius, transform
from swarmd.sim.world.line_of_sight import LineOfSight
from swarmd.sim.world.scalar_fields import Field, sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection

WALL_COLOUR = "0.3"
FIXED_COLOUR = "0.65"
MOVABLE_BOX_COLOUR = "#C49C6B"
_SMALL_PART = 0.5  # of the arena's longer side
_MAX_STEPS = 100_000  # drawn of all paths together
_MAX_LARGE = 100  # robots with thick outlines


@dataclass(frozen=True, slots=True)
class Extent:
    """The part of the world that is shown, in m."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def width(self) -> float:
        """Along x, in m."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Along y, in m."""
        return self.top - self.bottom

    def panel(self, longest: float) -> tuple[float, float]:
        """Width and height in inches of axes that show it, with the given longer side."""
        scale = longest / max(self.width, self.height)
        return max(self.width * scale, longest / 5.0), max(self.height * scale, longest / 5.0)


def check_drawable(trace: Trace) -> None:
    """Raise SwarmError if the trace holds nothing to draw."""
    if len(trace.t) == 0:
        raise SwarmError("the trace holds no instant: nothing to draw")
    if len(trace.ids) == 0:
        raise SwarmError("the trace holds no robot: nothing to draw")


def extent_of(trace: Trace) -> Extent:
    """The part of the world to show: the arena and all positions of robots and movable boxes.

    If robots and boxes stay in a small part of the arena, only this part is shown, with a margin.
    """
    low, high = _used(trace)
    arena = arena_of(trace)
    if arena is not None:
        half = np.array([arena.length, arena.width]) / 2.0
        around = 0.12 * float(np.max(high - low)) + 0.3
        is_small = float(np.max(high - low)) + 2.0 * around < _SMALL_PART * float(half.max()) * 2.0
        if is_small:
            low = np.maximum(low - around, -half)
            high = np.minimum(high + around, half)
        else:
            low = np.minimum(low, -half)
            high = np.maximum(high, half)
    margin = 0.02 * float(np.max(high - low))
    (left, bottom) = (low - margin).tolist()
    (right, top) = (high + margin).tolist()
    return Extent(left, right, bottom, top)


def cut_note(trace: Trace) -> str:
    """A note that the picture shows a part of the arena; empty if it shows all of it."""
    arena = arena_of(trace)
    extent = extent_of(trace)
    if arena is None or (extent.width >= arena.length and extent.height >= arena.width):
        return ""
    return f"part of an arena of {arena.length:g} m x {arena.width:g} m"


def _used(trace: Trace) -> tuple[Array, Array]:
    """The lower left and the upper right corner (2,) of all positions of robots and boxes."""
    reach = max((radius(shape) for shape in trace.footprints.values()), default=0.1)
    places = trace.pose[..., :2].reshape(-1, 2)
    low = np.nanmin(places, axis=0) - reach
    high = np.nanmax(places, axis=0) + reach
    if trace.box_pose is not None and np.isfinite(trace.box_pose).any():
        boxes = trace.box_pose[..., :2].reshape(-1, 2)
        reach = 0.0 if trace.box_shapes is None else float(np.abs(trace.box_shapes).max())
        low = np.minimum(low, np.nanmin(boxes, axis=0) - reach)
        high = np.maximum(high, np.nanmax(boxes, axis=0) + reach)
    return low, high


def prepare(axes: Axes, extent: Extent) -> None:
    """Show that part of the world, with equal scales of x and y."""
    axes.set_xlim(extent.left, extent.right)
    axes.set_ylim(extent.bottom, extent.top)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=9)


def paint_arena(axes: Axes, trace: Trace) -> None:
    """Paint walls, inner walls, fixed boxes and poles; nothing if the arena is unknown."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Circle

    arena = arena_of(trace)
    if arena is None:
        return
    x = arena.length / 2.0
    y = arena.width / 2.0
    axes.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=WALL_COLOUR, linewidth=2.0, zorder=1.0)
    inner = [((wall.x1, wall.y1), (wall.x2, wall.y2)) for wall in arena.segments]
    axes.add_collection(LineCollection(inner, colors=WALL_COLOUR, linewidth=2.0, zorder=1.0))
    fixed = [box.corners for _, box in arena.named_boxes if box.mass is None]
    axes.add_collection(PolyCollection(fixed, facecolor=FIXED_COLOUR, zorder=1.0))
    for pole in arena.poles:
        axes.add_patch(Circle((pole.x, pole.y), pole.radius, facecolor=FIXED_COLOUR, zorder=1.0))


def paint_movable_boxes(axes: Axes, trace: Trace) -> None:
    """Paint movable boxes: hollow at the start, filled at the end, with their path.

    A box that is not in the arena at the end has only its hollow outline.
    """
    if trace.box_pose is None or trace.box_shapes is None:
        return
    for poses, shape in zip(trace.box_pose.swapaxes(0, 1), trace.box_shapes, strict=True):
        there = np.flatnonzero(np.isfinite(poses).all(axis=1))
        if len(there):
            _paint_movable_box(axes, poses, shape, there)


def _paint_movable_box(axes: Axes, poses: Array, shape: Array, there: NDArray[np.int64]) -> None:
    first = transform(shape, poses[there[0]])
    axes.fill(*first.T, facecolor="none", edgecolor=MOVABLE_BOX_COLOUR, linewidth=1.2, zorder=1.4)
    if there[-1] == len(poses) - 1:
        axes.plot(poses[:, 0], poses[:, 1], color=MOVABLE_BOX_COLOUR, linewidth=1.0, zorder=1.4)
        last = transform(shape, poses[-1])
        axes.fill(*last.T, facecolor=MOVABLE_BOX_COLOUR, edgecolor="0.3", linewidth=0.6, zorder=1.5)


def robot_colour(robot: int) -> str:
    """The colour of a robot; the first ten differ."""
    return ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]


def robot_style(robot: int) -> Literal["-", "--"]:
    """The line style of a robot: solid for the first ten, then dashed."""
    return "-" if robot < len(ROBOT_COLOURS) else "--"


def paint_paths(axes: Axes, trace: Trace, *, linewidth: float = 1.0) -> None:
    """Paint the path of each robot in its colour, dotted while its daemon was absent."""
    is_there = presence(trace)[..., None]
    place = trace.pose[..., :2]
    style: dict[str, Any] = {"linewidth": linewidth, "zorder": 2.0}
    for robot in range(len(trace.ids)):
        colour = robot_colour(robot)
        there = np.where(is_there[:, robot], place[:, robot], np.nan)
        axes.plot(*there.T, color=colour, linestyle=robot_style(robot), **style)
        if not is_there[:, robot].all():
            away = np.where(is_there[:, robot], np.nan, place[:, robot])
            axes.plot(*away.T, color=colour, linestyle=":", alpha=0.6, **style)


def paint_paths_by_time(axes: Axes, trace: Trace, *, linewidth: float = 0.5) -> LineCollection:
    """Paint the paths of many robots, from pale to dark over time; for a colour bar.

    With many robots, positions are thinned.
    """
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap

    t = trace.t
    n = len(trace.ids)
    kept = np.linspace(0, len(t) - 1, min(len(t), max(41, _MAX_STEPS // n))).astype(int)
    place = trace.pose[kept, :, :2]
    steps = np.stack((place[:-1], place[1:]), axis=2).reshape(-1, 2, 2)
    shades = ListedColormap(colormaps["viridis_r"](np.linspace(0.12, 1.0, 256)))
    paths = LineCollection(list(steps), cmap=shades, linewidth=linewidth, zorder=2.0)
    paths.set_array(np.repeat(t[kept[1:]], n))
    paths.set_clim(float(t[0]), max(float(t[-1]), float(t[0]) + 1e-9))
    axes.add_collection(paths, autolim=False)
    return paths


def paint_bodies(
    axes: Axes, trace: Trace, instant: int, colours: Sequence[str], *, is_filled: bool
) -> None:
    """Paint the footprints of all robots at an instant (an index of the trace; -1: the last).

    `colours`: by robot. `is_filled`: footprints in the colour with dark outlines, else outlines in
    the colour. Up to _MAX_LARGE robots also have a line from the axle to the front. A robot whose
    daemon is absent is dotted and pale. At instant 0, a robot whose recording begins later is
    painted at its first known pose.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    is_present, poses = _presence_and_poses(trace, instant)
    is_small = len(trace.ids) > _MAX_LARGE
    present = np.flatnonzero(is_present)
    absent = np.flatnonzero(~is_present)
    for rows, linestyle, alpha in ((present, "-", 1.0), (absent, ":", 0.45)):
        bodies = [(trace.footprint(row), poses[row]) for row in rows.tolist()]
        robot_colours = [colours[row] for row in rows.tolist()]
        style: dict[str, Any] = {
            "linewidths": 0.3 if is_small else 0.9,
            "alpha": alpha,
            "zorder": 4.0 if is_filled else 3.0,
        }
        outlines = PolyCollection(
            [transform(shape, pose) for shape, pose in bodies],
            facecolors=robot_colours if is_filled else "none",
            edgecolors="0.1" if is_filled else robot_colours,
            linestyles=linestyle,
            **style,
        )
        axes.add_collection(outlines, autolim=False)
        if not is_small:
            noses = [_nose(shape, pose) for shape, pose in bodies]
            line_colours = [_ink(c) for c in robot_colours] if is_filled else robot_colours
            axes.add_collection(LineCollection(noses, colors=line_colours, **style), autolim=False)


def _presence_and_poses(trace: Trace, instant: int) -> tuple[NDArray[np.bool_], Array]:
    """Whether the daemon of each robot (n,) is present at an instant, and the poses (n, 3).

    At instant 0, each robot is taken at the first instant with a pose.
    """
    robots = np.arange(len(trace.ids))
    instants = np.full(len(robots), instant)
    if instant == 0:
        has_pose = np.isfinite(trace.pose).all(axis=2)
        instants = has_pose.argmax(axis=0)
    return presence(trace)[instants, robots], trace.pose[instants, robots]


def _ink(colour: str) -> str:
    """A line colour that contrasts: white on dark colours, black on light ones."""
    from matplotlib.colors import to_rgb

    red, green, blue = to_rgb(colour)
    return "white" if 0.30 * red + 0.59 * green + 0.11 * blue < 0.5 else "0.1"


def _nose(footprint: Array, pose: Array) -> Array:
    ahead = float(footprint[:, 0].max())
    return transform(np.array([[0.0, 0.0], [ahead, 0.0]]), pose)


_CELLS = 160  # along the longer side
_LEVELS = 5
_MAP = "YlOrBr"
"""matplotlib's colour map of the shaded field; the pale end is the lowest value."""


def paint_fields(
    axes: Axes, trace: Trace, extent: Extent, fields: Sequence[Field], *, is_small: bool = False
) -> None:
    """Paint the scalar fields of a scenario, such as light, inside the arena if it is known.

    A floor field is painted in its own colours, paler. Any other field has contour lines, which
    have numbers unless `is_small`; the first of these fields is shaded, too. A field with the same
    value everywhere is not painted.
    """
    if not fields:
        return
    arena = arena_of(trace)
    size = (extent.width, extent.height) if arena is None else (arena.length, arena.width)
    _paint_floor(axes, fields, size)
    x, y = _cells(trace, extent)
    # Whether the line between two places crosses no wall or obstacle: these cast shadows of light.
    is_clear = None if arena is None else LineOfSight(arena).is_clear
    contoured = [field for field in fields if not isinstance(field, FloorField)]
    points = np.stack(np.meshgrid(x, y), axis=-1)
    sampled = sample(contoured, points.reshape(-1, 2), is_clear=is_clear)
    for index, (name, values) in enumerate(sampled.items()):
        grid = values.reshape(len(y), len(x))
        if np.ptp(grid) <= 0.0:
            continue
        if index == 0:
            sides = (float(x[0]), float(x[-1]), float(y[0]), float(y[-1]))
            axes.imshow(grid, extent=sides, origin="lower", cmap=_MAP, alpha=0.45, zorder=0.5,
                        interpolation="bilinear", aspect="equal")  # fmt: skip
        style = ("solid", "dashed", "dotted")[index % 3]
        _paint_contours(axes, x, y, grid, style, "" if is_small else name)


def _paint_floor(axes: Axes, fields: Sequence[Field], size: tuple[float, float]) -> None:
    """Paint the colours of floor fields, if any, on an area of `size` (length, width) in m."""
    length, width = size
    pixels = floor_pixels(fields, size)
    if pixels is not None:
        sides = (-length / 2.0, length / 2.0, -width / 2.0, width / 2.0)
        axes.imshow(pixels, extent=sides, alpha=0.45, zorder=0.4, interpolation="nearest",
                    aspect="equal")  # fmt: skip


def _paint_contours(axes: Axes, x: Array, y: Array, grid: Array, style: str, name: str) -> None:
    """Paint the contour lines of a field, with its name and their values; "": without texts."""
    lines = axes.contour(x, y, grid, levels=_LEVELS, colors="0.45", linewidths=0.5, zorder=0.6,
                         linestyles=style)  # fmt: skip
    if name:
        for text in axes.clabel(lines, fontsize=7, fmt=lambda level: f"{name} {level:g}") or ():
            text.set_clip_on(True)


def _cells(trace: Trace, extent: Extent) -> tuple[np.ndarray, np.ndarray]:
    left = extent.left
    right = extent.right
    bottom = extent.bottom
    top = extent.top
    arena = arena_of(trace)
    if arena is not None:
        half_x = arena.length / 2.0
        half_y = arena.width / 2.0
        left = max(left, -half_x)
        right = min(right, half_x)
        bottom = max(bottom, -half_y)
        top = min(top, half_y)
    cell = max(right - left, top - bottom) / _CELLS
    return (
        np.linspace(left, right, max(2, round((right - left) / cell))),
        np.linspace(bottom, top, max(2, round((top - bottom) / cell))),
    )

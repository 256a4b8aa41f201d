"""The scalar fields of a scenario, such as light, painted below a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from swarmd.sim.metrics.window import arena_of
from swarmd.sim.plots.scene import Extent
from swarmd.sim.trace import Trace
from swarmd.sim.world.scalar_fields import Field, sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CELLS = 160  # along the longer side
_LEVELS = 5
_MAPS = ("YlOrBr", "PuBu", "Greens")
"""One of matplotlib's colour maps for each field; the pale end is the lowest value."""


def paint_fields(
    axes: Axes, trace: Trace, extent: Extent, fields: Sequence[Field], *, is_small: bool = False
) -> None:
    """Paint each field as shades with lines of equal value, which have numbers unless `is_small`.

    Within the arena alone, if it is known. The first field of several is shaded, the others have
    lines. A uniform field is not painted.
    """
    if not fields:
        return
    x, y = _cells(trace, extent)
    places = np.stack(np.meshgrid(x, y), axis=-1)
    for index, (name, values) in enumerate(sample(fields, places.reshape(-1, 2)).items()):
        grid = values.reshape(len(y), len(x))
        if np.ptp(grid) <= 0.0:
            continue
        colours = _MAPS[index % len(_MAPS)]
        if index == 0:
            sides = (float(x[0]), float(x[-1]), float(y[0]), float(y[-1]))
            axes.imshow(grid, extent=sides, origin="lower", cmap=colours, alpha=0.45, zorder=0.5,
                        interpolation="bilinear", aspect="equal")  # fmt: skip
        lines = axes.contour(
            x, y, grid, levels=_LEVELS, colors="0.45", linewidths=0.5, zorder=0.6,
            linestyles=("solid", "dashed", "dotted")[index % 3],
        )  # fmt: skip
        if not is_small:
            labels = axes.clabel(
                lines, fontsize=7, fmt=lambda level, name=name: f"{name} {level:g}"
            )
            for text in labels or ():
                text.set_clip_on(True)


def _cells(trace: Trace, extent: Extent) -> tuple[np.ndarray, np.ndarray]:
    left, right, bottom, top = extent.left, extent.right, extent.bottom, extent.top
    arena = arena_of(trace)
    if arena is not None:
        half_x, half_y = arena.length / 2.0, arena.width / 2.0
        left, right = max(left, -half_x), min(right, half_x)
        bottom, top = max(bottom, -half_y), min(top, half_y)
    cell = max(right - left, top - bottom) / _CELLS
    return (
        np.linspace(left, right, max(2, round((right - left) / cell))),
        np.linspace(bottom, top, max(2, round((top - bottom) / cell))),
    )

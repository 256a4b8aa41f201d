"""Pictures of the differences between variants, with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.plots.intervals import grid_of_panels, prepare_rows
from swarmd.sim.plots.theme import GUIDE_COLOUR, NOTE, VARIANT_COLOURS, fit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class DifferencePanel:
    """A metric in a picture: its label, and the difference of each variant from the first."""

    label: str
    unit: str
    of: Mapping[str, Difference]


def differences_figure(
    panels: Sequence[DifferencePanel], title: str = "", *, width: float | None = None
) -> Figure:
    """A picture of the differences of means with their 95 % intervals; filled: 0 is excluded.

    One panel a metric, one row a variant. `width`: in inches, for a paper. SwarmError if there is
    no difference.
    """
    if not panels:
        raise SwarmError("no metric has differences: nothing to draw")
    rows = list(dict.fromkeys(name for panel in panels for name in panel.of))
    figure, grid = grid_of_panels(len(panels), rows, width)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_panel(axes, panel, rows)
    is_paired = any(one.is_paired for panel in panels for one in panel.of.values())
    how = "paired by seed" if is_paired else "independent samples"
    figure.suptitle(title, fontsize=11, gid=NOTE)
    note = f"difference of means with its 95 % interval, {how}; filled: the interval excludes 0"
    figure.supxlabel(note, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _paint_panel(axes: Axes, panel: DifferencePanel, rows: Sequence[str]) -> None:
    prepare_rows(axes, rows)
    axes.axvline(0.0, color=GUIDE_COLOUR, linewidth=1.0, zorder=1.8)
    for row, name in enumerate(rows):
        one = panel.of.get(name)
        if one is None or one.difference is None:
            beside = axes.get_yaxis_transform()
            axes.text(0.5, row, "-" if one is None else one.conclusion, transform=beside,
                      ha="center", va="center", fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
            continue
        colour = VARIANT_COLOURS[(row + 1) % len(VARIANT_COLOURS)]  # the first has none here
        if one.interval is not None:
            axes.plot([one.interval.low, one.interval.high], [row] * 2, color=colour, linewidth=2.0)
        axes.scatter([one.difference], [row], s=34.0, marker="D", zorder=4.0, linewidths=1.2,
                     color=colour if one.differs else "white", edgecolors=colour)  # fmt: skip
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(panel.unit, fontsize=9)

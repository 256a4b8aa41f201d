"""What all pictures share: how a figure is made and kept, and its colours."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.core.errors import ConfigError, SwarmError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
DPI = 130
_PAD = 0.06  # inches around each part of a figure

VARIANT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""For variants of an experiment, in this order: M. Okabe and K. Ito, "Color Universal Design",
2008, but its yellow, which is too pale for a line on white."""

ROBOT_COLOURS = (
    *("#332288", "#CC6677", "#117733", "#88CCEE", "#AA4499", "#999933"),
    *("#44AA99", "#882255", "#DDCC77", "#555555"),
)
"""For robots: P. Tol, "Colour Schemes", technical note SRON/EPS/TN/09-002, the muted scheme, and
a grey, so that ten differ."""

CONTACT_COLOUR = "#CC0000"
GUIDE_COLOUR = "0.35"


def new_figure(width: float, height: float, *, has_layout: bool = True) -> Figure:
    """An empty figure of that size in inches; SwarmError if matplotlib is not installed.

    `has_layout`: axes are placed so that nothing overlaps, rather than where they are told.
    """
    try:
        # Here, since it takes most of a second and nobody else needs it.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ImportError as error:
        raise SwarmError("pictures need matplotlib: pip install 'swarmd[plot]'") from error
    layout = ConstrainedLayoutEngine(w_pad=_PAD, h_pad=_PAD) if has_layout else None
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes) -> None:
    """Only the axes that carry numbers, and a faint grid behind the data."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path) -> Path:
    """Write the figure, which appears whole or not at all; its folder is made if need be.

    ConfigError if the suffix names no format, SwarmError if it cannot be written. The same figure
    gives the same bytes.
    """
    from matplotlib import rc_context

    if path.suffix not in FORMATS:
        raise ConfigError(f"{path}: a picture's name ends in {', '.join(FORMATS)}")
    kind = path.suffix[1:]
    dated = {"svg": "Date", "pdf": "CreationDate"}.get(kind)
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with rc_context({"svg.hashsalt": "swarmd", "svg.fonttype": "none"}):
            figure.savefig(partial, format=kind, dpi=DPI, metadata={dated: None} if dated else None)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise SwarmError(
            f"{path}: the picture cannot be written: {error.strerror or error}; "
            "make room or name another place"
        ) from error
    return path

"""What all pictures share: figures, files and colours."""

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
_PAD = 0.08  # inches around each part of a figure

VARIANT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""For variants of an experiment, in this order: M. Okabe and K. Ito, "Color Universal Design",
2008, without its yellow, which is too pale for a line on white."""

ROBOT_COLOURS = (
    *("#332288", "#CC6677", "#117733", "#88CCEE", "#AA4499", "#999933"),
    *("#44AA99", "#882255", "#DDCC77", "#555555"),
)
"""For robots: P. Tol, "Colour Schemes", technical note SRON/EPS/TN/09-002, the muted scheme, and
a grey, so that ten differ."""

CONTACT_COLOUR = "#CC0000"
GUIDE_COLOUR = "0.35"


def new_figure(width: float, height: float, *, is_map: bool = False) -> Figure:
    """An empty figure of about that size in inches, with matplotlib's constrained layout.

    `is_map`: its axes keep their aspect, and stand close together. SwarmError without matplotlib.
    """
    try:
        # Imported here because it takes most of a second.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ImportError as error:
        raise SwarmError("pictures need matplotlib: pip install 'swarmd[plot]'") from error
    layout = ConstrainedLayoutEngine(w_pad=_PAD, h_pad=_PAD, compress=is_map)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes) -> None:
    """Remove the axes without numbers, and put a faint grid behind the data."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path) -> Path:
    """Write the figure, cropped or enlarged to what is on it. The file appears whole or not at all.

    Missing folders are made. ConfigError if the suffix names no format, SwarmError if the file
    cannot be written. The same figure gives the same bytes.
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
            figure.savefig(
                partial,
                format=kind,
                dpi=DPI,
                bbox_inches="tight",
                pad_inches=_PAD,
                metadata={dated: None} if dated else None,
            )
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise SwarmError(
            f"{path}: the picture cannot be written: {error.strerror or error}; "
            "make room or name another place"
        ) from error
    return path

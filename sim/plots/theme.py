"""The common style of all figures: size, layout, colours and file formats."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import whole_file
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
DPI = 130
_PRINT_DPI = 300
_PAD = 0.08  # inches around each part of a figure
_SMALLEST = 6.0  # points of a text in a paper

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
PALE = {"facecolor": "white", "alpha": 0.7, "pad": 1.0, "linewidth": 0.0}
"""The box behind a text in the data."""


def ignore_settings_of_user() -> None:
    """For a verb, which only writes files: matplotlib without the user's backend and style.

    `$MPLBACKEND` may name a backend that is not installed, and the user's `matplotlibrc` may ask
    for LaTeX; both ended in a traceback. Equal figures have equal bytes for all users. SwarmError
    if matplotlib cannot be imported, such as with a `matplotlibrc` in this folder that is no text.
    """
    os.environ["MPLBACKEND"] = "agg"
    found = find_spec("matplotlib")
    if found is not None and found.origin is not None:
        own = Path(found.origin).parent / "mpl-data" / "matplotlibrc"
        os.environ["MATPLOTLIBRC"] = str(own)
    matplotlib = _imported()
    matplotlib.rcdefaults()  # a matplotlibrc of the working directory counts more than the variable
    matplotlib.use("agg")


def _imported() -> Any:
    """matplotlib; SwarmError if it cannot be imported."""
    try:
        import matplotlib  # takes most of a second
    except ImportError as error:
        raise SwarmError("pictures need matplotlib: pip install 'swarmd[plot]'") from error
    except (ValueError, OSError) as error:  # of $MPLBACKEND, or of a file of the user
        why = " ".join(str(error).split())
        raise SwarmError(
            f"matplotlib cannot be imported: {why}; see $MPLBACKEND, $MATPLOTLIBRC and"
            f" {Path.cwd() / 'matplotlibrc'}"
        ) from error
    return matplotlib


def new_figure(width: float, height: float, *, is_map: bool = False) -> Figure:
    """An empty figure of about that size in inches, with matplotlib's constrained layout.

    `is_map`: its axes keep their aspect, and stand close together. SwarmError without matplotlib.
    """
    _imported()
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ImportError as error:
        raise SwarmError("pictures need matplotlib: pip install 'swarmd[plot]'") from error
    layout = ConstrainedLayoutEngine(w_pad=_PAD, h_pad=_PAD, compress=is_map)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


_STYLES = ("-", "--", ":", "-.")


_SCALE = "viridis"
_LEAST_ORDERED = 3
_LIGHTEST = 0.85  # share of the scale beyond which it is too pale for a line on white


def variant_style(index: int) -> tuple[str, str]:
    """Colour and line style of the variant of that number; the first 28 differ."""
    style = _STYLES[index // len(VARIANT_COLOURS) % len(_STYLES)]
    return VARIANT_COLOURS[index % len(VARIANT_COLOURS)], style


def in_order(names: Iterable[str]) -> list[str]:
    """The names of variants as given; numbers, the values of one swept key, in rising order."""
    values = {name: finite_number(name) for name in names}
    if any(map(math.isnan, values.values())):
        return list(values)
    return sorted(values, key=values.__getitem__)


def variant_styles(names: Sequence[str]) -> list[tuple[str, str]]:
    """Colour and line style of each variant by its name.

    Three or more numbers, which are values of one swept key, have colours of a scale from dark
    (least) to light. Other variants have the colours of `variant_style`.
    """
    values = [finite_number(name) for name in names]
    if len(names) < _LEAST_ORDERED or any(map(math.isnan, values)):
        return [variant_style(index) for index in range(len(names))]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    order = sorted(values)
    last = len(order) - 1
    scale = colormaps[_SCALE]
    return [(to_hex(scale(_LIGHTEST * order.index(value) / last)), "-") for value in values]


NOTE = "note"
"""The gid (matplotlib's mark of an artist) of texts that `fit` removes, since a paper has them in
its caption: titles, and what lines and bands are."""
_PAPER_SCALE = 0.8
"""Texts of 9 and 10 points have 7.2 and 8 points in a paper."""


def fit(figure: Figure, width: float | None) -> Figure:
    """Change the style of `figure` for a paper: small texts, thin lines, no notes; returns it.

    `width`: in inches; the caller has made the figure this wide, and its size stays. None: the
    figure is not for a paper, and nothing changes.
    """
    if width is None:
        return figure
    from matplotlib.collections import Collection, PathCollection
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    # `findobj` returns artists of any type, so `isinstance` tells mypy the type.
    for note in figure.findobj(lambda artist: artist.get_gid() == NOTE):
        if isinstance(note, Text):
            note.set_text("")
    for axes in figure.axes:
        axes.tick_params(labelsize=9 * _PAPER_SCALE, width=0.5)
        for spine in axes.spines.values():
            spine.set_linewidth(0.6)
    for text in figure.findobj(Text):
        if isinstance(text, Text):
            text.set_fontsize(max(_SMALLEST, float(text.get_fontsize()) * _PAPER_SCALE))
    for line in figure.findobj(Line2D):
        if isinstance(line, Line2D):
            line.set_linewidth(float(line.get_linewidth()) * _PAPER_SCALE)
            line.set_markersize(float(line.get_markersize()) * _PAPER_SCALE)
    for collection in figure.findobj(Collection):
        if isinstance(collection, Collection):
            widths = np.atleast_1d(np.asarray(collection.get_linewidth(), dtype=np.float64))
            collection.set_linewidth((widths * _PAPER_SCALE).tolist())
        if isinstance(collection, PathCollection):  # of markers; the sizes are areas
            collection.set_sizes(collection.get_sizes() * _PAPER_SCALE**2)
    return figure


def explained(figure: Figure, title: str, note: str, width: float | None) -> Figure:
    """The figure with a title, and a note below that says what is drawn; see `fit` for `width`."""
    figure.suptitle(title, fontsize=11, gid=NOTE)
    figure.supxlabel(note, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def grid_of(figure: Figure, count: int, rows: int, columns: int, **options: Any) -> list[Axes]:
    """The axes of `count` panels in a grid of rows and columns; places beyond them stay empty.

    `options`: of `Figure.subplots`.
    """
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for axes in grid.flat[count:]:
        axes.remove()
    return list(grid.flat[:count])


def finite(values: Sequence[float | None] | Array) -> Array:
    """The values (n,) that are finite numbers, in order; None is no number."""
    numbers = np.array(values, dtype=np.float64)  # None gives NaN
    known: Array = numbers[np.isfinite(numbers)]
    return known


def tidy(axes: Axes) -> None:
    """Remove the axes without numbers, and put a faint grid behind the data."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path, *, width: float | None = None) -> Path:
    """Write the figure to a file atomically, and make missing folders; returns the path.

    `width`: in inches: the figure is for a paper, so its size stays, and a PNG has the resolution
    of print. None: the picture is cropped or enlarged to the contents of the figure. Equal figures
    give equal bytes. ConfigError if the suffix names no format. SwarmError if the file cannot be
    written.
    """
    from matplotlib import rc_context

    if path.suffix not in FORMATS:
        raise ConfigError(f"{path}: a picture's name ends in {', '.join(FORMATS)}")
    kind = path.suffix[1:]
    date_key = {"svg": "Date", "pdf": "CreationDate"}.get(kind)  # left out, for equal bytes
    options: Any = {
        "svg.hashsalt": "swarmd",  # a fixed salt of the ids in an SVG, for equal bytes
        "svg.fonttype": "none",  # text as text, not as paths
        "pdf.fonttype": 42,  # TrueType: journals refuse matplotlib's default, Type 3
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial, rc_context(options):
            figure.savefig(
                partial,
                format=kind,
                dpi=DPI if width is None else _PRINT_DPI,
                bbox_inches="tight" if width is None else None,
                pad_inches=_PAD,
                metadata={date_key: None} if date_key else None,
            )
    except OSError as error:
        raise SwarmError(
            f"{path}: the picture cannot be written: {error.strerror or error}; "
            "make room or name another place"
        ) from error
    return path

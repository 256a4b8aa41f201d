"""Maps laid out on a figure to the hundredth of an inch.

The layout engines of matplotlib take axes of fixed aspect for larger than they will be, and then
let titles and labels run into them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmd.sim.plots.theme import GUIDE_COLOUR, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINE = 0.2  # inches a line of a title or legend
_EDGE = 0.08
_NOTE_CHARACTER = 0.066


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Maps of `width` times `height` inches in `rows` and `columns`, and the room around them.

    `left`, `right`, `bottom` and `top` are around all of them, the title's own room aside;
    `across` and `down` between two.
    """

    width: float
    height: float
    rows: int = 1
    columns: int = 1
    left: float = 0.75
    right: float = 0.2
    bottom: float = 0.6
    top: float = 0.0
    across: float = 0.0
    down: float = 0.0


class Sheet:
    """A figure with its maps, row by row from the upper left, and a title above them."""

    def __init__(
        self, layout: Layout, title: str, *, least_height: float = 0.0, note: str = ""
    ) -> None:
        """`title` may have several lines; `note` are small words below all.

        `least_height` in inches is for what stands aside.
        """
        lines = title.splitlines()
        self._layout = layout
        above = layout.top + 2.0 * _EDGE + _LINE * len(lines)
        self._right = layout.left + self._step_x * layout.columns - layout.across
        self._top = layout.bottom + self._step_y * layout.rows - layout.down
        tall = max(self._top + above, least_height)
        words = _title_width(lines), 0.2 + _NOTE_CHARACTER * len(note)
        wide = max(self._right + layout.right, *words)
        self._x = (wide - self._right - layout.right) / 2.0
        self._y = (tall - self._top - above) / 2.0
        self.width, self.height = wide, tall
        self.figure: Figure = new_figure(wide, tall, has_layout=False)
        self.figure.suptitle(title, fontsize=11, y=1.0 - _EDGE / tall, va="top")
        self.figure.text(0.5, _EDGE / tall, note, ha="center", va="bottom", fontsize=8,
                         color=GUIDE_COLOUR)  # fmt: skip

    @property
    def _step_x(self) -> float:
        return self._layout.width + self._layout.across

    @property
    def _step_y(self) -> float:
        return self._layout.height + self._layout.down

    def map(self, row: int = 0, column: int = 0) -> Axes:
        """New axes at that place."""
        layout = self._layout
        left = self._x + layout.left + column * self._step_x
        bottom = self._y + self._top - layout.height - row * self._step_y
        return self._axes(left, bottom, layout.width, layout.height)

    def bar_axes(self) -> Axes:
        """New axes to the right of the maps, for a colour bar."""
        height = 0.7 * self._layout.height
        middle = self._y + (self._layout.bottom + self._top) / 2.0
        return self._axes(self._x + self._right + 0.2, middle - height / 2.0, 0.15, height)

    def legend_aside(self, entries: Sequence[tuple[Any, str]]) -> None:
        """Handles and labels in the room to the right."""
        handles, labels = zip(*entries, strict=True)
        at = (self._x + self._right + 0.1) / self.width, 0.5
        self.figure.legend(handles, labels, loc="center left", bbox_to_anchor=at, frameon=False,
                           fontsize=9)  # fmt: skip

    def legend_below(self, entries: Sequence[tuple[Any, str]], columns: int) -> None:
        """Handles and labels in the room below."""
        handles, labels = zip(*entries, strict=True)
        self.figure.legend(handles, labels, loc="lower center", ncols=columns, frameon=False,
                           bbox_to_anchor=(0.5, _EDGE / self.height), fontsize=9)  # fmt: skip

    def _axes(self, left: float, bottom: float, width: float, height: float) -> Axes:
        w, h = self.width, self.height
        return self.figure.add_axes((left / w, bottom / h, width / w, height / h))


def legend_width(entries: Sequence[tuple[Any, str]]) -> float:
    """Inches that a legend of one column takes at most."""
    return 0.75 + 0.068 * max(len(label) for _, label in entries)


def legend_height(lines: int) -> float:
    """Inches that so many lines of a legend take."""
    return 0.2 + _LINE * lines


def _title_width(lines: Sequence[str]) -> float:
    return 0.3 + 0.092 * max((len(line) for line in lines), default=0)

"""Maps are where they are told to be, with room around them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from swarmd.sim.plots.sheet import Layout, Sheet, legend_height

if TYPE_CHECKING:
    from tests.sim.plots.conftest import Cut

pytest.importorskip("matplotlib")

LAYOUT = Layout(width=3.0, height=2.0, rows=2, columns=2, across=0.5, down=0.25)


def test_the_figure_is_as_large_as_its_parts() -> None:
    sheet = Sheet(LAYOUT, "two\nlines")
    assert sheet.width == pytest.approx(0.75 + 6.5 + 0.2)
    assert sheet.height == pytest.approx(0.6 + 4.25 + 0.16 + 0.4)
    assert tuple(sheet.figure.get_size_inches()) == pytest.approx((sheet.width, sheet.height))


def test_maps_go_row_by_row_from_the_upper_left() -> None:
    sheet = Sheet(LAYOUT, "x")
    size = sheet.width, sheet.height
    first, last = (sheet.map(*at).get_position() for at in ((0, 0), (1, 1)))
    assert (first.x0 * size[0], first.y0 * size[1]) == pytest.approx((0.75, 0.6 + 2.25))
    assert (last.x0 * size[0], last.y0 * size[1]) == pytest.approx((0.75 + 3.5, 0.6))
    assert (last.width * size[0], last.height * size[1]) == pytest.approx((3.0, 2.0))


def test_a_long_title_and_a_long_legend_make_the_figure_larger(cut_off: Cut) -> None:
    from matplotlib.lines import Line2D

    layout = Layout(width=1.0, height=1.0, right=1.5)
    entries = [(Line2D([], []), f"robot {k}") for k in range(30)]
    sheet = Sheet(layout, "a title that is wider than all maps\n" * 2,
                  least_height=legend_height(30))  # fmt: skip
    sheet.map()
    sheet.legend_aside(entries)
    assert cut_off(sheet.figure) == []
    place = sheet.figure.axes[0].get_position()
    assert place.height * sheet.height == pytest.approx(1.0)


def test_words_that_are_cut_off_are_found(cut_off: Cut) -> None:
    sheet = Sheet(LAYOUT, "x")
    sheet.figure.text(0.99, 0.5, "too far to the right")
    assert cut_off(sheet.figure) == ["too far to the right"]

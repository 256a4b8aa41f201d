"""Differences between variants with their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import Interval
from swarmd.sim.plots.intervals import DifferencePanel, differences_figure

pytest.importorskip("matplotlib")


def difference(low: float, high: float) -> Difference:
    middle = (low + high) / 2.0
    return Difference("m", "m", 5, 5, difference=middle, interval=Interval(low, high))


PANEL = DifferencePanel(
    "minimum gap",
    "m",
    {
        "b - a": difference(0.1, 0.3),
        "c - a": difference(-0.1, 0.3),
        "d - a": Difference("m", "m", 5, 5, never_a=1, never_b=2),
    },
)


def test_a_row_a_variant_filled_where_0_is_excluded() -> None:
    (axes,) = differences_figure([PANEL]).axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["b - a", "c - a", "d - a"]
    bars = [line.get_xdata() for line in axes.lines[1:]]
    assert [list(bar) for bar in bars] == [[0.1, 0.3], [-0.1, 0.3]]  # type: ignore[arg-type]
    faces = [np.array(found.get_facecolor()).ravel()[:3] for found in axes.collections]
    assert [bool((face == 1.0).all()) for face in faces] == [False, True]
    assert any("never: 1 of 6, 2 of 7" in text.get_text() for text in axes.texts)

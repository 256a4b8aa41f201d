"""Metrics run by run, with means and their intervals, and differences between variants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import Interval, mean_interval, wilson
from swarmd.sim.plots.intervals import (
    DifferencePanel,
    Panel,
    curve_figure,
    differences_figure,
    intervals_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

pytest.importorskip("matplotlib")

VALUES = (0.5, 0.7, 0.6, 0.9)


def bars(axes: Axes) -> list[list[float]]:
    return [[float(x) for x in np.asarray(line.get_xdata())] for line in axes.lines]


def test_points_mean_and_interval_are_drawn() -> None:
    axes = intervals_figure([Panel(label="gap", unit="m", values={"a": VALUES})]).axes[0]
    points, mean = (np.asarray(dots.get_offsets()) for dots in axes.collections)
    assert points[:, 0].tolist() == list(VALUES)
    assert mean[0, 0] == pytest.approx(np.mean(VALUES))
    assert mean[0, 1] < points[:, 1].min()
    interval = mean_interval(np.array(VALUES))
    assert interval is not None
    assert bars(axes) == [[interval.low, interval.high]]
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("gap", "m")


def test_values_of_0_and_1_have_wilsons_interval() -> None:
    values = {"a": (1.0, 1.0, 1.0)}
    axes = intervals_figure([Panel(label="x", values=values, is_share=True)]).axes[0]
    assert bars(axes) == [[wilson(3, 3).low, 1.0]]
    assert axes.get_xlabel() == "share of runs"
    assert axes.get_xlim() == (-0.05, 1.05)


def test_a_row_a_variant_and_a_panel_a_metric() -> None:
    panels = [Panel(label=f"m{k}", values={"a": VALUES, "b": VALUES}) for k in range(4)]
    figure = intervals_figure(panels)
    assert len(figure.axes) == 4
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == ["a (n = 4)", "b (n = 4)"]
    colours = {
        tuple(np.asarray(dots.get_facecolor())[0, :3]) for dots in figure.axes[0].collections
    }
    assert len(colours) == 2


def test_runs_without_a_value_are_counted() -> None:
    values = {"a": (1.0, None, float("nan"), 2.0), "b": (None, None)}
    axes = intervals_figure([Panel(label="x", values=values)]).axes[0]
    assert [text.get_text() for text in axes.texts] == ["2 without", "no value"]


def test_a_variant_that_one_metric_lacks_keeps_its_row() -> None:
    panels = [
        Panel(label="x", values={"a": VALUES, "b": VALUES}),
        Panel(label="y", values={"b": VALUES}),
    ]
    axes = intervals_figure(panels).axes[1]
    assert np.asarray(axes.collections[-1].get_offsets())[0, 1] == pytest.approx(1 - 0.22)


def test_one_value_has_no_interval() -> None:
    axes = intervals_figure([Panel(label="x", values={"a": (0.3,)})]).axes[0]
    assert bars(axes) == []
    assert len(axes.collections) == 2


@pytest.mark.parametrize(("values", "tick"), [((7.0, 7.0), "7"), ((0.0132, 0.0132001), "0.0132")])
def test_values_that_hardly_differ_have_one_tick(values: tuple[float, float], tick: str) -> None:
    axes = intervals_figure([Panel(label="x", values={"a": values})]).axes[0]
    assert axes.get_xlim() == pytest.approx((values[0] - 1.0, values[0] + 1.0), abs=1e-3)
    assert [text.get_text() for text in axes.get_xticklabels()] == [tick]


def test_a_target_is_a_labelled_line() -> None:
    axes = intervals_figure([Panel(label="x", unit="m", values={"a": (1.0,)}, target=0.65)]).axes[0]
    assert bars(axes) == [[0.65, 0.65]]
    assert axes.get_xlabel() == "m, target 0.65"


def test_counts_are_counted_in_whole_numbers() -> None:
    axes = intervals_figure([Panel(label="x", values={"a": (0.0, 1.0, 2.0)})]).axes[0]
    assert all(float(tick).is_integer() for tick in axes.get_xticks())


def test_times_that_some_runs_never_reached_have_a_median() -> None:
    values = {"a": (1.0, 2.0, 9.0, None), "b": (None, None)}
    panel = Panel(label="gather time", unit="s", values=values, is_time_to_event=True)
    axes = intervals_figure([panel]).axes[0]
    assert [text.get_text() for text in axes.texts] == ["1 of 4 never", "2 of 2 never"]
    assert np.asarray(axes.collections[1].get_offsets())[0, 0] == 5.5
    assert bars(axes) == []


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
    assert [text.get_text() for text in axes.texts] == ["-"]


def test_rows_are_values_of_the_axis_that_is_named() -> None:
    for figure in (
        differences_figure([PANEL], axis="lidar range [m]"),
        intervals_figure([Panel(label="a", values={"1": [1.0, 2.0]})], axis="lidar range [m]"),
    ):
        assert figure.axes[0].get_ylabel() == "lidar range [m]"


@pytest.mark.parametrize(
    ("names", "places", "note"),
    [
        (("0.5", "1.0", "2.0"), [0.0, 1.0, 3.0], ""),
        (("1", "10", "100"), [0.0, 1.0, 2.0], ", on a log scale"),
        (("0", "1", "100"), [0.0, 1.0, 2.0], ""),  # too far apart, and 0 has no logarithm
        (("a", "b", "c"), [0.0, 1.0, 2.0], ""),
    ],
)
def test_rows_of_numbers_stand_at_their_value(
    names: tuple[str, ...], places: list[float], note: str
) -> None:
    panel = Panel(label="x", values=dict.fromkeys(names, VALUES))
    axes = intervals_figure([panel], axis="range [m]").axes[0]
    assert axes.get_yticks() == pytest.approx(places)
    assert axes.get_ylabel() == f"range [m]{note}"
    drawn = [float(np.asarray(line.get_ydata())[0]) for line in axes.lines]
    assert drawn == pytest.approx(np.array(places) - 0.22)


def test_rows_of_differences_stand_at_the_value_of_the_variant() -> None:
    of = {f"{value} - 0.5": difference(0.1, 0.3) for value in ("1.0", "1.5", "2.5")}
    (axes,) = differences_figure([DifferencePanel("gap", "m", of)]).axes
    assert axes.get_yticks() == pytest.approx([0.0, 1.0, 3.0])


def test_panels_of_one_quantity_share_an_axis() -> None:
    panels = [
        Panel(label="gap late", quantity="gap", unit="m", values={"a": (1.0, 2.5)}),
        Panel(label="gap end", quantity="gap", unit="m", values={"a": (7.0, 7.0)}),
        Panel(label="speed", quantity="speed", unit="m/s", values={"a": (0.1, 0.2)}),
    ]
    late, end, speed = (axes.get_xlim() for axes in intervals_figure(panels).axes)
    assert late == end != speed
    assert late[0] <= 1.0
    assert late[1] >= 7.0


def test_a_curve_joins_the_means_over_the_values() -> None:
    values = {"2.0": (1.0, 3.0), "0.5": (0.0, 1.0), "1.0": (1.0, 2.0)}
    panel = Panel(label="gap", unit="m", values=values, target=1.5)
    axes = curve_figure([panel], axis="range [m]").axes[0]
    curve = max((np.asarray(line.get_xydata()) for line in axes.lines), key=len)
    assert curve.tolist() == [[0.5, 0.5], [1.0, 1.5], [2.0, 2.0]]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("range [m]", "m")
    bars = [xs for line in axes.lines if len(xs := np.asarray(line.get_xdata()).tolist()) == 2]
    assert bars[:3] == [[0.5, 0.5], [1.0, 1.0], [2.0, 2.0]]


@pytest.mark.parametrize("names", [("a", "b"), ("1.0",)])
def test_a_curve_needs_values_of_a_number(names: tuple[str, ...]) -> None:
    with pytest.raises(SwarmError, match="swept number"):
        curve_figure([Panel(label="x", values=dict.fromkeys(names, VALUES))])


def test_curves_of_one_quantity_share_an_axis() -> None:
    runs = {"late": (1.0, 2.5), "end": (7.0, 9.0)}
    panels = [
        Panel(label=name, quantity="gap", values={"1": values, "2": values})
        for name, values in runs.items()
    ]
    late, end = (axes.get_ylim() for axes in curve_figure(panels).axes)
    assert late == end

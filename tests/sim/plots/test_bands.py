"""Metrics over time, as bands over the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from swarmd.sim.experiments.statistics import wilson
from swarmd.sim.plots.bands import (
    MAX_INSTANTS,
    Series,
    bands_of,
    is_yes_or_no,
    series_figure,
    shares_of,
    smoothed,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")

T = np.arange(5.0)


def runs(count: int, offset: float = 0.0) -> list[Series]:
    t = np.arange(50) / 10.0
    rng = np.random.default_rng(count)
    return [(t, offset + rng.normal(size=50)) for _ in range(count)]


def drawn(groups: Mapping[str, Sequence[Series]], **options: Any) -> Figure:
    """The figure of one panel."""
    return series_figure({"": groups}, **options)


def note(figure: Figure) -> str:
    return figure.axes[0].get_title(loc="right")


@pytest.mark.parametrize(
    ("variants", "count", "bands", "says"),
    [
        (1, 1, 0, "one run"),
        (2, 1, 0, "one run each"),
        (1, 2, 1, "line: median, bands: all of the runs, n = 2"),
        (1, 5, 2, "line: median, bands: 50 % and all of the runs, n = 5"),
        (2, 20, 4, "line: median, bands: 50 % and 95 % of the runs"),
        (5, 20, 5, "line: median, bands: 50 % of the runs"),
        (9, 20, 0, "line: median"),
    ],
)
def test_few_variants_have_more_bands(variants: int, count: int, bands: int, says: str) -> None:
    figure = drawn({f"v{k}": runs(count) for k in range(variants)}, label="gap")
    assert len(figure.axes[0].lines) == variants
    assert len(figure.axes[0].collections) == bands
    assert note(figure) == says


def test_four_variants_have_a_panel_each_with_all_bands_and_the_others_in_grey() -> None:
    groups = {f"0.{k}": runs(20) for k in range(4)}
    figure = drawn(groups, label="gap", legend_title="spacing [m]")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == [f"spacing [m] 0.{k} (n = 20)" for k in range(4)]
    for axes in figure.axes:
        assert (len(axes.lines), len(axes.collections)) == (5, 2)
        assert [line.get_color() for line in axes.lines[:4]] == ["0.8"] * 4
    assert len({axes.lines[4].get_color() for axes in figure.axes}) == 4
    assert figure.legends == []
    assert len(drawn(groups, label="gap", width=3.5).axes) == 1  # a column of a paper


def test_the_legend_counts_the_runs() -> None:
    figure = drawn({"law=ours": runs(3), "none": [], "law=paper": runs(20)}, label="gap")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["law=ours (n = 3)", "law=paper (n = 20)"]
    assert drawn({"one": runs(3)}, label="gap").legends == []


def test_no_two_of_twenty_variants_look_alike() -> None:
    figure = drawn({f"v{k}": runs(2) for k in range(20)}, label="gap")
    looks = {(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert len(looks) == 20


def test_values_of_0_and_1_are_drawn_as_a_share_of_the_runs() -> None:
    t = np.arange(3.0)
    figure = drawn(
        {"a": [(t, np.array([0.0, 1.0, 1.0])), (t, np.array([0.0, 0.0, 1.0]))]},
        label="one cluster", unit="0 or 1",
    )  # fmt: skip
    axes = figure.axes[0]
    assert axes.get_ylabel() == "one cluster: share of runs"
    assert np.asarray(axes.lines[0].get_ydata()).tolist() == [0.0, 0.5, 1.0]
    assert note(figure) == "share of the runs, band: its 95 % interval, n = 2"


def test_target_and_events_are_labelled_lines() -> None:
    figure = drawn({"a": runs(3)}, label="gap", unit="m", target=0.5,
                           events=((1.0, "kill r1"), (2.0, "place")))  # fmt: skip
    axes = figure.axes[0]
    assert axes.get_ylabel() == "gap [m]"
    assert len(axes.lines) == 4
    assert [text.get_text() for text in axes.texts] == ["target 0.5", "kill r1", "place"]


def test_smoothing_is_stated() -> None:
    rough, smooth = (drawn({"a": runs(3)}, label="duty", smoothing=s) for s in (0.0, 2.0))
    assert note(smooth).endswith("; running mean over 2 s")
    spans = [np.ptp(figure.axes[0].lines[0].get_ydata()) for figure in (rough, smooth)]
    assert spans[1] < spans[0] / 2.0


def test_counts_have_whole_ticks_and_steps() -> None:
    steps = (T, np.array([1.0, 1.0, 2.0, 2.0, 2.0]))
    late = (np.array([0.0, 2.5, 4.0]), np.array([1.0, 2.0, 2.0]))
    axes = drawn({"a": [steps, late]}, label="clusters").axes[0]
    assert all(float(tick).is_integer() for tick in axes.get_yticks())
    assert set(np.asarray(axes.lines[0].get_ydata())) <= {1.0, 1.5, 2.0}


def constant(value: float) -> Series:
    return T, np.full(5, value)


def test_the_inner_band_holds_half_of_the_runs() -> None:
    bands = bands_of([constant(value) for value in (1.0, 2.0, 3.0, 4.0, 50.0)])
    assert bands.inner is not None
    assert bands.outer is not None
    ends = [float(row[2]) for row in (*bands.outer, *bands.inner, bands.middle)]
    assert ends == [1.0, 50.0, 2.0, 4.0, 3.0]
    assert np.array_equal(bands.t, T)


def test_from_twenty_runs_on_the_outer_band_holds_95_percent() -> None:
    runs = [constant(float(value)) for value in range(41)]
    outer = bands_of(runs).outer
    assert outer is not None
    assert (outer[0][0], outer[1][0]) == (1.0, 39.0)


def test_a_run_has_no_value_after_its_end() -> None:
    bands = bands_of([constant(0.0), (T[:3], np.full(3, 1.0))])
    assert bands.middle[1] == 0.5
    assert bands.middle[-1] == 0.0


def test_runs_of_other_instants_are_interpolated() -> None:
    bands = bands_of([(T, T / 8.0), (np.array([0.0, 4.0]), np.array([0.0, 0.5]))])
    assert bands.middle == pytest.approx(bands.t / 8.0)
    assert len(bands.t) == 5


def test_values_that_are_not_finite_are_left_out() -> None:
    hole = (T, np.array([1.0, np.nan, np.inf, 1.0, 1.0]))
    assert bands_of([hole, constant(3.0)]).middle.tolist() == [2.0, 3.0, 3.0, 2.0, 2.0]
    assert np.isnan(bands_of([hole]).middle[1:3]).all()


def test_runs_without_any_value_have_no_band() -> None:
    empty = np.zeros(0), np.zeros(0)
    assert np.isnan(bands_of([constant(np.nan)]).middle).all()
    assert bands_of([empty, constant(1.0)]).middle.tolist() == [1.0] * 5
    assert np.isnan(shares_of([constant(np.nan)]).middle).all()
    assert shares_of([empty, constant(1.0)]).middle.tolist() == [1.0] * 5


def test_long_runs_are_thinned() -> None:
    t = np.arange(10_000) / 10.0
    bands = bands_of([(t, t)])
    assert len(bands.t) == MAX_INSTANTS
    assert bands.t[-1] == t[-1]


def test_a_share_has_wilsons_interval_and_keeps_its_steps() -> None:
    step = (T, np.array([0.0, 0.0, 1.0, 1.0, 1.0]))
    shares = shares_of([step, constant(0.0), constant(1.0), (T[:2], np.ones(2))])
    assert shares.middle.tolist() == [0.5, 0.5, 2 / 3, 2 / 3, 2 / 3]
    assert shares.outer is not None
    interval = wilson(2, 3)
    assert (shares.outer[0][-1], shares.outer[1][-1]) == (interval.low, interval.high)
    late = np.array([0.0, 1.5, 4.0]), np.array([0.0, 1.0, 1.0])
    assert set(shares_of([late, step]).middle) <= {0.0, 0.5, 1.0}


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        ([constant(0.0), constant(1.0)], True),
        ([constant(np.nan), constant(1.0)], True),
        ([constant(0.5)], False),
        ([constant(np.nan)], False),
        ([], False),
    ],
)
def test_series_of_0_and_1_are_recognised(runs: list[Series], expected: bool) -> None:
    assert is_yes_or_no(runs) is expected


def test_a_running_mean_is_taken_around_each_instant() -> None:
    t, values = smoothed((T, np.array([0.0, 3.0, 6.0, np.nan, 0.0])), 2.0)
    assert np.array_equal(t, T)
    assert values[:3].tolist() == [1.5, 3.0, 4.5]
    assert np.isnan(values[3])
    assert values[4] == 0.0

"""Every figure with much and with little in it: no two texts overlap, and it is a picture."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import Interval, summarize
from swarmd.sim.plots.bands import Series, bands_of, series_figure, shares_of
from swarmd.sim.plots.intervals import (
    DifferencePanel,
    Panel,
    curve_figure,
    differences_figure,
    intervals_figure,
)
from swarmd.sim.plots.survival import Times, survival_curve, survival_figure
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import overview_figure, trajectories_figure
from tests.sim.plots.runs import full, overlaps, walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")

Make: TypeAlias = "Callable[[], Figure]"
TITLE = "paper_exp1_hardware, law=paper,lidar_visibility=real, seed 519\nleast typical run"
LABEL = "mean distance to centroid late"
RNG = np.random.default_rng(1)


def variants(count: int) -> list[str]:
    return [f"law=paper,lidar_visibility=real,W={k}" for k in range(count)]


def bands(count: int) -> Figure:
    runs: list[Series] = [(np.arange(50) / 10.0, RNG.normal(size=50)) for _ in range(20)]
    groups = dict.fromkeys(variants(count), runs)
    return series_figure(
        {"": groups}, label=LABEL, unit="m", target=1.0, title="paper_exp1_hardware", smoothing=2.0
    )


def intervals(metrics: int, count: int) -> Figure:
    panel = Panel(label=LABEL, unit="m", values=dict.fromkeys(variants(count), (0.5, 0.7, 0.9)))
    return intervals_figure([panel] * metrics, "paper_exp1_hardware")


def curve(width: float | None) -> Figure:
    panel = Panel(label=LABEL, unit="m", values=dict.fromkeys(("0.1", "1", "10"), (0.5, 0.7, 0.9)))
    return curve_figure([panel] * 4, "paper_exp1_hardware", width=width, axis="lidar range [m]")


def differences() -> Figure:
    found = Difference("m", "m", 5, 5, difference=0.2, interval=Interval(0.1, 0.3))
    never = Difference("m", "m", 5, 5, never_a=1, never_b=2)
    panel = DifferencePanel("minimum gap", "m", {"b - a": found, "d - a": never})
    return differences_figure([panel] * 4, "gathering", width=3.5)


def survival(width: float | None) -> Figure:
    times = {f"law={law}": Times(RNG.exponential(30.0, 9), np.full(9, 500.0)) for law in "ab"}
    facets = {f"count={count}": times for count in (5, 10)}
    figure = survival_figure(facets, event="gathering", title="aggregation", width=width)
    assert width is None or figure.get_figwidth() == width
    return figure


def overview(runs: int, n: int) -> Figure:
    trace = walk(n)
    loads = [(f"seed {k}: 0.123 m", lambda: trace) for k in range(runs)]
    return overview_figure(loads, "paper_exp1_hardware", note=LABEL)


def trajectories(n: int, arena: str = "") -> Figure:
    trace = full(n)
    ids = tuple(f"{robot}-waffle_pi-WWW" for robot in trace.ids)
    meta = {**trace.meta, "arena": arena or trace.meta["arena"]}
    return trajectories_figure(replace(trace, ids=ids, meta=meta), TITLE)


@pytest.mark.short_rows(3)
@pytest.mark.parametrize(
    "make",
    [
        pytest.param(lambda: bands(2), id="bands of two variants"),
        pytest.param(lambda: bands(12), id="bands of twelve variants"),
        pytest.param(lambda: intervals(9, 2), id="intervals of many metrics"),
        pytest.param(lambda: intervals(2, 12), id="intervals of many variants"),
        pytest.param(lambda: intervals(12, 1), id="intervals of one variant"),
        pytest.param(lambda: curve(None), id="curves"),
        pytest.param(lambda: curve(3.5), id="curves in a column"),
        pytest.param(differences, id="differences in a column"),
        pytest.param(lambda: survival(None), id="survival"),
        pytest.param(lambda: survival(3.5), id="survival in a column"),
        pytest.param(lambda: overview(1, 7), id="overview of one run"),
        pytest.param(lambda: overview(9, 7), id="overview of many runs"),
        pytest.param(lambda: overview(4, 200), id="overview of many robots"),
        pytest.param(lambda: trajectories(2), id="trajectories of two robots"),
        pytest.param(lambda: trajectories(20), id="trajectories with names"),
        pytest.param(lambda: trajectories(200), id="trajectories by time"),
        pytest.param(lambda: trajectories(7, "90x90"), id="trajectories in a large arena"),
        pytest.param(lambda: trajectories(7, "3x9"), id="trajectories in a narrow arena"),
    ],
)
def test_no_texts_overlap(make: Make) -> None:
    assert overlaps(make()) == []


@pytest.mark.parametrize(
    "make",
    [
        lambda: trajectories_figure(walk(1, 1)),
        lambda: trajectories_figure(walk(30, 1)),
    ],
)
def test_one_instant_is_a_picture(make: Make, tmp_path: Path) -> None:
    save(make(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 5_000


# Each interval of a table is painted, over its whole range.

TIMES = {
    "all had it": Times(np.array([3.0, 5.0, 5.0, 8.0, 20.0]), np.full(5, 60.0)),
    "some had it": Times(np.array([4.0, np.nan, 9.0, np.nan]), np.array([60.0, 7.0, 60.0, 30.0])),
    "one run": Times(np.array([6.0]), np.full(1, 60.0)),
}


def painted(figure: Figure, at: float) -> list[tuple[float, float]]:
    """The lower and the upper ends of the bands of the first panel over a place of its axis."""
    found = []
    for band in figure.axes[0].collections:
        for path in band.get_paths():
            corners = np.asarray(path.vertices)
            x, y = corners[:, 0], corners[:, 1]
            cuts = [
                y[k] + (at - x[k]) / (x[k + 1] - x[k]) * (y[k + 1] - y[k])
                for k in range(len(x) - 1)
                if min(x[k], x[k + 1]) < at < max(x[k], x[k + 1])
            ]
            if cuts:
                found.append((min(cuts), max(cuts)))
    return found


@pytest.mark.parametrize("name", TIMES)
def test_a_survival_figure_paints_each_interval_of_its_table(name: str) -> None:
    curve = survival_curve(TIMES[name])
    figure = survival_figure({"": {"": TIMES[name]}}, event="gathering")
    for k, (begin, end) in enumerate(itertools.pairwise(curve.t)):
        for at in (begin + 0.01, 0.5 * (begin + end), end - 0.01):
            wanted = (curve.low[k], curve.high[k])
            expected = [pytest.approx(wanted)] if np.isfinite(wanted).all() else []
            assert painted(figure, at) == expected, (k, at)
    assert figure.axes[0].get_xlim() == (0.0, curve.t[-1])
    assert figure.axes[0].get_ylabel() == "share of runs without gathering"


@pytest.mark.parametrize("is_share", [True, False])
def test_a_figure_over_time_paints_each_interval_of_its_table(*, is_share: bool) -> None:
    t, rng = np.arange(12.0), np.random.default_rng(3)
    values = rng.normal(size=(24, 12)) if not is_share else 1.0 * (rng.random((24, 12)) < 0.4)
    runs: list[Series] = [(t, row) for row in values]
    table = shares_of(runs) if is_share else bands_of(runs)
    figure = series_figure({"": {"": runs}}, label="gap")
    bounds = [one for one in (table.outer, table.inner) if one is not None]
    for k, at in enumerate(t[:-1]):
        ends = [[0.999 * side[k] + 0.001 * side[k + 1] for side in bound] for bound in bounds]
        assert painted(figure, at + 0.001) == [pytest.approx(one) for one in ends]


def spans(figure: Figure) -> list[tuple[float, float]]:
    """The horizontal lines of the panels, from left to right, without guides."""
    lines = [np.asarray(one.get_xdata()) for axes in figure.axes for one in axes.lines]
    return [(float(x.min()), float(x.max())) for x in lines if len(x) == 2 and x[0] != x[1]]


def test_a_figure_by_run_paints_each_interval_of_its_table() -> None:
    values = {"a": (0.5, 0.7, 0.9), "b": (1.0, None, 2.0), "c": (3.0,)}
    shares = {"a": (0.0, 1.0, 1.0), "b": (1.0, 1.0, 1.0), "c": (0.0, 0.0, 0.0)}
    panels = [Panel(label="gap", values=values), Panel(label="in", values=shares, is_share=True)]
    tables = [
        *(summarize(np.array(one, dtype=float)).mean_interval for one in values.values()),
        *(summarize(np.array(one), is_share=True).share_interval for one in shares.values()),
    ]
    expected = [pytest.approx((one.low, one.high)) for one in tables if one is not None]
    assert spans(intervals_figure(panels)) == expected
    assert len(expected) == 5


def test_a_figure_of_differences_paints_each_interval_of_its_table() -> None:
    found = Difference("m", "m", 5, 5, difference=0.2, interval=Interval(0.1, 0.3))
    other = Difference("m", "m", 5, 5, difference=-0.4, interval=Interval(-0.9, 0.1))
    figure = differences_figure([DifferencePanel("gap", "m", {"b - a": found, "c - a": other})])
    assert spans(figure) == [(0.1, 0.3), (-0.9, 0.1)]


NOTHING: Array = np.zeros(0)


@pytest.mark.parametrize(
    ("make", "subject"),
    [
        (lambda: series_figure({"": {}}, label="gap"), "gap"),
        (lambda: series_figure({"": {"a": []}}, label="gap"), "gap"),
        (lambda: series_figure({"": {"a": [(NOTHING, NOTHING)]}}, label="gap"), "gap"),
        (lambda: intervals_figure([]), "no metric has values"),
        (lambda: differences_figure([]), "."),
        (lambda: survival_figure({"": {"x": Times(NOTHING, NOTHING)}}, event="gather"), "gather"),
        (lambda: overview_figure([]), "there is no run"),
        (lambda: trajectories_figure(walk(2, 0)), "no instant"),
        (lambda: trajectories_figure(walk(0)), "no robot"),
    ],
)
def test_nothing_to_draw_is_an_error(make: Make, subject: str) -> None:
    with pytest.raises(SwarmError, match=subject):
        make()

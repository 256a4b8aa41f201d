"""Every figure with much and with little in it: no two texts overlap, and it is a picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import Interval
from swarmd.sim.plots.bands import Series, series_figure
from swarmd.sim.plots.intervals import (
    DifferencePanel,
    Panel,
    differences_figure,
    intervals_figure,
)
from swarmd.sim.plots.start_and_end import start_and_end_figure
from swarmd.sim.plots.survival import Times, survival_figure
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


def differences() -> Figure:
    found = Difference("m", "m", 5, 5, difference=0.2, interval=Interval(0.1, 0.3))
    never = Difference("m", "m", 5, 5, never_a=1, never_b=2)
    panel = DifferencePanel("minimum gap", "m", {"b - a": found, "d - a": never})
    return differences_figure([panel] * 4, "gathering", width=3.5)


def survival(width: float | None) -> Figure:
    times = {f"law={law}": Times(RNG.exponential(30.0, 9), np.full(9, 500.0)) for law in "ab"}
    facets = {f"count={count}": times for count in (5, 10)}
    figure = survival_figure(facets, label="gather time", title="aggregation", width=width)
    assert width is None or figure.get_figwidth() == width
    return figure


def overview(runs: int, n: int) -> Figure:
    trace = walk(n)
    loads = [(f"seed {k}: 0.123 m", lambda: trace) for k in range(runs)]
    return overview_figure(loads, "paper_exp1_hardware", note=LABEL)


def trajectories(n: int) -> Figure:
    trace = full(n)
    ids = tuple(f"{robot}-waffle_pi-WWW" for robot in trace.ids)
    return trajectories_figure(replace(trace, ids=ids), TITLE)


def start_and_end(arena: str) -> Figure:
    trace = full(7)
    return start_and_end_figure(replace(trace, meta={**trace.meta, "arena": arena}), TITLE)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(lambda: bands(2), id="bands of two variants"),
        pytest.param(lambda: bands(12), id="bands of twelve variants"),
        pytest.param(lambda: intervals(9, 2), id="intervals of many metrics"),
        pytest.param(lambda: intervals(2, 12), id="intervals of many variants"),
        pytest.param(differences, id="differences in a column"),
        pytest.param(lambda: survival(None), id="survival"),
        pytest.param(lambda: survival(3.5), id="survival in a column"),
        pytest.param(lambda: overview(1, 7), id="overview of one run"),
        pytest.param(lambda: overview(9, 7), id="overview of many runs"),
        pytest.param(lambda: overview(4, 200), id="overview of many robots"),
        pytest.param(lambda: trajectories(2), id="trajectories of two robots"),
        pytest.param(lambda: trajectories(20), id="trajectories with names"),
        pytest.param(lambda: trajectories(200), id="trajectories by time"),
        pytest.param(lambda: start_and_end("90x90"), id="start and end in a large arena"),
        pytest.param(lambda: start_and_end("3x9"), id="start and end in a narrow arena"),
    ],
)
def test_no_texts_overlap(make: Make) -> None:
    assert overlaps(make()) == []


@pytest.mark.parametrize(
    "make",
    [
        lambda: trajectories_figure(walk(1, 1)),
        lambda: trajectories_figure(walk(30, 1)),
        lambda: start_and_end_figure(walk(7, 1)),
    ],
)
def test_one_instant_is_a_picture(make: Make, tmp_path: Path) -> None:
    save(make(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 5_000


NOTHING: Array = np.zeros(0)


@pytest.mark.parametrize(
    ("make", "subject"),
    [
        (lambda: series_figure({"": {}}, label="gap"), "gap"),
        (lambda: series_figure({"": {"a": []}}, label="gap"), "gap"),
        (lambda: series_figure({"": {"a": [(NOTHING, NOTHING)]}}, label="gap"), "gap"),
        (lambda: intervals_figure([]), "no metric has values"),
        (lambda: differences_figure([]), "."),
        (lambda: survival_figure({"": {"x": Times(NOTHING, NOTHING)}}, label="gather"), "gather"),
        (lambda: overview_figure([]), "there is no run"),
        (lambda: trajectories_figure(walk(2, 0)), "no instant"),
        (lambda: start_and_end_figure(walk(0)), "no robot"),
    ],
)
def test_nothing_to_draw_is_an_error(make: Make, subject: str) -> None:
    with pytest.raises(SwarmError, match=subject):
        make()

"""Metrics over time, as bands over the runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.bands import draw_series, series_figure
from swarmd.sim.plots.spread import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tests.sim.plots.conftest import Cut

pytest.importorskip("matplotlib")


def runs(count: int, offset: float = 0.0) -> list[Series]:
    t = np.arange(50) / 10.0
    rng = np.random.default_rng(count)
    return [(t, offset + rng.normal(size=50)) for _ in range(count)]


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
        (4, 20, 4, "line: median, bands: 50 % of the runs"),
        (9, 20, 0, "line: median"),
    ],
)
def test_as_many_bands_as_can_be_told_apart_and_says_what_they_are(
    variants: int, count: int, bands: int, says: str
) -> None:
    figure = series_figure({f"v{k}": runs(count) for k in range(variants)}, label="gap")
    assert len(figure.axes[0].lines) == variants
    assert len(figure.axes[0].collections) == bands
    assert note(figure) == says


def test_the_legend_says_how_many_runs_there_are() -> None:
    figure = series_figure({"law=ours": runs(3), "law=paper": runs(20)}, label="gap")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["law=ours (n = 3)", "law=paper (n = 20)"]
    assert series_figure({"one": runs(3)}, label="gap").legends == []


def test_a_variant_without_any_run_is_left_out() -> None:
    figure = series_figure({"a": runs(3), "b": [], "c": runs(2)}, label="gap")
    assert len(figure.axes[0].lines) == 2


def test_no_two_of_twenty_variants_look_alike() -> None:
    figure = series_figure({f"v{k}": runs(2) for k in range(20)}, label="gap")
    looks = {(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert len(looks) == 20


def test_what_is_yes_or_no_is_drawn_as_a_share_of_the_runs() -> None:
    t = np.arange(3.0)
    figure = series_figure(
        {"a": [(t, np.array([0.0, 1.0, 1.0])), (t, np.array([0.0, 0.0, 1.0]))]},
        label="one cluster", unit="0 or 1",
    )  # fmt: skip
    axes = figure.axes[0]
    assert axes.get_ylabel() == "one cluster: share of runs"
    assert np.asarray(axes.lines[0].get_ydata()).tolist() == [0.0, 0.5, 1.0]
    assert note(figure) == "share of the runs, band: its 95 % interval, n = 2"


def test_target_and_events_are_lines_with_words() -> None:
    figure = series_figure({"a": runs(3)}, label="gap", unit="m", target=0.5,
                           events=((1.0, "kill r1"), (2.0, "place")))  # fmt: skip
    axes = figure.axes[0]
    assert axes.get_ylabel() == "gap [m]"
    assert len(axes.lines) == 4
    assert [text.get_text() for text in axes.texts] == ["target 0.5", "kill r1", "place"]


def test_smoothing_is_said_and_done() -> None:
    rough, smooth = (series_figure({"a": runs(3)}, label="duty", smoothing=s) for s in (0.0, 2.0))
    assert note(smooth).endswith("; running mean over 2 s")
    spans = [np.ptp(figure.axes[0].lines[0].get_ydata()) for figure in (rough, smooth)]
    assert spans[1] < spans[0] / 2.0


@pytest.mark.parametrize("groups", [{}, {"a": []}, {"a": [(np.zeros(0), np.zeros(0))]}])
def test_nothing_to_draw_is_one_clear_error(
    groups: dict[str, list[Series]], tmp_path: Path
) -> None:
    with pytest.raises(SwarmError, match="gap: no run has values over time"):
        draw_series(groups, tmp_path / "x.png", label="gap")
    assert list(tmp_path.iterdir()) == []


def test_one_instant_is_a_picture(tmp_path: Path) -> None:
    draw_series({"a": [(np.zeros(1), np.ones(1))] * 3}, tmp_path / "x.png", label="gap")
    assert (tmp_path / "x.png").stat().st_size > 5_000


@pytest.mark.parametrize("variants", [1, 2, 12])
def test_no_word_is_cut_off(cut_off: Cut, variants: int) -> None:
    groups = {f"law=paper,lidar_visibility=real,W={k}": runs(20) for k in range(variants)}
    figure = series_figure(groups, label="mean distance to centroid", unit="m", target=1.0,
                           title="paper_exp1_hardware", smoothing=2.0)  # fmt: skip
    assert cut_off(figure) == []


def test_title_and_reading_do_not_meet() -> None:
    figure = series_figure({"a": runs(20)}, label="duty", title="paper_exp1_waffle_pi", smoothing=2)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    left, right = (
        getattr(axes, name).get_window_extent() for name in ("_left_title", "_right_title")
    )
    assert left.x1 < right.x0

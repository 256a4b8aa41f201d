"""The start of a run beside its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.start_and_end import draw_start_and_end, start_and_end_figure
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tests.sim.plots.conftest import Cut, Walk

pytest.importorskip("matplotlib")
Full = Callable[[int], Trace]


def titles(figure: Figure) -> list[str]:
    return [axes.get_title() for axes in figure.axes]


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


@pytest.fixture
def gathering(walk: Walk) -> Trace:
    """Four robots 1 m apart of which three come together."""
    trace = walk(4, 2, arena="5x5")
    trace.pose[0, :, :2] = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    trace.pose[1, :, :2] = [[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [2.0, 2.0]]
    return trace


def test_says_how_many_clusters_there_are(gathering: Trace) -> None:
    figure = start_and_end_figure(gathering)
    assert titles(figure) == ["start: all 4 alone", "end, 0 s: 2 clusters, the largest of 3"]
    assert words(figure) == ["one cluster: each within 0.8 m of the next"]


def test_the_link_may_be_given(gathering: Trace) -> None:
    figure = start_and_end_figure(gathering, link=1.1)
    assert titles(figure)[0] == "start: one cluster of 4"
    assert words(figure) == ["one cluster: each within 1.1 m of the next"]


def test_lines_join_those_of_a_cluster(gathering: Trace) -> None:
    figure = start_and_end_figure(gathering)
    lines = [axes.collections[2] for axes in figure.axes]  # after inner walls and boxes
    assert [len(one.get_paths()) for one in lines] == [0, 3]


def test_both_show_the_same_place(full: Full) -> None:
    start, end = start_and_end_figure(full(5)).axes
    assert start.get_xlim() == end.get_xlim()
    assert start.get_ylim() == end.get_ylim()


def test_each_shows_the_movable_boxes_of_its_instant(full: Full) -> None:
    start, end = start_and_end_figure(full(5)).axes
    places = [
        np.asarray(axes.patches[1].get_path().vertices)[:4].mean(axis=0) for axes in (start, end)
    ]
    assert places[0] == pytest.approx([2.0, 0.0])
    assert places[1] == pytest.approx([2.4, 0.3])


def test_a_wide_arena_is_shown_twice_below_each_other(walk: Walk) -> None:
    trace = walk(4, arena="6x2")
    trace.pose[..., 0] *= 4.0
    start, end = start_and_end_figure(trace).axes
    assert start.get_position().y0 > end.get_position().y1


def test_without_thresholds_there_are_no_clusters(walk: Walk) -> None:
    figure = start_and_end_figure(walk(3, meta={"arena": "3x3"}))
    assert titles(figure)[0] == "start: 3 robots"
    assert words(figure) == []


def test_opinions_take_the_place_of_clusters(walk: Walk) -> None:
    opinion = np.full((20, 3), 1.0)
    opinion[0] = np.nan, 0.0, 1.0
    figure = start_and_end_figure(walk(3, report={"opinion": opinion}))
    assert titles(figure) == ["start: opinion 0: 1, opinion 1: 1", "end, 2 s: opinion 1: 3"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["opinion 0", "opinion 1"]


@pytest.mark.parametrize("n", [2, 7, 200])
def test_no_word_is_cut_off(full: Full, cut_off: Cut, n: int) -> None:
    title = "paper_exp1_hardware, law=paper,lidar_visibility=real, seed 519\nleast typical run"
    for arena in ("6x6", "90x90", "3x9"):
        trace = full(n)
        trace = replace(trace, meta={**trace.meta, "arena": arena})
        assert cut_off(start_and_end_figure(trace, title)) == []


@pytest.mark.parametrize("n", [1, 7])
def test_one_instant_is_a_picture(walk: Walk, n: int, tmp_path: Path) -> None:
    draw_start_and_end(walk(n, 1), tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 5_000


def test_an_empty_run_is_one_clear_error(tmp_path: Path, walk: Walk) -> None:
    with pytest.raises(SwarmError, match="nothing to draw"):
        draw_start_and_end(walk(2, 0), tmp_path / "run.png")

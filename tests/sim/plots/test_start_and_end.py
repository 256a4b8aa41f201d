"""The start of a run beside its end."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.start_and_end import (
    NO_COLOUR,
    SMALL_COLOUR,
    by_cluster,
    by_opinion,
    opinions_of,
    start_and_end_figure,
)
from swarmd.sim.plots.theme import ROBOT_COLOURS
from swarmd.sim.trace import Trace
from tests.sim.plots.runs import full, walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")


def titles(figure: Figure) -> list[str]:
    return [axes.get_title() for axes in figure.axes]


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


@pytest.fixture
def gathering() -> Trace:
    """Four robots 1 m apart of which three come together."""
    trace = walk(4, 2, arena="5x5")
    trace.pose[0, :, :2] = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    trace.pose[1, :, :2] = [[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [2.0, 2.0]]
    return trace


def test_titles_count_clusters(gathering: Trace) -> None:
    figure = start_and_end_figure(gathering)
    assert titles(figure) == ["start: all 4 alone", "end, 0 s: 2 clusters, the largest of 3"]
    assert words(figure) == ["one cluster: each within 0.8 m of the next"]
    figure = start_and_end_figure(gathering, link=1.1)
    assert titles(figure)[0] == "start: one cluster of 4"
    assert words(figure) == ["one cluster: each within 1.1 m of the next"]


def test_lines_join_those_of_a_cluster(gathering: Trace) -> None:
    figure = start_and_end_figure(gathering)
    lines = [axes.collections[2] for axes in figure.axes]  # after inner walls and boxes
    assert [len(one.get_paths()) for one in lines] == [0, 3]


def test_each_shows_the_movable_boxes_of_its_instant() -> None:
    start, end = start_and_end_figure(full(5)).axes
    places = [
        np.asarray(axes.patches[1].get_path().vertices)[:4].mean(axis=0) for axes in (start, end)
    ]
    assert places[0] == pytest.approx([2.0, 0.0])
    assert places[1] == pytest.approx([2.4, 0.3])
    assert (start.get_xlim(), start.get_ylim()) == (end.get_xlim(), end.get_ylim())


def test_a_wide_arena_is_shown_twice_below_each_other() -> None:
    trace = walk(4, arena="6x2")
    trace.pose[..., 0] *= 4.0
    figure = start_and_end_figure(trace)
    start, end = figure.axes
    figure.draw_without_rendering()
    assert start.get_position().y0 > end.get_position().y1


def test_without_thresholds_there_are_no_clusters() -> None:
    figure = start_and_end_figure(walk(3, meta={"arena": "3x3"}))
    assert titles(figure)[0] == "start: 3 robots"
    assert words(figure) == []


def test_opinions_take_the_place_of_clusters() -> None:
    opinion = np.full((20, 3), 1.0)
    opinion[0] = np.nan, 0.0, 1.0
    figure = start_and_end_figure(walk(3, report={"opinion": opinion}))
    assert titles(figure) == ["start: opinion 0: 1, opinion 1: 1", "end, 2 s: opinion 1: 3"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["opinion 0", "opinion 1"]


def test_the_largest_cluster_has_the_first_colour_and_lone_robots_none() -> None:
    trace = walk(6, 1)
    trace.pose[0, :, :2] = [[9.0, 9.0], [0.0, 0.0], [5.0, 0.0], [5.1, 0.0], [5.2, 0.0], [0.1, 0.0]]
    found = by_cluster(trace, 0.15)
    first, second = ROBOT_COLOURS[:2]
    assert found.colours == [NO_COLOUR, second, first, first, first, second]
    assert found.label == "3 clusters, the largest of 3"


def test_small_clusters_are_grey_where_there_are_more_than_colours() -> None:
    trace = walk(24, 1)
    trace.pose[0, :, 0] = np.repeat(np.arange(12), 2) * 10.0
    trace.pose[0, :, 1] = np.tile([0.0, 0.1], 12)
    colours = by_cluster(trace, 0.5).colours
    assert len(set(colours[:18])) == 9
    assert set(colours[18:]) == {SMALL_COLOUR}


def test_absent_robots_are_not_counted() -> None:
    trace = walk(3, 1, present=np.array([[True, False, False]]))
    assert by_cluster(trace, 9.0).label == "1 robot"
    assert by_cluster(trace, 9.0).colours[1:] == [NO_COLOUR, NO_COLOUR]
    assert by_cluster(trace, None).label == "1 robot"
    trace = replace(trace, present=np.zeros((1, 3), dtype=bool))
    assert by_cluster(trace, 1.0).label == "0 robots"


@pytest.mark.parametrize(("count", "words"), [(2, "0: 1, opinion 1: 1"), (7, "3: 1, 3 more")])
def test_each_opinion_has_one_colour_at_both_ends(count: int, words: str) -> None:
    held = np.arange(count, dtype=np.float64)
    trace = walk(count, 2, report={"opinion": np.stack((held, held[::-1]))})
    opinions = opinions_of(trace)
    found = by_opinion(trace, opinions)
    assert opinions == list(range(count))
    assert found.colours == list(ROBOT_COLOURS[:count])
    assert found.label.endswith(words)


def test_more_opinions_than_colours_are_grey() -> None:
    trace = walk(12, 1, report={"opinion": np.arange(12.0)[None]})
    opinions = opinions_of(trace)
    assert by_opinion(trace, opinions).colours[9:] == [SMALL_COLOUR] * 3
    assert len(start_and_end_figure(trace).legends[0].get_texts()) == 9


def test_a_run_without_opinions_has_none() -> None:
    trace = walk(2, 1, report={"opinion": np.full((1, 2), np.nan)})
    assert opinions_of(trace) == []
    assert by_opinion(trace, []).label == "no opinion yet"
    assert opinions_of(walk(2, 1)) == []

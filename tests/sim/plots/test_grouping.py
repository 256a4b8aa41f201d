"""Robots are told apart by what they are together with, or by what they hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.grouping import (
    NO_COLOUR,
    SMALL_COLOUR,
    by_cluster,
    by_opinion,
    key_of,
    opinions_of,
)
from swarmd.sim.plots.theme import ROBOT_COLOURS

if TYPE_CHECKING:
    from tests.sim.plots.conftest import Walk


def test_the_largest_cluster_has_the_first_colour_and_lone_robots_none(walk: Walk) -> None:
    trace = walk(6, 1)
    trace.pose[0, :, :2] = [[9.0, 9.0], [0.0, 0.0], [5.0, 0.0], [5.1, 0.0], [5.2, 0.0], [0.1, 0.0]]
    found = by_cluster(trace, 0.15)
    first, second = ROBOT_COLOURS[:2]
    assert found.colours == [NO_COLOUR, second, first, first, first, second]
    assert found.words == "3 clusters, the largest of 3"


def test_small_clusters_are_grey_where_there_are_more_than_colours(walk: Walk) -> None:
    trace = walk(24, 1)
    trace.pose[0, :, 0] = np.repeat(np.arange(12), 2) * 10.0
    trace.pose[0, :, 1] = np.tile([0.0, 0.1], 12)
    colours = by_cluster(trace, 0.5).colours
    assert len(set(colours[:18])) == 9
    assert set(colours[18:]) == {SMALL_COLOUR}


def test_robots_that_are_away_count_for_nothing(walk: Walk) -> None:
    trace = walk(3, 1, present=np.array([[True, False, False]]))
    assert by_cluster(trace, 9.0).words == "1 robot"
    assert by_cluster(trace, 9.0).colours[1:] == [NO_COLOUR, NO_COLOUR]
    assert by_cluster(trace, None).words == "1 robot"


def test_nobody_there_is_no_cluster(walk: Walk) -> None:
    trace = walk(2, 1, present=np.zeros((1, 2), dtype=bool))
    assert by_cluster(trace, 1.0).words == "0 robots"


@pytest.mark.parametrize(("count", "words"), [(2, "0: 1, opinion 1: 1"), (7, "3: 1, 3 more")])
def test_each_opinion_has_one_colour_at_both_ends(walk: Walk, count: int, words: str) -> None:
    held = np.arange(count, dtype=np.float64)
    trace = walk(count, 2, report={"opinion": np.stack((held, held[::-1]))})
    opinions = opinions_of(trace)
    found = by_opinion(trace, opinions)
    assert opinions == list(range(count))
    assert found.colours == list(ROBOT_COLOURS[:count])
    assert found.words.endswith(words)


def test_more_opinions_than_colours_are_grey(walk: Walk) -> None:
    pytest.importorskip("matplotlib")
    trace = walk(12, 1, report={"opinion": np.arange(12.0)[None]})
    opinions = opinions_of(trace)
    assert by_opinion(trace, opinions).colours[9:] == [SMALL_COLOUR] * 3
    assert len(key_of(opinions)) == 9


def test_no_opinion_at_all_is_said(walk: Walk) -> None:
    trace = walk(2, 1, report={"opinion": np.full((1, 2), np.nan)})
    assert opinions_of(trace) == []
    assert by_opinion(trace, []).words == "no opinion yet"
    assert opinions_of(walk(2, 1)) == []

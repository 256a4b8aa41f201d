"""Pairs by cells are those that looking at all pairs gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from tests.support.examples import examples

EVERY = 1e9


def crowd(seed: int, n: int) -> tuple[Array, NDArray[np.bool_]]:
    """Three instants of n points on a grid of 0.25 m, so that many distances are alike."""
    rng = np.random.default_rng(seed)
    place = np.round(rng.uniform(-2.0, 2.0, (3, n, 2)) * 4.0) / 4.0
    return place, rng.random((3, n)) < 0.9


def by_hand(place: Array, is_in: NDArray[np.bool_], reach: float) -> set[tuple[int, int, int]]:
    return {
        (t, a, b)
        for t in range(len(place))
        for a in range(place.shape[1])
        for b in range(a + 1, place.shape[1])
        if is_in[t, a] and is_in[t, b] and np.hypot(*(place[t, a] - place[t, b])) <= reach
    }


@pytest.mark.parametrize("n", [5, 41])
@given(seed=st.integers(0, 1000), reach=st.sampled_from([0.25, 0.5, 0.7, 3.0, EVERY]))
@settings(deadline=None, max_examples=examples(15))
def test_near_pairs_are_those_of_looking_at_all(n: int, seed: int, reach: float) -> None:
    place, is_in = crowd(seed, n)
    found = pairs.near(place, is_in, reach)
    told = list(zip(found.instant.tolist(), found.a.tolist(), found.b.tolist(), strict=True))
    assert len(told) == len(set(told))
    assert set(told) == by_hand(place, is_in, reach)
    away = place[found.instant, found.a] - place[found.instant, found.b]
    np.testing.assert_allclose(found.distance, np.hypot(away[:, 0], away[:, 1]))


@pytest.mark.parametrize("n", [5, 41, 200])
def test_nearest_is_the_smallest_of_all_distances(n: int) -> None:
    place, is_in = crowd(4, n)
    place[0, 0] = 500.0  # an outlier, whose neighbour no cell holds
    is_in[0, 0] = True
    nearest = pairs.nearest(place, is_in)
    away = place[:, :, None] - place[:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    distance[:, np.arange(n), np.arange(n)] = np.inf
    distance = np.where(is_in[:, None], distance, np.inf).min(axis=2)
    np.testing.assert_array_equal(nearest, np.where(is_in, distance, np.nan))


def test_components_take_the_lowest_node_as_their_name() -> None:
    a, b = np.array([5, 4, 1, 7]), np.array([4, 2, 6, 7])
    assert pairs.components(8, a, b).tolist() == [0, 1, 2, 3, 2, 2, 1, 7]


def test_spans_cover_all_instants_once() -> None:
    n = pairs.MAX_POINTS // 3
    spans = list(pairs.spans(10, n))
    assert [i for span in spans for i in range(span.start, span.stop)] == list(range(10))
    assert all((span.stop - span.start) * n <= pairs.MAX_POINTS for span in spans)
    assert len(list(pairs.spans(2, 10 * pairs.MAX_POINTS))) == 2

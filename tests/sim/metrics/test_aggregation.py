"""How a swarm gathers, against runs whose numbers are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.sim.metrics import aggregation, pairs
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import line, run


def gathering() -> Trace:
    """Two Jackals on the x axis, 10 m apart, that meet at 2 m after 8 s and stand for 12 s."""
    half = np.maximum(5.0 - 0.5 * 0.1 * np.arange(201), 1.0)
    pose = np.zeros((201, 2, 3))
    pose[:, 0, 0], pose[:, 1, 0] = -half, half
    return run(pose)


def test_distance_to_centroid_of_experiment_1() -> None:
    away = aggregation.distance_to_centroid
    np.testing.assert_allclose(away(run(line(*range(7)))), [12.0 / 7.0])
    np.testing.assert_allclose(away(run(line(5.0, 5.0))), [0.0])


def test_distance_to_centroid_is_of_those_present() -> None:
    trace = run(line(0.0, 2.0, 90.0), present=np.array([[True, True, False]]))
    np.testing.assert_allclose(aggregation.distance_to_centroid(trace), [1.0])
    nobody = replace(trace, present=np.zeros((1, 3), dtype=bool))
    assert np.isnan(aggregation.distance_to_centroid(nobody)).all()


def test_distance_at_a_time() -> None:
    assert aggregation.distance_at(gathering(), 2.0) == pytest.approx(4.0)
    assert aggregation.distance_at(gathering(), 20.0) == pytest.approx(1.0)
    assert aggregation.distance_at(gathering(), 20.2) is None


@pytest.mark.parametrize(
    ("xs", "count", "largest"),
    [
        ((0.0, 0.9, 1.8, 2.7), 1, 4),  # a chain: its ends are far apart
        ((0.0, 5.0, 10.0), 3, 1),
        ((0.0, 10.0, 1.0, 11.0, 2.0), 2, 3),  # order does not matter
        ((0.0, 1.0), 1, 2),  # the link itself still links
        ((0.0,), 1, 1),
    ],
)
def test_clusters_by_single_linkage(xs: tuple[float, ...], count: int, largest: int) -> None:
    trace = run(line(*xs))
    assert aggregation.cluster_counts(trace, link=1.0).tolist() == [count]
    assert aggregation.largest_cluster(trace, link=1.0).tolist() == [largest]
    share = aggregation.largest_cluster_share(trace, link=1.0)
    assert share.tolist() == pytest.approx([largest / len(xs)])


def test_an_absent_robot_is_in_no_cluster_and_joins_none() -> None:
    trace = run(line(0.0, 0.9, 1.8), present=np.array([[True, False, True]]))
    assert aggregation.clusters(trace, link=1.0).tolist() == [[0, -1, 2]]
    assert aggregation.cluster_counts(trace, link=1.0).tolist() == [2]
    assert aggregation.largest_cluster_share(trace, link=1.0).tolist() == [0.5]


def test_clusters_of_more_robots_and_instants_than_are_worked_on_at_once() -> None:
    n = 100
    pose = np.zeros((3 * pairs.MAX_POINTS // n, n, 3))
    pose[:, n // 2 :, 0] = 5.0
    trace = run(pose)
    assert (aggregation.clusters(trace, 1.0) == [0] * 50 + [50] * 50).all()


def test_link_is_twice_the_largest_threshold_of_the_robots_there() -> None:
    trace = run(line(0.0, 1.0))
    assert aggregation.cluster_link(trace) == pytest.approx(2.4)  # Jackals
    mixed = replace(trace, platforms=("burger", "jackal"))
    assert aggregation.cluster_link(mixed) == pytest.approx(2.4)
    burgers = replace(trace, platforms=("burger", "burger"))
    assert aggregation.cluster_link(burgers) == pytest.approx(1.0)
    assert aggregation.cluster_link(replace(trace, meta={})) is None
    without = replace(trace, meta={"thresholds": {"jackal": 0.0}})
    assert aggregation.cluster_link(without) is None


def test_gather_time_wants_one_cluster_and_half_the_distance() -> None:
    trace = gathering()
    # One cluster at 2.4 m, which is after 7.6 s; half the distance already after 5 s.
    assert aggregation.gather_time(trace, link=2.4) == pytest.approx(7.6)
    assert aggregation.gather_time(trace, link=9.0) == pytest.approx(5.0)
    assert aggregation.gather_time(trace, link=1.9) is None
    assert aggregation.gather_time(trace, link=9.0, share=0.1) is None


def test_nearest_neighbors() -> None:
    trace = run(line(0.0, 3.0, 4.0, 4.5), present=np.array([[True, True, True, False]]))
    distance = aggregation.nearest_neighbors(trace)
    np.testing.assert_allclose(distance, [[3.0, 1.0, 1.0, np.nan]])
    np.testing.assert_allclose(aggregation.nearest_neighbor_medians(trace), [1.0])
    assert aggregation.nearest_neighbor_median(trace) == pytest.approx(1.0)


def test_a_robot_alone_has_no_neighbor() -> None:
    assert aggregation.nearest_neighbors(run(line(1.0))).tolist() == [[math.inf]]
    assert np.isnan(aggregation.nearest_neighbor_medians(run(line(1.0)))).all()
    assert aggregation.nearest_neighbor_median(run(line(1.0))) is None

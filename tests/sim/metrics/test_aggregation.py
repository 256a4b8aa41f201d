"""Metrics against runs whose numbers are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.platforms import load_platform
from swarmd.sim.metrics import aggregation as metrics
from swarmd.sim.metrics import effort, gap, protection, touches
from swarmd.sim.trace import ARENA, Trace
from swarmd.values import Array

JACKAL = load_platform("jackal")


def run(pose: Array, contacts: list[tuple[float, int, int]] | None = None) -> Trace:
    """A trace of (T, n, 3) poses of Jackals at 10 Hz."""
    instants, n = pose.shape[:2]
    rows = np.array(contacts or [], dtype=np.float64).reshape(-1, 3)
    return Trace(
        ids=tuple(f"r{i}" for i in range(n)),
        t=np.linspace(0.0, 0.1 * (instants - 1), instants),
        pose=pose,
        safe=np.zeros_like(pose),
        contact_t=rows[:, 0],
        contact_pair=rows[:, 1:].astype(np.int64),
        contact_speed=np.zeros((len(rows), 2)),
        platforms=("jackal",) * n,
        footprints={"jackal": JACKAL.footprint},
    )


def line(*xs: float) -> Array:
    pose = np.zeros((1, len(xs), 3))
    pose[0, :, 0] = xs
    return pose


def test_distance_to_centroid_of_experiment_1() -> None:
    np.testing.assert_allclose(metrics.distance_to_centroid(run(line(*range(7)))), [12.0 / 7.0])
    np.testing.assert_allclose(metrics.distance_to_centroid(run(line(5.0, 5.0))), [0.0])


@pytest.mark.parametrize(
    ("xs", "count", "largest"),
    [
        ((0.0, 0.9, 1.8, 2.7), 1, 4),  # a chain: its ends are far apart
        ((0.0, 5.0, 10.0), 3, 1),
        ((0.0, 10.0, 1.0, 11.0, 2.0), 2, 3),  # order does not matter
        ((0.0,), 1, 1),
    ],
)
def test_clusters_by_single_linkage(xs: tuple[float, ...], count: int, largest: int) -> None:
    trace = run(line(*xs))
    assert metrics.cluster_counts(trace, link=1.0).tolist() == [count]
    assert metrics.largest_cluster(trace, link=1.0).tolist() == [largest]


def test_cluster_labels_are_their_lowest_member() -> None:
    labels = metrics.clusters(run(line(9.0, 0.0, 8.5, 0.5)), link=1.0)
    assert labels.tolist() == [[0, 1, 0, 1]]


def test_clusters_agree_with_a_walk_through_the_graph() -> None:
    rng = np.random.default_rng(2)
    pose = np.zeros((40, 12, 3))
    pose[..., :2] = rng.uniform(0.0, 5.0, (40, 12, 2))
    counted = metrics.cluster_counts(run(pose), link=1.1)
    for place, count in zip(pose[..., :2], counted, strict=True):
        left, groups = set(range(12)), 0
        while left:
            groups += 1
            front = [left.pop()]
            while front:
                here = front.pop()
                near = {i for i in left if math.dist(place[here], place[i]) <= 1.1}
                left -= near
                front += near
        assert count == groups


def test_minimum_gap_is_between_footprints_not_centres() -> None:
    pose = np.zeros((2, 2, 3))
    pose[:, 1, 0] = (3.0, 2.0)
    assert gap.minimum_gap(run(pose)) == pytest.approx(2.0 - 0.508)
    pose[1, 1, 2] = math.pi / 2.0  # the second one's narrow side now
    assert gap.minimum_gap(run(pose)) == pytest.approx(2.0 - 0.254 - 0.215)


@pytest.mark.parametrize("seed", range(5))
def test_minimum_gap_looks_at_every_pair_and_instant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = rng.uniform(-40.0, 40.0, (30, 5, 3))
    pose[..., 2] = rng.uniform(-3.0, 3.0, (30, 5))
    whole = gap.minimum_gap(run(pose))
    each = [
        gap.minimum_gap(run(pose[k : k + 1, [a, b]]))
        for k in range(30)
        for a in range(5)
        for b in range(a)
    ]
    assert whole == min(each) > 0.0


def test_minimum_gap_is_found_where_the_centres_are_not_the_nearest() -> None:
    # Nose to tail and 0.52 m apart they almost touch; side by side at 0.50 m they do not.
    apart = np.array([[[0.0, 0.0, 0.0], [0.52, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.50, 0.0]]])
    assert gap.minimum_gap(run(apart)) == pytest.approx(0.52 - 0.508)
    assert gap.minimum_gap(run(apart[::-1])) == pytest.approx(0.52 - 0.508)


def test_minimum_gap_is_zero_in_touch_and_infinite_alone() -> None:
    assert gap.minimum_gap(run(line(0.0, 0.5))) == 0.0
    assert gap.minimum_gap(run(line(0.0))) == math.inf


def test_contacts_are_counted_by_touches_robots_apart_from_the_arena() -> None:
    steps = [(0.01 * k, 0, 1) for k in range(100)]
    steps += [(5.0, 1, 0), (5.2, 2, ARENA), (9.0, 2, ARENA)]
    trace = run(line(0.0, 1.0, 2.0), steps)
    assert touches.contact_episodes(trace) == {("r0", "r1"): 2, ("r2", touches.WALLS): 2}
    assert touches.contacts_between_robots(trace) == 2
    assert touches.contacts_with_arena(trace) == 2


def test_a_robot_called_arena_is_not_taken_for_the_walls() -> None:
    trace = replace(run(line(0.0, 1.0), [(0.0, 0, 1)]), ids=("arena", "b"))
    assert touches.contacts_between_robots(trace) == 1
    assert touches.contacts_with_arena(trace) == 0


def test_protection_duty_is_a_share_or_unknown() -> None:
    trace = run(np.zeros((4, 2, 3)))
    assert protection.protection_duty(trace) is None
    active = np.zeros((4, 2), dtype=bool)
    active[0] = True
    assert protection.protection_duty(replace(trace, active=active)) == 0.25


def test_path_length_and_mean_speed() -> None:
    pose = np.zeros((11, 2, 3))
    pose[:6, 0, 0] = np.linspace(0.0, 1.0, 6)
    pose[6:, 0, 0] = 1.0
    trace = run(pose)
    np.testing.assert_allclose(effort.path_lengths(trace), [1.0, 0.0])
    assert effort.mean_speed(trace) == pytest.approx(0.5)
    assert effort.mean_speed(trace, since=0.5) == pytest.approx(0.0)


def test_an_empty_run_has_no_numbers_but_breaks_nothing() -> None:
    trace = run(np.zeros((0, 3, 3)))
    assert metrics.distance_to_centroid(trace).shape == (0,)
    assert metrics.cluster_counts(trace, 1.0).shape == (0,)
    assert metrics.largest_cluster(trace, 1.0).shape == (0,)
    assert gap.minimum_gap(trace) == math.inf
    assert effort.mean_speed(trace) is None
    assert effort.path_lengths(trace).tolist() == [0.0, 0.0, 0.0]

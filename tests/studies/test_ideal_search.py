"""The ideal search: groups of points that move as one and merge at once."""

from __future__ import annotations

import numpy as np
import pytest

from studies.ideal_search import RULES, SIGHT, Groups, search_times

pytestmark = pytest.mark.long

HALF = np.array([3.0, 2.0])
PAIR = np.array([[0.0, 0.0], [SIGHT - 0.01, 0.0]])
APART = np.array([[0.0, 0.0], [SIGHT + 0.05, 0.0]])


def groups(points: np.ndarray) -> Groups:
    return Groups(points, HALF, np.random.default_rng(0))


@pytest.mark.parametrize("most_moving", RULES.values())
def test_a_seed_gives_the_same_time_within_the_run(most_moving: int) -> None:
    seeds = (3, 4, 5)
    times = search_times(seeds, most_moving)
    assert times.shape == (3,)
    np.testing.assert_array_equal(search_times(seeds, most_moving), times)
    np.testing.assert_array_equal(search_times(seeds[1:], most_moving), times[1:])
    found = times[np.isfinite(times)]
    assert np.all((found > 0.0) & (found <= 120.0))


def test_points_that_never_move_never_meet() -> None:
    assert np.isinf(search_times((0, 1), 0)).all()


def test_six_points_in_sight_of_one_another_are_together_at_once() -> None:
    angles = np.arange(6) * np.pi / 3.0
    ring = SIGHT / 2.1 * np.column_stack((np.cos(angles), np.sin(angles)))
    assert groups(ring).move(0.0, 7)
    assert not groups(ring[:5]).move(0.0, 7)


@pytest.mark.parametrize(("points", "sizes"), [(PAIR, [2]), (APART, [1, 1])])
def test_points_merge_within_sight_alone(points: np.ndarray, sizes: list[int]) -> None:
    some = groups(points)
    some.move(0.0, 7)
    assert some.sizes == sizes


def test_a_group_that_merges_at_a_wall_stays_inside_and_moves_on() -> None:
    corner = np.array([[3.0, 2.0], [2.5, 2.0], [3.0, 1.5]])
    some = groups(corner)
    some.move(0.0, 7)
    assert some.sizes == [3]
    places = [some.points.copy()]
    for _ in range(300):
        some.move(0.026, 7)
        places.append(some.points.copy())
    assert (np.abs(np.array(places)) <= HALF + 1e-9).all()
    assert np.ptp(np.array(places), axis=0).max() > 1.0

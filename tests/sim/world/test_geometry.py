"""Distances of convex polygons, against independent calculations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.sim.world.geometry import apart, crossings, gaps, overlaps, transform

SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
TRIANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def at(shape: Array, x: float, y: float, yaw: float = 0.0) -> Array:
    return transform(shape, np.array([x, y, yaw]))


def boundary(shape: Array, points: int) -> Array:
    share = np.linspace(0.0, 1.0, points)[:, None]
    edges = zip(shape, np.roll(shape, -1, axis=0), strict=True)
    return np.concatenate([a + share * (b - a) for a, b in edges])


@pytest.mark.parametrize(
    ("x", "y", "yaw", "gap"),
    [
        (3.0, 0.0, 0.0, 2.0),  # face to face
        (3.0, 4.0, 0.0, math.hypot(2.0, 3.0)),  # corner to corner
        (2.0, 0.0, math.pi / 4.0, 1.5 - math.sqrt(0.5)),  # corner to face
        (0.9, 0.0, 0.0, 0.0),  # overlapping
        (0.0, 0.0, 0.3, 0.0),  # one upon the other, no corner inside
    ],
)
def test_gap_of_two_squares(x: float, y: float, yaw: float, gap: float) -> None:
    assert float(gaps(SQUARE, at(SQUARE, x, y, yaw))) == pytest.approx(gap, abs=1e-12)


def test_agrees_with_a_dense_sampling_of_both_outlines() -> None:
    rng = np.random.default_rng(5)
    apart = 0
    for _ in range(60):
        a = at(SQUARE * [1.0, 0.4], 0.0, 0.0, rng.uniform(-3.0, 3.0))
        b = transform(TRIANGLE, rng.uniform(-2.0, 2.0, 3))
        difference = boundary(a, 200)[:, None] - boundary(b, 200)[None]
        sampled = np.hypot(difference[..., 0], difference[..., 1]).min()
        exact = float(gaps(a, b))
        if not overlaps(a, b):
            apart += 1
            assert exact <= sampled + 1e-12
            assert exact == pytest.approx(sampled, abs=0.01)  # half the sampling's step
    assert apart > 20


def test_is_symmetric_and_works_on_stacks() -> None:
    rng = np.random.default_rng(1)
    poses = rng.uniform(-2.0, 2.0, (50, 2, 3))
    a, b = transform(SQUARE, poses[:, 0]), transform(TRIANGLE, poses[:, 1])
    np.testing.assert_allclose(gaps(a, b), gaps(b, a), atol=1e-12)
    np.testing.assert_array_equal(
        gaps(a, b), [float(gaps(x, y)) for x, y in zip(a, b, strict=True)]
    )


@pytest.mark.parametrize(
    ("start", "end", "is_met"),
    [
        ((1.0, -1.0), (1.0, 1.0), True),
        ((1.0, 1.0), (1.0, -1.0), True),
        ((1.0, 0.0), (1.0, 1.0), True),  # an end on the way
        ((1.0, 0.1), (1.0, 1.0), False),  # beside it
        ((3.0, -1.0), (3.0, 1.0), False),  # beyond it
        ((2.0, -1.0), (2.0, 1.0), False),  # where it ends
        ((-1.0, 1.0), (3.0, 1.0), False),  # parallel
        ((0.5, 0.0), (1.5, 0.0), False),  # along it: a wall seen edge-on hides nothing
    ],
)
def test_a_way_meets_a_wall(
    start: tuple[float, float], end: tuple[float, float], is_met: bool
) -> None:
    a, b = np.array([0.0, 0.0]), np.array([2.0, 0.0])
    assert crossings(a, b, np.array(start), np.array(end)) == is_met
    assert crossings(b, a, np.array(end), np.array(start)) == is_met


def test_crossings_broadcast_and_ignore_nan() -> None:
    rng = np.random.default_rng(7)
    a, b, start, end = rng.uniform(-1.0, 1.0, (4, 200, 2))
    alone = [bool(crossings(*four)) for four in zip(a, b, start, end, strict=True)]
    assert crossings(a, b, start, end).tolist() == alone
    assert 20 < sum(alone) < 180
    assert not crossings(a, b, np.full((200, 2), np.nan), end).any()


@pytest.mark.parametrize(
    ("point", "distance"),
    [((1.0, 2.0), 2.0), ((-3.0, 4.0), 5.0), ((2.5, 0.0), 0.5), ((1.5, 0.0), 0.0)],
)
def test_distance_of_a_point_from_a_segment(point: tuple[float, float], distance: float) -> None:
    a, b = np.array([0.0, 0.0]), np.array([2.0, 0.0])
    assert apart(np.array(point), a, b) == pytest.approx(distance)
    assert apart(np.array(point), a, a) == pytest.approx(math.hypot(*point))

"""Line of sight past boxes, poles and inner walls."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.radio_visibility import LineOfSight


def clear(arena: Arena, a: tuple[float, float], b: tuple[float, float]) -> bool:
    forth = LineOfSight(arena).is_clear(np.array([a]), np.array([b]))
    back = LineOfSight(arena).is_clear(np.array([b]), np.array([a]))
    assert forth == back
    return bool(forth[0])


@pytest.mark.parametrize(
    "arena",
    [
        Arena(20.0, 20.0, boxes=(Box(0.0, 0.0, 1.0, 1.0, 0.4),)),
        Arena(20.0, 20.0, poles=(Pole(0.0, 0.0, 0.3),)),
        Arena(20.0, 20.0, segments=(Segment(0.1, -1.0, -0.1, 1.0),)),
    ],
)
def test_box_pole_and_inner_wall_block_the_sight(arena: Arena) -> None:
    assert not clear(arena, (-2.0, 0.0), (2.0, 0.0))
    assert not clear(arena, (-2.0, -0.2), (3.0, 0.25))
    assert clear(arena, (-2.0, 0.0), (-1.0, 0.0))  # in front of it
    assert clear(arena, (1.0, 0.0), (2.0, 0.0))  # behind it
    assert clear(arena, (-2.0, 1.5), (2.0, 1.5))  # beside it
    assert clear(arena, (-2.0, 0.0), (0.0, 3.0))  # past its corner


def test_movable_boxes_block_only_where_they_are() -> None:
    crate = Box(0.0, 0.0, 1.0, 1.0, mass=2.0)
    sight = LineOfSight(Arena(20.0, 20.0, boxes=(crate,)))
    a, b = np.array([[-2.0, 0.0]]), np.array([[2.0, 0.0]])
    elsewhere, away = crate.corners + np.array([0.0, 4.0]), np.full((4, 2), np.nan)
    assert sight.is_clear(a, b)[0]
    assert not sight.is_clear(a, b, np.array([away, crate.corners]))[0]
    assert sight.is_clear(a, b, np.array([away, elsewhere]))[0]
    assert sight.is_clear(a, b, np.empty((0, 4, 2)))[0]


def test_many_ways_at_once_are_each_as_alone() -> None:
    rng = np.random.default_rng(3)
    boxes = tuple(Box(x, y, 0.4, 0.2, x) for x, y in rng.uniform(-4.0, 4.0, (30, 2)).tolist())
    sight = LineOfSight(Arena(10.0, 10.0, boxes, (Pole(3.0, -3.0, 0.5),)))
    a, b = rng.uniform(-5.0, 5.0, (2, 3000, 2))
    together = sight.is_clear(a, b)
    alone = [sight.is_clear(a[i : i + 1], b[i : i + 1])[0] for i in range(3000)]
    assert together.tolist() == alone
    assert 0.1 < together.mean() < 0.9

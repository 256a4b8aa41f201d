"""Arenas as a command line names them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.errors import ConfigError
from swarmd.sim.world.arena import Arena, Box, Pole, parse_arena


def test_reads_size_boxes_and_poles() -> None:
    arena = parse_arena("6.6x4.8,box:1:0:0.5:0.3:90,pole:-1:2:0.1,box:0:1:1:1")
    assert (arena.length, arena.width) == (6.6, 4.8)
    assert arena.boxes == (Box(1.0, 0.0, 0.5, 0.3, math.pi / 2.0), Box(0.0, 1.0, 1.0, 1.0, 0.0))
    assert arena.poles == (Pole(-1.0, 2.0, 0.1),)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "wanted is such as 6x6"),
        ("6", "wanted is such as 6x6"),
        ("6x-6", "wanted is such as 6x6"),
        ("6x1.2.3", r"'1\.2\.3' is no number"),
        ("0x6", "a size is 0 m"),
        ("6x6,tree:1:2:3", "neither box nor pole"),
        ("6x6,box:1:2", "neither box nor pole"),
        ("6x6,pole:1:nan:0.1", "'nan' is no number"),
        ("6x6,pole:1:1:-0.1", r"a size is -0\.1 m"),
    ],
)
def test_tells_what_it_cannot_read(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_arena(text)


def test_every_surface_has_its_solid_on_the_left() -> None:
    arena = Arena(4.0, 2.0, boxes=(Box(1.0, 0.2, 0.5, 0.3, 0.7),))
    segments = arena.segments
    assert segments.shape == (8, 2, 2)
    edge = segments[:, 1] - segments[:, 0]
    left = np.stack((-edge[:, 1], edge[:, 0]), axis=-1)
    inside = segments.mean(axis=1) + 0.01 * left / np.hypot(*left.T)[:, None]
    beyond_walls = (np.abs(inside[:4]) > [2.0, 1.0]).any(axis=1)
    assert beyond_walls.all()
    from_center = inside[4:] - [1.0, 0.2]
    assert (np.hypot(*from_center.T) < np.hypot(*(segments[4:].mean(axis=1) - [1.0, 0.2]).T)).all()


def test_circles_are_poles() -> None:
    np.testing.assert_array_equal(
        Arena(4.0, 4.0, poles=(Pole(1.0, 2.0, 0.1),)).circles, [[1.0, 2.0, 0.1]]
    )
    assert Arena(4.0, 4.0).circles.shape == (0, 3)

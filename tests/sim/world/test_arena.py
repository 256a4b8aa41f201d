"""Arenas parsed from and written as text."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.world.arena import Arena, Box, Pole, Segment, parse_arena


def test_an_arena_is_read_from_its_text() -> None:
    arena = parse_arena(
        "6.6x4.8,box/crate:1:0:0.5:0.3:0:2.5,pole:-1:2:0.1,box:0:1:1:1,segment:0:-1:0:1"
        ",box/late:0:0:1:1:90:3:out"
    )
    late = Box(0.0, 0.0, 1.0, 1.0, math.pi / 2.0, name="late", mass=3.0, is_placed=False)
    crate = Box(1.0, 0.0, 0.5, 0.3, name="crate", mass=2.5)
    assert arena == Arena(
        6.6,
        4.8,
        boxes=(crate, Box(0.0, 1.0, 1.0, 1.0), late),
        poles=(Pole(-1.0, 2.0, 0.1),),
        segments=(Segment(0.0, -1.0, 0.0, 1.0),),
    )
    assert [name for name, _ in arena.movable_boxes] == ["crate", "late"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "6x6"),
        ("6x-6", "6x-6"),
        ("6x1.2.3", r"1\.2\.3"),
        ("0x6", "0 m"),
        ("6x6,tree:1:2:3", "'tree:1:2:3'"),
        ("6x6,box:1:2", "'box:1:2'"),
        ("6x6,pole/a:1:2:0.1", "'pole/a:1:2:0.1'"),
        ("6x6,box:1:2:1:1:0:0", "box 0.*mass"),
        ("6x6,box:1:2:1:1:0:2:in", "out"),
        ("6x6,box/a:1:2:1:1,box/a:0:0:1:1", "'a'"),
        ("6x6,box/1:1:2:1:1,box:0:0:1:1", "'1'"),
        ("6x6,box/A b:1:2:1:1", "'A b'"),
        ("6x6,segment:1:1:1:1", "0 m"),
        ("6x6,pole:1:nan:0.1", "nan"),
        ("6x6,pole:1:1:-0.1", r"-0\.1 m"),
    ],
)
def test_an_invalid_arena_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_arena(text)


@pytest.mark.parametrize(
    "text",
    [
        "6x6",
        "6.6x4.8,box:1:0:0.5:0.3:45,box/a:0:1:1:1,pole:-1:2:0.1,segment:0:0.1:1:2",
        "6x6,box/a:1:0:0.5:0.3:0:2,box:-1:0:0.5:0.3:30:1000000:out",
    ],
)
def test_its_text_is_the_parsed_text(text: str) -> None:
    assert parse_arena(text).text == text


def test_its_text_reads_as_the_same_arena_to_the_last_bit() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        x, y, length, width = rng.uniform(0.1, 3.0, 4).tolist()
        box = Box(x, -y, length, width, float(rng.uniform(-7.0, 7.0)), mass=length)
        wall = Segment(*rng.uniform(-3.0, 3.0, 4).tolist())
        arena = Arena(10.0 * length, 10.0 * width, (box,), (Pole(y, x, width),), (wall,))
        assert parse_arena(arena.text) == arena


def test_a_segment_is_a_box_a_centimetre_thick() -> None:
    corners = Segment(1.0, 0.0, 1.0, 2.0).corners
    np.testing.assert_allclose(corners.min(axis=0), [0.995, 0.0], atol=1e-12)
    np.testing.assert_allclose(corners.max(axis=0), [1.005, 2.0], atol=1e-12)


def test_the_polygon_around_a_pole_touches_it_from_outside() -> None:
    corners = Pole(1.0, 2.0, 0.1).corners
    middles = (corners + np.roll(corners, -1, axis=0)) / 2.0
    np.testing.assert_allclose(np.hypot(*(middles - [1.0, 2.0]).T), 0.1)

"""Arenas parsed from and written as text."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.world.arena import Arena, Box, Pole, Segment, parse_arena


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
        ("6x6,tree:1:2:3", "'tree:1:2:3'"),
        ("6x6,box:1:2", "'box:1:2'"),
        ("6x6,pole/a:1:2:0.1", "'pole/a:1:2:0.1'"),
        ("6x6,box:1:2:1:1:0:0", r"box 0 has a mass of 0 kg; wanted 0\.001 to 1e\+06 kg"),
        ("6x6,box:1:2:1:1:0:2:in", "only 'out' may follow"),
        ("6x6,box/a:1:2:1:1,box/a:0:0:1:1", "two boxes named 'a'"),
        ("6x6,box/1:1:2:1:1,box:0:0:1:1", "two boxes named '1'"),
        ("6x6,box/A b:1:2:1:1", "box name is 'A b'"),
        ("6x6,segment:1:1:1:1", "a size is 0 m"),
        ("6x6,pole:1:nan:0.1", "'nan' is no number"),
        ("6x6,pole:1:1:-0.1", r"a size is -0\.1 m"),
    ],
)
def test_an_invalid_arena_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_arena(text)


def test_reads_names_masses_and_inner_walls() -> None:
    arena = parse_arena("6x6,box/crate:1:0:0.5:0.3:0:2.5,segment:0:-1:0:1,box/late:0:0:1:1:9:3:out")
    assert arena.boxes[0] == Box(1.0, 0.0, 0.5, 0.3, name="crate", mass=2.5)
    late = Box(0.0, 0.0, 1.0, 1.0, math.radians(9.0), name="late", mass=3.0, is_placed=False)
    assert arena.boxes[1] == late
    assert arena.segments == (Segment(0.0, -1.0, 0.0, 1.0),)
    assert [name for name, _ in arena.movable_boxes] == ["crate", "late"]


def test_a_box_that_starts_outside_must_be_movable() -> None:
    with pytest.raises(ConfigError, match=r"box a .*mass"):
        Arena(4.0, 4.0, boxes=(Box(0.0, 0.0, 1.0, 1.0, name="a", is_placed=False),))


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


def test_movable_boxes_are_no_fixed_surfaces() -> None:
    fixed, movable = Box(0.0, 0.0, 1.0, 1.0), Box(2.0, 0.0, 1.0, 1.0, mass=1.0)
    arena = Arena(8.0, 8.0, boxes=(movable, fixed), segments=(Segment(0.0, 3.0, 1.0, 3.0),))
    assert [name for name, _ in arena.fixed] == ["box/1", "segment/0"]
    assert arena.surfaces.shape == (4 + 4 + 4, 2, 2)


def test_every_surface_has_its_solid_on_the_left() -> None:
    arena = Arena(4.0, 2.0, boxes=(Box(1.0, 0.2, 0.5, 0.3, 0.7),))
    segments = arena.surfaces
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

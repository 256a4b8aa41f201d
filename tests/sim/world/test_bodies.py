"""The planar bodies of platforms: geometry, inertia and ghosts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.bodies import build_model, heights, inertia, value
from swarmd.sim.world.world import World

NAMES = ("burger", "waffle_pi", "jackal")


@pytest.mark.parametrize(
    ("name", "length", "width"),
    [("burger", 0.138, 0.178), ("waffle_pi", 0.281, 0.306), ("jackal", 0.508, 0.430)],
)
def test_footprints_agree_with_the_makers_outer_sizes(
    name: str, length: float, width: float
) -> None:
    # The makers' tables; the drawings that the footprints are from differ by up to 2 mm.
    corners = load_platform(name).footprint
    size = corners.max(axis=0) - corners.min(axis=0)
    np.testing.assert_allclose(size, [length, width], atol=0.0025)
    np.testing.assert_allclose(corners[:, 1].sum(), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_sensor_and_wheels_fit_the_body(name: str) -> None:
    platform = load_platform(name)
    low, high = platform.footprint.min(axis=0), platform.footprint.max(axis=0)
    reach = value(platform, "target_radius")
    offset = np.array(platform.scan.offset)
    assert (offset - reach >= low).all()
    assert (offset + reach <= high).all()
    assert (
        heights(platform).lowest
        < value(platform, "height")
        < heights(platform).scan_plane
        < heights(platform).highest
    )
    assert value(platform, "wheel_separation") < high[1] - low[1]


def test_inertia_is_that_of_a_plate() -> None:
    jackal = load_platform("jackal")
    assert inertia(jackal) == pytest.approx(17.0 * (0.508**2 + 0.430**2) / 12.0)


def test_a_footprint_that_is_no_rectangle_is_refused() -> None:
    burger = load_platform("burger")
    turn = np.radians([0.0, 120.0, 240.0])
    triangle = Platform(
        "wedge", burger.limits, 0.1 * np.stack((np.cos(turn), np.sin(turn)), axis=-1),
        burger.scan, burger.provides, burger.protection, body=burger.body,
    )  # fmt: skip
    with pytest.raises(ConfigError, match="footprint"):
        build_model({"a": triangle}, Arena(4.0, 4.0), 0.01)


FACING = np.array([[-0.3, 0.0, 0.0], [0.3, 0.0, math.pi]])


def burger(solid: float) -> Platform:
    platform = load_platform("burger")
    return replace(platform, body={**platform.body, "solid": solid})


def after_driving(world: World, seconds: float = 4.0) -> tuple[World, set[str]]:
    """The world after all have driven ahead at 0.2 m/s, and what was touched."""
    world.set_commands(np.tile((0.2, 0.0, 0.0), (len(world.ids), 1)))
    touched = set()
    for _ in range(round(seconds / world.dt)):
        world.step()
        touched |= {contact.b for contact in world.contacts()}
    return world, touched


@pytest.mark.parametrize(
    ("first", "second", "passes"), [(0.0, 0.0, True), (0.0, 1.0, True), (1.0, 1.0, False)]
)
def test_two_pass_if_one_is_a_ghost(first: float, second: float, passes: bool) -> None:
    robots = {"a": burger(first), "b": burger(second)}
    world, touched = after_driving(World(robots, Arena(6.0, 6.0), FACING))
    a, b = world.poses()[:, 0]
    assert bool(a > b) is passes
    assert (touched == set()) is passes


@pytest.mark.parametrize(
    ("arena", "obstacle"),
    [
        ("2x2", "wall/east"),
        ("6x6,box:1:0:0.2:1:0", "box/0"),
        ("6x6,pole:1:0:0.1", "pole/0"),
        ("6x6,segment:1:-1:1:1", "segment/0"),
    ],
)
def test_a_ghost_stops_at_obstacles_of_the_arena(arena: str, obstacle: str) -> None:
    world = World({"a": burger(0.0)}, parse_arena(arena), np.zeros((1, 3)))
    world, touched = after_driving(world, 8.0)
    assert touched == {obstacle}
    assert world.poses()[0, 0] < 1.0


def test_a_ghost_is_seen() -> None:
    robots = {"a": burger(0.0), "b": burger(0.0)}
    world = World(robots, Arena(6.0, 6.0), FACING)
    assert world.scans(np.array([0]))[0].ranges.min() < 0.6


def test_half_a_ghost_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"burger: body\.solid is 0\.5"):
        World({"a": burger(0.5)}, Arena(6.0, 6.0), np.zeros((1, 3)))

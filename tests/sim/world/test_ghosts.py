"""A platform with `solid: 0`: robots pass through each other, and nothing else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.world import World

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
def test_a_ghost_stops_at_what_stands_in_the_arena(arena: str, obstacle: str) -> None:
    world = World({"a": burger(0.0)}, parse_arena(arena), np.zeros((1, 3)))
    world, touched = after_driving(world, 8.0)
    assert touched == {obstacle}
    assert world.poses()[0, 0] < 1.0


def test_a_ghost_is_seen() -> None:
    robots = {"a": burger(0.0), "b": burger(0.0)}
    world = World(robots, Arena(6.0, 6.0), FACING)
    assert world.scans(np.array([0]))[0].ranges.min() < 0.6


def test_half_a_ghost_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"platform burger: body\.solid is 0\.5; wanted 1, or 0"):
        World({"a": burger(0.5)}, Arena(6.0, 6.0), np.zeros((1, 3)))

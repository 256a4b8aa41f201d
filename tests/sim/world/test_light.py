"""Lamps: the distance law, the direction of sensors, and shadows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.light import LightField
from swarmd.sim.world.scalar_fields import GaussianField, sample
from swarmd.sim.world.world import World

LAMP = LightField(name="light", center=(2.0, 0.0), power=3.0)


def test_light_falls_with_the_squared_distance() -> None:
    low = LightField(name="light", power=3.0, height=0.01)
    places = np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    assert sample([low], places)["light"] == pytest.approx([3.0, 0.75, 30_000.0], rel=1e-3)


def test_a_sensor_takes_the_cosine_of_the_angle_to_the_lamp() -> None:
    places = np.zeros((4, 2))
    bearings = np.radians([0.0, 60.0, 90.0, 180.0])
    light = LAMP.at(places, bearings)
    assert light[0] == pytest.approx(3.0 / 4.04 * 2.0 / math.sqrt(4.04))
    assert light[1] == pytest.approx(0.5 * light[0])
    assert light[2:] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    "arena",
    [
        Arena(6.0, 6.0, boxes=(Box(1.0, 0.0, 0.2, 1.0),)),
        Arena(6.0, 6.0, poles=(Pole(1.0, 0.0, 0.1),)),
        Arena(6.0, 6.0, segments=(Segment(1.0, -0.5, 1.0, 0.5),)),
        Arena(6.0, 6.0, boxes=(Box(1.0, 0.0, 0.2, 1.0, mass=2.0),)),
    ],
)
def test_what_stands_between_a_lamp_and_a_robot_hides_the_lamp(arena: Arena) -> None:
    burger = load_platform("burger")
    starts = np.array([[-1.0, 0.0, 0.0], [-1.0, 2.0, 0.0]])
    world = World(dict.fromkeys(("a", "b"), burger), arena, starts, fields=[LAMP])
    assert world.readings(0) == {"light": 0.0}
    assert world.readings(1)["light"] == pytest.approx(3.0 / 13.04)
    high = [replace_shadows(LAMP)]
    assert World({"a": burger}, arena, starts[:1], fields=high).readings(0)["light"] > 0.3


def replace_shadows(lamp: LightField) -> LightField:
    return LightField(name=lamp.name, center=lamp.center, power=lamp.power, shadows=False)


def test_a_robot_hides_the_lamp_from_another_until_it_leaves_and_never_from_itself() -> None:
    burger, thymio = load_platform("burger"), load_platform("thymio")
    starts = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    robots = {"a": burger, "b": thymio, "c": burger}
    world = World(robots, Arena(6.0, 6.0), starts, fields=[LAMP])
    assert [world.readings(row)["light"] > 0.0 for row in range(3)] == [False, True, True]
    world.take_out(1)
    assert world.readings(0)["light"] == pytest.approx(3.0 / 9.04)


def test_sensors_with_bearings_tell_the_side_of_the_lamp() -> None:
    rows = [[0.05, 0.05, math.radians(45.0)], [0.05, -0.05, math.radians(-45.0)]]
    eyed = replace(load_platform("burger"), sensors={"light": np.array(rows)})
    starts = np.array([[0.0, 0.0, math.radians(-90.0)]])  # the lamp is on its left
    readings = World({"a": eyed}, Arena(6.0, 6.0), starts, fields=[LAMP]).readings(0)
    assert readings["light_1"] > 0.4
    assert readings["light_2"] == 0.0
    assert readings["light"] == pytest.approx(readings["light_1"] / 2.0)


def test_changed_fields_take_the_place_of_those_of_their_name() -> None:
    warm = [GaussianField(name="warm", sigma=1.0), GaussianField(name="warm", sigma=1.0)]
    world = World(
        {"a": load_platform("burger")}, Arena(6.0, 6.0), np.zeros((1, 3)), fields=[*warm, LAMP]
    )
    light = world.readings(0)["light"]
    assert world.readings(0)["warm"] == 2.0
    world.change_fields([GaussianField(name="warm", sigma=1.0, peak=5.0)])
    assert world.readings(0) == {"warm": 5.0, "light": light}

"""Scalar fields and readings of robots."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.scalar_fields import (
    Field,
    GaussianField,
    LinearField,
    UniformField,
    sample,
)
from swarmd.sim.world.world import World

PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])


def test_a_gaussian_is_its_peak_in_the_middle_and_its_floor_far_away() -> None:
    field = GaussianField(name="light", center=(1.0, 0.0), sigma=0.5, peak=9.0, floor=1.0)
    values = sample([field], np.array([[1.0, 0.0], [1.0, 0.5], [100.0, 0.0]]))["light"]
    np.testing.assert_allclose(values, [9.0, 1.0 + 8.0 * math.exp(-0.5), 1.0])


def test_a_slope_rises_along_its_direction_alone() -> None:
    field = LinearField(name="depth", origin=(1.0, 0.0), direction_deg=90.0, slope=2.0, base=5.0)
    np.testing.assert_allclose(sample([field], PLACES)["depth"], [5.0, 5.0, 9.0])


def test_fields_of_one_name_add_up_and_others_stay_apart() -> None:
    fields: list[Field] = [
        UniformField(name="light", value=1.0),
        UniformField(name="quality", value=3.0),
        LinearField(name="light", slope=1.0),
    ]
    values = sample(fields, PLACES)
    assert list(values) == ["light", "quality"]
    np.testing.assert_allclose(values["light"], [1.0, 2.0, 2.0])
    np.testing.assert_allclose(values["quality"], 3.0)


def test_readings_stay_within_the_bounds_of_the_wire() -> None:
    field = LinearField(name="light", slope=1e6)
    np.testing.assert_array_equal(sample([field], np.array([[9.0, 0.0]]))["light"], [1e6])


def test_a_robot_reads_the_fields_at_its_present_position() -> None:
    fields = (LinearField(name="light", slope=2.0), UniformField(name="quality", value=0.5))
    starts = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, math.pi]])
    robots = dict.fromkeys(("a", "b"), load_platform("burger"))
    world = World(robots, Arena(8.0, 8.0), starts, fields=fields)
    assert world.readings(0) == {"light": 2.0, "quality": 0.5}
    world.set_commands(np.full((2, 3), [0.2, 0.0, 0.0]))
    world.step(300)
    x = world.poses()[:, 0]
    assert x[0] > 1.5
    assert [world.readings(row)["light"] for row in (0, 1)] == pytest.approx((2.0 * x).tolist())
    assert World(robots, Arena(8.0, 8.0), starts).readings(0) == {}

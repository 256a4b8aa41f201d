"""What robots recognise in the simulated world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Detection, Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena, Box
from swarmd.sim.world.light import LightField
from swarmd.sim.world.scalar_fields import Field
from swarmd.sim.world.sensors import SENSORS, detections
from swarmd.sim.world.world import World

BURGER = load_platform("burger")


def eyes(*sensors: tuple[float, float, float, float, float]) -> Platform:
    """A Burger with sensors at x and y that look in a direction, with field of view and range."""
    return replace(BURGER, sensors={"detections": np.array(sensors)})


AHEAD = eyes((0.1, 0.0, 0.0, math.radians(90.0), 3.0))


def world(
    starts: list[tuple[float, float, float]],
    platform: Platform = AHEAD,
    arena: Arena = Arena(12.0, 12.0),  # noqa: B008
    fields: Sequence[Field] = (),
) -> World:
    robots = {f"r-{n}": platform for n in range(len(starts))}
    return World(robots, arena, np.array(starts), fields=fields)


def seen(one: World, robot: int = 0) -> dict[str, Detection]:
    input = detections(one, robot, 0.0)
    assert input is not None
    return {detection.id: detection for detection in input.detections or ()}


def test_a_robot_without_such_a_sensor_recognises_nothing() -> None:
    plain = world([(0.0, 0.0, 0.0)], BURGER)
    assert detections(plain, 0, 0.0) is None
    assert not any(sensor.need and sensor.is_there(plain) for sensor in SENSORS)


def test_robots_within_view_and_range_are_recognised_from_the_axle() -> None:
    starts = [(0.0, 0.0, math.pi / 2), (0.0, 2.0, 0.0), (-1.0, 2.0, 0.0), (3.0, 0.5, 0.0),
              (0.0, -1.0, 0.0), (0.5, 4.0, 0.0)]  # fmt: skip
    found = seen(world(starts))
    assert sorted(found) == ["r-1", "r-2"]
    assert found["r-1"].kind == "robot"
    assert (found["r-1"].bearing, found["r-1"].distance) == pytest.approx((0.0, 2.0))
    assert found["r-2"].bearing == pytest.approx(math.atan2(1.0, 2.0))
    assert found["r-2"].distance == pytest.approx(math.sqrt(5.0))


def test_walls_boxes_and_robots_hide_what_is_behind() -> None:
    starts = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
    assert sorted(seen(world(starts))) == ["r-2"]
    behind = Arena(12.0, 12.0, boxes=(Box(1.0, 0.0, 0.1, 1.0),))
    assert seen(world(starts[:2], arena=behind)) == {}


def test_boxes_and_lamps_are_recognised_by_kind() -> None:
    crate = Box(2.0, 0.5, 0.3, 0.3, name="crate", mass=1.0)
    arena = Arena(12.0, 12.0, boxes=(crate,))
    lamp = LightField(name="light", center=(2.0, -0.5))
    found = seen(world([(0.0, 0.0, 0.0)], arena=arena, fields=[lamp]))
    assert {name: one.kind for name, one in found.items()} == {"crate": "box", "light": "lamp"}


def test_two_sensors_see_a_robot_once() -> None:
    wide = math.radians(180.0)
    both = eyes((0.0, 0.0, 0.0, wide, 3.0), (0.0, 0.0, math.pi, wide, 3.0))
    robots = world([(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)], both)
    input = detections(robots, 0, 0.0)
    assert input is not None
    assert sorted(one.id for one in input.detections or ()) == ["r-1", "r-2"]


def test_a_robot_that_was_taken_out_is_not_recognised() -> None:
    one = world([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    assert sorted(seen(one)) == ["r-1"]
    one.take_out(1)
    assert seen(one) == {}


def test_a_robot_beside_is_recognised_though_extents_overlap() -> None:
    found = seen(world([(0.0, 0.0, 0.0), (0.25, 0.0, 0.0)]))
    assert found["r-1"].distance == pytest.approx(0.25)

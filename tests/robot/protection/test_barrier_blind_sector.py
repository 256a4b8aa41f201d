"""A lidar with 20 degrees of zeros ahead, and a thin pole in them; a lidar that sees a post."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from msgspec.structs import replace

from swarmd.core.values import Pose, Scan, Twist
from swarmd.settings.platforms import load_platform
from tests.support.filter_sim import FilterSim, box, pole, under_barrier
from tests.support.kernel_forms import long_run

pytestmark = long_run

BURGER = under_barrier(load_platform("burger"))
WALLS = tuple(
    box(*(0.1, 4.0) if k % 2 == 0 else (4.0, 0.1), Pose(x, y))
    for k, (x, y) in enumerate(((2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)))
)


class Covered(FilterSim):
    """Rays within 10 degrees of ahead have zeros, always."""

    def scan(self) -> Scan:
        scan = super().scan()
        is_dead = np.abs(np.angle(np.exp(1j * scan.bearings))) < math.radians(10.0)
        return replace(scan, ranges=np.where(is_dead, 0.0, scan.ranges))


def drive(sim: FilterSim) -> float:
    """The speed in m/s at which the robot meets a pole of 3 cm; 0 if it does not."""
    touch = sim.run(Twist(0.22), 8.0).touch
    return 0.0 if touch is None else touch.speed


def test_a_robot_that_has_turned_does_not_drive_into_a_pole_that_it_cannot_see() -> None:
    shapes = (*WALLS, pole(0.015, Pose(1.2)))
    sim = Covered(BURGER, shapes)
    sim.run(lambda _: Twist(0.0, 2.0), 18.0)
    sim.run(lambda _: Twist(0.0, -math.remainder(sim.pose.yaw, math.tau)), 3.0)
    assert "deg have not returned anything" in sim.sensors.blind_text
    assert drive(sim) <= 0.02
    assert drive(Covered(BURGER, shapes)) > 0.15  # it cannot know without a turn


class OwnPost(FilterSim):
    """Rays from 69 to 73 degrees end at a post of the robot, 0.05 m from the lidar."""

    def scan(self) -> Scan:
        scan = super().scan()
        is_post = np.abs(np.angle(np.exp(1j * (scan.bearings - math.radians(71.0))))) < 0.04
        return replace(scan, ranges=np.where(is_post, 0.05, scan.ranges))


def test_a_robot_whose_lidar_sees_a_post_of_its_own_drives_with_a_mask_alone() -> None:
    spec = dataclasses.replace(BURGER.scan, mask=((math.radians(68.0), math.radians(74.0)),))
    held = OwnPost(BURGER, WALLS)
    masked = OwnPost(dataclasses.replace(BURGER, scan=spec), WALLS)
    for sim, seconds in ((held, 2.0), (masked, 8.0)):
        assert sim.run(Twist(0.22), seconds).touch is None
    assert abs(held.pose.x) <= 0.015 * 2.0  # the post is a contact, beside which it creeps
    assert masked.pose.x > 1.0

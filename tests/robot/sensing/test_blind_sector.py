"""Blind sectors: found while the robot turns past things, and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Twist
from swarmd.robot.sensing.blind_sector import BlindSectors
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, scan_from, scan_of

BURGER = load_platform("burger")
SPEC = BURGER.scan
Things = Callable[[float], tuple[Disc, ...]]


class Turning:
    """A robot that turns at `rate` rad/s: a scan each 0.2 s, with zeros for rays without return."""

    def __init__(self, things: Things, room: float | None, dead: slice | None, rate: float) -> None:
        self.things, self.room, self.dead, self.rate = things, room, dead, rate
        self.sectors, self.time, self.rng = BlindSectors(SPEC), 0.0, np.random.default_rng(5)
        self.loss = 0.0

    def raw(self) -> Array:
        pose = Pose(0.3, -0.2, self.rate * self.time)
        scan = scan_of(BURGER, self.things(self.time), room=self.room, pose=pose)
        ranges = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0)
        ranges[self.rng.random(len(ranges)) < self.loss] = 0.0
        if self.dead is not None:
            ranges = np.roll(ranges, 180)
            ranges[self.dead] = 0.0
            ranges = np.roll(ranges, -180)
        return ranges

    def run(self, seconds: float) -> Array:
        found = np.empty(0)
        for _ in range(round(seconds / 0.2)):
            self.time += 0.2
            odometry = Odometry(self.time, Pose(0.3, -0.2, self.rate * self.time), Twist())
            found = self.sectors.take(self.raw(), SPEC.bearings, odometry, self.time)
        return found


def nothing(time: float) -> tuple[Disc, ...]:
    return ()


AHEAD = slice(170, 190)  # of rays from behind: 20 degrees ahead


@pytest.mark.parametrize("rate", [0.5, -1.0, 2.0])
def test_a_dead_sector_is_found_within_two_turns_or_twenty_seconds(rate: float) -> None:
    robot = Turning(nothing, 3.0, AHEAD, rate)
    found = robot.run(max(2.0 * math.tau / abs(rate), 20.0))
    degrees = np.rint(np.degrees(SPEC.bearings[np.isnan(found)])) % 360
    assert set(degrees) <= {*range(350, 360), *range(10)}
    assert len(degrees) >= 16
    assert "rays 352..8 deg have not returned anything for" in robot.sectors.text


def test_one_return_keeps_a_sector_and_three_clear_it() -> None:
    robot = Turning(nothing, 3.0, AHEAD, 1.0)
    robot.run(20.0)
    assert robot.sectors.text
    robot.dead = None
    robot.rate = 0.0  # a robot that is held does not turn
    robot.run(0.4)
    assert robot.sectors.text
    assert not np.isnan(robot.run(0.2)).any()
    assert not robot.sectors.text


def moving(time: float) -> tuple[Disc, ...]:
    return tuple(
        Disc(1.5 * math.cos(0.4 * time + k), 1.5 * math.sin(0.4 * time + k), 0.1) for k in range(5)
    )


def poles(time: float) -> tuple[Disc, ...]:
    return tuple(Disc(2.5 * math.cos(k), 2.5 * math.sin(k), 0.01) for k in range(12))


def door(time: float) -> tuple[Disc, ...]:
    return tuple(Disc(2.0 * math.cos(k / 12), 2.0 * math.sin(k / 12), 0.12) for k in range(50))


@pytest.mark.parametrize("rate", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("things", [nothing, moving, poles, door])
def test_a_whole_sensor_has_no_blind_sector(things: Things, rate: float) -> None:
    robot = Turning(things, None, None, rate)
    robot.loss = 0.1
    for _ in range(300):
        robot.run(0.2)
        assert not robot.sectors.text


def test_nothing_is_found_in_an_open_field() -> None:
    robot = Turning(nothing, None, AHEAD, 1.0)
    robot.run(60.0)
    assert not robot.sectors.text


def test_conditioning_rejects_a_blind_sector_wider_than_max_gap() -> None:
    robot, conditioner = Turning(nothing, 3.0, AHEAD, 1.0), ScanConditioner(SPEC)
    results = []
    for seq in range(140):
        robot.time += 0.2
        yaw = min(robot.time, 25.0)  # while it turns, others have just seen what the sector misses
        robot.rate = yaw / robot.time
        ranges = robot.raw() + 1e-6 * (seq % 50) * (robot.raw() > 0.0)
        scan = scan_from(BURGER, ranges, SPEC.bearings, seq=seq)
        odometry = Odometry(robot.time, Pose(0.3, -0.2, yaw), Twist())
        results.append(conditioner.take(scan, odometry, robot.time))
    assert Reason.INVALID_SCAN not in results[:125]
    assert results[-1] is Reason.INVALID_SCAN
    assert "352..8" in conditioner.blind_text

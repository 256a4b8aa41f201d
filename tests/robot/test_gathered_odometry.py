"""Odometry that is handed over just before a decision, with the time at which it arrived."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.clock import TICK
from swarmd.core.events import TICK_INPUT, HostInput, Input, OdometryInput, ScanInput, TickInput
from swarmd.core.values import Inputs, Odometry, Outputs, Pose, Twist
from swarmd.kit.behavior import Pattern
from swarmd.robot.actions import Actions
from swarmd.robot.protection.decision import DecisionContext
from swarmd.robot.robot import Robot
from swarmd.testing.scans import Disc, scan_of, trembling
from tests.support.robot_harness import RobotHarness, moved

STEP = 0.01  # s
DECIDING = (TickInput, ScanInput, HostInput)


class Circling(Pattern[Any]):
    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(Twist(0.15, 0.5))


class Gathering:
    """Steps a robot; if `is_on`, readings wait until a decision, as a `GatheringDriver` has them.

    `seen`: after each decision its kind, the actions, and the inputs of protection with their ages.
    """

    def __init__(self, *, is_on: bool) -> None:
        self.is_on = is_on
        self.waiting: list[tuple[Input, float]] = []
        self.seen: list[tuple[type[Input], Twist, DecisionContext]] = []

    def __call__(self, robot: Robot, input: Input, now: float) -> Actions | None:
        if self.is_on and isinstance(input, OdometryInput):
            self.waiting.append((input, now))
            return None
        if isinstance(input, DECIDING):
            for reading, arrival in self.waiting:
                robot.step(reading, arrival)
            self.waiting.clear()
        actions = robot.step(input, now)
        if actions is not None:
            self.seen.append((type(input), actions.twist, robot._sensors.context(now)))
        return actions


def drive(
    gathering: Gathering, odometry_phase: float, scan_phase: float
) -> list[tuple[type[Input], Twist, DecisionContext]]:
    """What the robot decides in 6 s of a circle past a disc, ticks at multiples of 50 ms."""
    harness = RobotHarness("burger", {"circling": Circling}, take=gathering)
    begin, pose, seq = harness.now, Pose(), 0
    for count in range(1, round(6.0 / STEP)):
        past = round(count * STEP, 9)
        harness.now = round(begin + past, 9)
        pose = moved(pose, harness.twist, STEP)
        if is_due(past, TICK, odometry_phase):
            harness.step(OdometryInput(Odometry(past, pose, harness.twist)))
        if is_due(past, 0.2, scan_phase):
            seq += 1
            disc = Disc(0.55, 0.25, 0.1)
            scan = scan_of(harness.platform, [disc], room=2.0, pose=pose, seq=seq)
            harness.scan(replace(scan, stamp=past, ranges=trembling(scan.ranges, seq)))
        if is_due(past, TICK, 0.0):
            harness.step(TICK_INPUT)
        if count == round(1.0 / STEP):
            assert harness.applied("run", pattern="circling")
    return gathering.seen


def is_due(past: float, period: float, phase: float) -> bool:
    return abs((past - phase + 0.5 * period) % period - 0.5 * period) < 1e-6


@pytest.mark.parametrize(
    ("odometry", "scan"), [(0.01, 0.03), (0.03, 0.01), (0.04, 0.04), (0.0, 0.02)]
)
def test_each_decision_is_that_of_odometry_taken_at_its_arrival(
    odometry: float, scan: float
) -> None:
    gathered = drive(Gathering(is_on=True), odometry, scan)
    assert gathered == drive(Gathering(is_on=False), odometry, scan)
    driving = [context for _, twist, context in gathered if twist.linear > 0.0]
    assert len(driving) > 40
    ages = [context.odometry_age for context in driving]
    # Readings come each 50 ms: none that has arrived is left out.
    assert all(age is not None and age < TICK - 0.5 * STEP for age in ages)

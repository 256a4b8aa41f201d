"""Driving straight on."""

from __future__ import annotations

from dataclasses import replace

from swarmd.core.values import Inputs, Limits, Twist
from swarmd.patterns.drive.pattern import Drive
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestDrive(PatternContract):
    pattern = Drive


def drive(**params: float) -> Twist | None:
    pattern = Subject(Drive, load_platform("burger"), params).make()
    return pattern.step(Inputs(now=0.0, dt=0.0)).twist


def test_drives_at_the_platforms_speed_by_default() -> None:
    assert drive() == Twist(linear=0.22)


def test_drives_a_circle_with_a_turn_rate() -> None:
    assert drive(speed=0.1, turn=-0.5) == Twist(linear=0.1, angular=-0.5)


def test_a_fast_platform_is_driven_no_faster_than_ros2swarm_did() -> None:
    fast = replace(load_platform("jackal"), limits=Limits(linear=2.0, angular=4.0))
    assert Drive.defaults(fast) == {"speed": 0.5}

"""One-bit aggregation: the command for one scan."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Twist, Value
from swarmd.patterns.one_bit_aggregation.pattern import OneBitAggregation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")


class TestOneBitAggregation(PatternContract):
    pattern = OneBitAggregation


def requested(*discs: Disc, room: float | None = None, **params: Value) -> Twist:
    """The first requested command among these robots and walls."""
    pattern = Subject(OneBitAggregation, BURGER, params).make()
    scan = scan_of(BURGER, discs, room=room)
    twist = pattern.step(Inputs(now=0.0, dt=0.0, scan=scan, is_new_scan=True)).twist
    assert twist is not None
    return twist


def test_backs_along_the_circle_of_the_source_without_a_robot_ahead() -> None:
    twist = requested()
    body = 0.5 * math.hypot(0.14, 0.178)
    assert twist.linear == pytest.approx(-0.85 * 0.22)
    assert twist.angular == pytest.approx(twist.linear / (3.905 * body), rel=1e-3)


def test_turns_clockwise_on_the_spot_with_a_robot_ahead() -> None:
    twist = requested(Disc(1.5, 0.0))
    assert twist.linear == 0.0
    assert twist.angular == pytest.approx(-2.0 * math.radians(5.0) * 5.0)


@pytest.mark.parametrize("bearing", [-0.2, 0.2, 1.5, 3.1])
def test_a_robot_aside_or_behind_is_not_seen(bearing: float) -> None:
    assert requested(Disc(1.5 * math.cos(bearing), 1.5 * math.sin(bearing))).linear < 0.0


def test_a_wall_and_a_robot_beyond_the_sight_are_not_seen() -> None:
    assert requested(room=2.0).linear < 0.0
    assert requested(Disc(1.5, 0.0), sight=1.0).linear < 0.0

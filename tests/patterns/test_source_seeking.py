"""Source seeking: runs while the reading rises, tumbles where it falls, stands at the source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Scan, Twist, Value
from swarmd.patterns.source_seeking.pattern import SourceSeeking
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
PLATFORM = replace(BURGER, provides=BURGER.provides | {"reading:concentration"})
FREE = scan_of(PLATFORM)


class TestSourceSeeking(PatternContract):
    pattern = SourceSeeking


def run(
    read: Callable[[float], float],
    seconds: float,
    scan: Scan = FREE,
    *,
    seed: int = 0,
    **params: Value,
) -> list[Twist]:
    """The commands at 10 Hz for what the sensor reads at each time."""
    pattern: Any = Subject(SourceSeeking, PLATFORM, params).make(seed)
    return [
        pattern.step(
            Inputs(now=now, dt=0.1, scan=scan, readings={"concentration": read(now)})
        ).twist
        for now in np.arange(0.0, seconds, 0.1).tolist()
    ]


def test_runs_straight_while_the_reading_rises_or_stays() -> None:
    for read in (lambda now: now, lambda now: 1.0):
        assert set(run(read, 30.0)) == {Twist(linear=BURGER.limits.linear)}


def test_tumbles_to_both_sides_by_angles_within_the_bounds_where_it_falls() -> None:
    twists = run(lambda now: -now, 200.0, turn=1.0, least_angle=0.5, most_angle=1.5)
    is_turn = np.array([twist.angular != 0.0 for twist in twists]).astype(int)
    edges = np.flatnonzero(np.diff(is_turn, prepend=0, append=0))
    angles = 0.1 * (edges[1::2] - edges[::2])
    assert len(angles) > 20
    assert angles.min() >= 0.4
    assert angles.max() <= 1.7
    assert {np.sign(twist.angular) for twist in twists if twist.angular} == {-1.0, 1.0}


def test_compares_once_a_period() -> None:
    twists = run(lambda now: 1.0 if now % 2.0 < 0.95 else 0.0, 20.0, period=2.0)
    assert all(twist.linear > 0.0 for twist in twists)


@pytest.mark.parametrize(("side", "turn"), [(0.2, -1.0), (-0.2, 1.0)])
def test_turns_away_from_an_obstacle_ahead(side: float, turn: float) -> None:
    twists = run(lambda now: now, 0.5, scan_of(PLATFORM, [Disc(0.45, side)]))
    assert all(np.sign(twist.angular) == turn for twist in twists)


def test_stands_where_the_reading_is_enough() -> None:
    twists = run(lambda now: now, 20.0, enough=10.0)
    assert all(twist.linear > 0.0 for twist in twists[:100])
    assert set(twists[101:]) == {Twist()}


def test_a_least_angle_beyond_the_largest_is_refused() -> None:
    with pytest.raises(ConfigError, match="least_angle"):
        run(lambda now: 0.0, 1.0, least_angle=2.0, most_angle=1.0)


def test_without_a_turn_it_stands_once_the_reading_falls() -> None:
    assert run(lambda now: -now, 5.0, turn=0.0)[-1] == Twist()

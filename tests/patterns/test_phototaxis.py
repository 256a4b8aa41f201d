"""Phototaxis: turns to the brighter side or from it, stands at the lamp, searches in the dark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Inputs, Scan, Twist, Value
from swarmd.patterns.phototaxis.pattern import Phototaxis
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
EYES = {"reading:light_1", "reading:light_2"}
PLATFORM = replace(BURGER, provides=BURGER.provides | EYES)
FREE = scan_of(PLATFORM)
LEFT, RIGHT, AHEAD, DARK = (0.8, 0.2), (0.2, 0.8), (0.7, 0.7), (0.0, 0.0)


class TestPhototaxis(PatternContract):
    pattern = Phototaxis


class TestAntiphototaxis(PatternContract):
    pattern = Phototaxis
    params = {"sense": "away"}  # noqa: RUF012 - read only


def run(
    see: Callable[[float], tuple[float, float]],
    seconds: float = 1.0,
    scan: Scan = FREE,
    **params: Value,
) -> list[Twist]:
    """The commands at 10 Hz for what the eyes read at each time."""
    pattern: Any = Subject(Phototaxis, PLATFORM, params).make()
    twists = []
    for now in np.arange(0.0, seconds, 0.1).tolist():
        left, right = see(now)
        readings = {"light_1": left, "light_2": right}
        twists.append(pattern.step(Inputs(now=now, dt=0.1, scan=scan, readings=readings)).twist)
    return twists


@pytest.mark.parametrize(
    ("sense", "light", "turn"),
    [("towards", LEFT, 1.0), ("towards", RIGHT, -1.0), ("away", LEFT, -1.0), ("away", RIGHT, 1.0)],
)
def test_turns_to_the_brighter_eye_or_from_it(
    sense: str, light: tuple[float, float], turn: float
) -> None:
    assert {np.sign(twist.angular) for twist in run(lambda now: light, sense=sense)} == {turn}


def test_drives_straight_at_a_lamp_ahead_and_turns_on_the_spot_to_flee_it() -> None:
    assert run(lambda now: AHEAD)[-1] == Twist(linear=BURGER.limits.linear)
    assert run(lambda now: AHEAD, sense="away")[-1].linear == 0.0


def test_stands_where_it_is_bright_enough_until_it_is_darker() -> None:
    twists = run(lambda now: AHEAD if now < 1.0 else (0.3, 0.3), 2.0, bright=1.2)
    assert all(twist == Twist() for twist in twists[:10])
    assert all(twist.linear > 0.0 for twist in twists[10:])


def test_in_the_dark_it_turns_around_at_least_once_then_drives_on() -> None:
    twists = run(lambda now: DARK, 8.0, turn=2.0, straight=1.0)
    turning = [twist.angular != 0.0 for twist in twists]
    first = turning.index(False)
    assert 0.1 * first >= 3.1  # once around at 2 rad/s
    assert all(twist.linear > 0.0 for twist in twists[first : first + 9])
    assert any(turning[first + 10 :])


def test_a_lamp_that_appears_ends_the_search() -> None:
    twists = run(lambda now: DARK if now < 1.0 else AHEAD, 2.0)
    assert twists[5].linear == 0.0
    assert twists[-1].linear > 0.0


def test_away_in_the_dark_it_drives_on() -> None:
    assert all(twist.linear > 0.0 for twist in run(lambda now: DARK, sense="away"))


def test_passes_an_obstacle_on_its_free_side() -> None:
    twists = run(lambda now: AHEAD, scan=scan_of(PLATFORM, [Disc(0.45, 0.1)]))
    assert all(twist.angular < 0.0 for twist in twists)


def test_light_at_or_below_dark_counts_as_none() -> None:
    assert run(lambda now: (0.05, 0.05), dark=0.1)[-1].linear == 0.0


def test_without_a_turn_it_stands_in_the_dark() -> None:
    assert set(run(lambda now: DARK, turn=0.0)) == {Twist()}

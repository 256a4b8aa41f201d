"""What a sensor that is blind nearby remembers: Jackal's, which sees nothing within 0.8 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.protection.memory import LASTS, NearMemory
from swarmd.settings import load_platform
from swarmd.testing.scans import scan_from

JACKAL = load_platform("jackal")
PERIOD = 0.1
WIDE = range(-15, 16)


def remembering() -> NearMemory:
    return NearMemory(JACKAL.scan.range_min)


def look(
    memory: NearMemory,
    things: dict[int, float],
    turned: float = 0.0,
    seconds: float = PERIOD,
    beyond: float = 4.0,
) -> list[int]:
    """One more scan: ranges by degrees, `beyond` elsewhere; where something is remembered."""
    ranges = np.full(360, beyond)
    for degrees, distance in things.items():
        ranges[degrees % 360] = distance
    memory.update(scan_from(JACKAL, ranges, JACKAL.scan.bearings), turned, seconds)
    degrees = np.rint(np.degrees(memory.bearings)).astype(int)
    return sorted(((degrees + 180) % 360 - 180).tolist())


def entered(beyond: float = 4.0) -> NearMemory:
    """One before which something was at 0.85 m, and then gave no return any more."""
    memory = remembering()
    look(memory, dict.fromkeys(WIDE, 0.85), beyond=beyond)
    look(memory, dict.fromkeys(WIDE, math.inf), beyond=beyond)
    return memory


def test_what_gives_no_return_any_more_where_something_was_near_is_hidden() -> None:
    memory = entered()
    assert len(memory.bearings) == len(WIDE)
    assert memory.ages == pytest.approx(np.full(len(WIDE), PERIOD))


def test_what_was_not_near_has_not_come_in() -> None:
    memory = remembering()
    look(memory, dict.fromkeys(WIDE, 1.2))
    assert not look(memory, dict.fromkeys(WIDE, math.inf))


def test_what_is_still_seen_near_by_is_not_hidden() -> None:
    memory = remembering()
    look(memory, dict.fromkeys(WIDE, 0.85), beyond=math.inf)
    assert not look(memory, {degrees + 4: 0.83 for degrees in WIDE}, beyond=math.inf)


def test_it_keeps_its_place_while_the_robot_turns() -> None:
    memory = entered()
    shadow = dict.fromkeys((degrees - 9 for degrees in WIDE), math.inf)
    assert look(memory, shadow, turned=math.radians(9.0)) == [degrees - 9 for degrees in WIDE]


def test_it_moves_with_its_shadow() -> None:
    memory = entered()
    for step in range(1, 20):
        shadow = [degrees + 8 * step for degrees in WIDE]
        hidden = look(memory, dict.fromkeys(shadow, math.inf))
        assert hidden
        assert set(hidden) <= {(degrees + 180) % 360 - 180 for degrees in shadow}


def test_a_return_from_beyond_shows_that_it_has_gone() -> None:
    memory = entered()
    assert not look(memory, {})


def test_rays_lost_one_by_one_do_not_keep_it() -> None:
    memory = entered()
    assert not look(memory, {0: math.inf, 3: math.inf, 4: math.inf})


def test_where_nothing_is_seen_beyond_it_may_be_there_still() -> None:
    memory = entered(beyond=math.inf)
    for _ in range(50):
        assert look(memory, {}, beyond=math.inf)


def test_it_does_not_spread_where_nothing_is_seen() -> None:
    memory = entered(beyond=math.inf)
    for _ in range(50):
        assert look(memory, {}, beyond=math.inf) == list(WIDE)


def test_what_is_seen_outside_again_is_not_inside() -> None:
    memory = entered(beyond=math.inf)
    assert not look(memory, dict.fromkeys(WIDE, 0.82), beyond=math.inf)


def test_it_is_forgotten_in_time() -> None:
    memory = entered(beyond=math.inf)
    assert look(memory, {}, seconds=LASTS - 1.0, beyond=math.inf)
    assert not look(memory, {}, seconds=2.0, beyond=math.inf)

"""Where a pattern may touch: what it asks for, as far as it is granted."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.angles import difference
from swarmd.core.errors import PluginError
from swarmd.core.values import TouchZone
from swarmd.kit.touch import check_zone, describe_zone, effective_zone, granted_zones, intersection
from swarmd.kit.touch_config import TouchSection

NARROW = TouchZone(0.0, math.radians(20.0), 0.1)
ANGLES = st.floats(-10.0, 10.0)
WIDTHS = st.floats(0.01, math.radians(60.0))


def degrees(bearing: float, half_width: float, speed: float = 0.1) -> TouchZone:
    return TouchZone(math.radians(bearing), math.radians(half_width), speed)


def in_degrees(zone: TouchZone | None) -> Any:
    if zone is None:
        return None
    bearing, half_width = math.degrees(zone.bearing), math.degrees(zone.half_width)
    return pytest.approx((bearing, half_width, zone.speed), abs=1e-9)


@pytest.mark.parametrize(
    ("asked", "granted", "both"),
    [
        (degrees(0, 20), degrees(0, 20), (0, 20, 0.1)),
        (degrees(0, 20, 0.3), degrees(0, 60, 0.05), (0, 20, 0.05)),
        (degrees(0, 60, 0.05), degrees(0, 20, 0.3), (0, 20, 0.05)),
        (degrees(0, 20), degrees(30, 20), (15, 5, 0.1)),
        (degrees(30, 20), degrees(0, 20), (15, 5, 0.1)),
        (degrees(170, 20), degrees(-170, 20), (-180, 10, 0.1)),
        (degrees(0, 10), degrees(20, 10), None),
        (degrees(0, 60), degrees(180, 60), None),
    ],
)
def test_intersection_has_common_directions_at_the_lower_speed(
    asked: TouchZone, granted: TouchZone, both: tuple[float, float, float] | None
) -> None:
    assert in_degrees(intersection(asked, granted)) == both


@given(ANGLES, WIDTHS, ANGLES, WIDTHS, ANGLES)
def test_a_direction_is_allowed_only_where_both_zones_have_it(
    asked: float, wide: float, granted: float, broad: float, direction: float
) -> None:
    both = intersection(TouchZone(asked, wide, 0.1), TouchZone(granted, broad, 0.1))
    inside = [
        broadness - abs(difference(direction, middle))
        for middle, broadness in ((asked, wide), (granted, broad))
    ]
    own = -math.pi if both is None else both.half_width - abs(difference(direction, both.bearing))
    if min(map(abs, inside)) > 1e-9:  # an edge belongs to either side, by rounding
        assert (own > 0.0) == (min(inside) > 0.0)


@given(st.floats(), st.floats(), st.floats(), WIDTHS)
def test_intersection_lies_within_the_granted_zone(
    bearing: float, half_width: float, speed: float, broad: float
) -> None:
    granted = TouchZone(0.5, broad, 0.1)
    both = intersection(TouchZone(bearing, half_width, speed), granted)
    if both is not None:
        assert 0.0 < both.speed <= granted.speed
        assert 0.0 < both.half_width <= broad
        assert abs(difference(both.bearing, 0.5)) + both.half_width <= broad + 1e-9


def test_a_pattern_without_a_zone_gets_no_line() -> None:
    assert effective_zone("drive", None, NARROW) == (None, "")


def test_without_a_grant_the_line_names_the_key() -> None:
    zone, text = effective_zone("push", NARROW, None)
    assert zone is None
    assert "asks to touch +-20 deg ahead at up to 0.10 m/s, which is not granted" in text
    assert "`touch: {push: ...}` in the robot's configuration" in text


def test_a_disjoint_grant_is_reported_with_both_zones() -> None:
    zone, text = effective_zone("push", NARROW, degrees(90, 30))
    assert zone is None
    assert "+-20 deg ahead" in text
    assert "+-30 deg around 90 deg" in text


@pytest.mark.parametrize(
    ("zone", "words"),
    [
        (NARROW, "+-20 deg ahead at up to 0.10 m/s"),
        (degrees(-45, 8), "+-8 deg around -45 deg at up to 0.10 m/s"),
        (degrees(180, 20, 0.05), "+-20 deg behind at up to 0.05 m/s"),
        (degrees(-180, 20, 0.05), "+-20 deg behind at up to 0.05 m/s"),
    ],
)
def test_a_zone_in_words(zone: TouchZone, words: str) -> None:
    assert describe_zone(zone) == words


def test_null_revokes_a_grant() -> None:
    section = TouchSection(bearing_deg=90.0, half_width_deg=20.0, speed=0.1)
    assert granted_zones({"push": section, "dock": None}) == {"push": degrees(90, 20)}


@pytest.mark.parametrize(
    "zone",
    [
        TouchZone(math.nan, 0.3, 0.1),
        TouchZone(0.0, 0.0, 0.1),
        TouchZone(0.0, math.radians(61.0), 0.1),
        TouchZone(0.0, math.nan, 0.1),
        TouchZone(0.0, 0.3, 0.0),
        TouchZone(0.0, 0.3, 0.31),
        TouchZone(0.0, 0.3, math.inf),
        (0.0, 0.3, 0.1),
        True,
    ],
)
def test_a_zone_beyond_the_limits_is_refused(zone: object) -> None:
    with pytest.raises(PluginError, match="'push': touches is") as caught:
        check_zone("push", zone)
    assert "\n" not in str(caught.value)


def test_a_zone_at_the_limits_is_accepted() -> None:
    check_zone("push", TouchZone(math.pi, math.radians(60.0), 0.3))

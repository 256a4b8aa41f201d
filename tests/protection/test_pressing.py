"""How fast an outline presses into the directions of a touch zone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, TouchZone
from swarmd.protection.constraints import touch_directions
from swarmd.settings.settings import load_platform

BURGER = load_platform("burger").footprint
SPEED = st.floats(-2.0, 2.0)


def pushing(corners: Array, zone: TouchZone, v: float, w: float) -> float:
    """The highest speed in m/s at which the outline presses, as the rows have it."""
    press = touch_directions(corners, zone)
    return float((press.nx * (v - w * press.y) + press.ny * w * press.x).max())


@pytest.mark.parametrize(
    ("bearing", "twist", "speed"),
    [
        (0.0, (0.2, 0.0), 0.2),
        (0.0, (-0.2, 0.0), -0.2 * math.cos(math.radians(20.0))),
        (180.0, (-0.2, 0.0), 0.2),
        (90.0, (0.0, 1.0), 0.038),  # of the left side its front corner, which swings outwards
        (-90.0, (0.0, 1.0), 0.102),  # of the right side the rear one
        (0.0, (0.0, 1.0), 0.089),  # of the front its right corner
    ],
)
def test_the_foremost_corner_counts(
    bearing: float, twist: tuple[float, float], speed: float
) -> None:
    zone = TouchZone(math.radians(bearing), math.radians(20.0), 0.1)
    assert pushing(BURGER, zone, *twist) == pytest.approx(speed, abs=2e-3)


def test_both_ends_of_a_face_count() -> None:
    press = touch_directions(BURGER, TouchZone(0.0, math.radians(1.0), 0.1))
    ahead = {(x, y) for nx, x, y in zip(press.nx, press.x, press.y, strict=True) if nx > 0.9999999}
    assert ahead == {(0.038, -0.089), (0.038, 0.089)}


@given(st.floats(-3.0, 3.0), st.floats(0.05, 1.04), SPEED, SPEED)
def test_no_direction_of_the_zone_is_pressed_more_than_a_hundredth_faster(
    bearing: float, half: float, v: float, w: float
) -> None:
    found = pushing(BURGER, TouchZone(bearing, half, 0.1), v, w)
    for way in np.linspace(bearing - half, bearing + half, 101):
        nx, ny = math.cos(way), math.sin(way)
        x, y = max(BURGER.tolist(), key=lambda corner: nx * corner[0] + ny * corner[1])
        assert nx * (v - w * y) + ny * w * x <= found + 0.01 * math.hypot(v - w * y, w * x) + 1e-9

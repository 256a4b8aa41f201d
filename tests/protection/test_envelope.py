from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, Platform
from swarmd.protection.constraints import LIMIT_BOX, envelope, half_planes
from swarmd.protection.projection import nearest, nearest_feasible
from swarmd.settings.settings import load_platform

PLATFORMS = [load_platform(name) for name in ("burger", "waffle_pi", "jackal")]
PLATFORM = st.sampled_from(PLATFORMS)
SPEED = st.floats(0.05, 2.0)
AHEAD, LEFT = (1.0, 0.0), (0.0, 1.0)


def polygon_of(platform: Platform, speed: float, along: tuple[float, float] = AHEAD) -> Array:
    limits = (platform.limits.linear, platform.limits.angular)
    return np.array(envelope(platform.footprint, along, limits, speed))


def fastest(platform: Platform, twist: Array, along: tuple[float, float] = AHEAD) -> float:
    """The speed in m/s of the fastest corner, from the rigid body's equation."""
    v, w = twist * (platform.limits.linear, platform.limits.angular)
    speeds = [math.hypot(v * along[0] - w * y, v * along[1] + w * x) for x, y in platform.footprint]
    return max(speeds)


@given(PLATFORM, SPEED, st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([AHEAD, LEFT]))
def test_no_corner_is_faster_than_promised(
    platform: Platform, speed: float, v: float, w: float, along: tuple[float, float]
) -> None:
    polygon = polygon_of(platform, speed, along)
    allowed = nearest([tuple(point) for point in polygon.tolist()], (v, w))
    assert fastest(platform, np.array(allowed), along) <= speed + 1e-9
    assert np.abs(allowed).max() <= 1.0 + 1e-12


@given(PLATFORM, SPEED)
def test_it_is_convex_counter_clockwise_and_around_standing_still(
    platform: Platform, speed: float
) -> None:
    polygon = polygon_of(platform, speed)
    edges = np.roll(polygon, -1, axis=0) - polygon
    after = np.roll(edges, -1, axis=0)
    assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] >= -1e-9).all()
    assert (edges[:, 0] * -polygon[:, 1] + edges[:, 1] * polygon[:, 0] > 0.0).all()


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
def test_straight_on_and_on_the_spot_it_takes_no_more_than_it_must(platform: Platform) -> None:
    speed = 0.2
    polygon = [tuple(point) for point in polygon_of(platform, speed).tolist()]
    straight = nearest(polygon, (1.0, 0.0))[0] * platform.limits.linear
    spin = nearest(polygon, (0.0, 1.0))[1] * platform.limits.angular
    radius = float(np.hypot(*platform.footprint.T).max())
    assert straight == pytest.approx(speed)
    assert spin == pytest.approx(speed / radius)


@given(PLATFORM, SPEED, SPEED, st.floats(-1, 1), st.floats(-1, 1))
def test_a_larger_promise_leaves_at_least_as_much(
    platform: Platform, one: float, other: float, v: float, w: float
) -> None:
    tight = [tuple(p) for p in polygon_of(platform, min(one, other)).tolist()]
    loose = [tuple(p) for p in polygon_of(platform, max(one, other)).tolist()]
    allowed = nearest(tight, (v, w))
    assert nearest(loose, allowed) == pytest.approx(allowed, abs=1e-9)


@given(PLATFORM, st.floats(-1, 1), st.floats(-1, 1))
def test_where_the_promise_is_no_bound_only_the_limits_count(
    platform: Platform, v: float, w: float
) -> None:
    polygon = [tuple(point) for point in polygon_of(platform, 100.0).tolist()]
    assert nearest(polygon, (v, w)) == pytest.approx((v, w), abs=1e-12)


@given(PLATFORM, SPEED, st.floats(-1, 1), st.floats(-1, 1))
def test_its_half_planes_are_the_polygon(
    platform: Platform, speed: float, v: float, w: float
) -> None:
    polygon = [tuple(point) for point in polygon_of(platform, speed).tolist()]
    normals, caps = half_planes(polygon)
    allowed, _ = nearest_feasible((v, w), LIMIT_BOX, normals, caps)
    assert allowed == pytest.approx(nearest(polygon, (v, w)), abs=1e-9)

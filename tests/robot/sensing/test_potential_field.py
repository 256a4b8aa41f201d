"""The paper's potential field against its equations, written out as plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, Twist
from swarmd.robot.sensing.potential_field import (
    FieldKind,
    FieldResult,
    field_twist,
    potential_field,
)

INF, NAN = math.inf, math.nan
RING: Array = np.radians(np.arange(360.0))
KINDS: tuple[FieldKind, ...] = ("repulsion", "attraction", "attraction2")


def by_the_book(
    ranges: list[float], bearings: list[float], high: float, low: float, bias: float, kind: str
) -> tuple[float, float, int]:
    """The sum and the count as the original computes them, ray by ray; NaN left out."""
    x = y = 0.0
    count = 0
    for r, b in zip(ranges, bearings, strict=True):
        if math.isnan(r):
            continue
        clipped = min(r, high)
        clipped = 0.0 if clipped < low else clipped
        count += 0.0 < clipped < high
        weight = clipped / high if kind == "attraction" else 1.0 - clipped / high
        if weight < 1.0:
            x += weight * math.cos(b)
            y += weight * math.sin(b)
    if kind == "repulsion":
        return bias - x, -y, count
    return (x - bias if kind == "attraction2" else x + bias), y, count


def field(
    ranges: Array,
    bearings: Array = RING,
    *,
    high: float = 0.5,
    low: float = 0.12,
    bias: float = 2.0,
    rays: int = 5,
    kind: FieldKind = "repulsion",
    ignore_near: bool = False,
) -> FieldResult:
    return potential_field(
        ranges,
        bearings,
        range_max=high,
        range_min=low,
        bias=bias,
        ray_threshold=rays,
        kind=kind,
        ignore_near=ignore_near,
    )


def ahead(rays: int, distance: float) -> Array:
    """Free all round but for so many rays, centred ahead."""
    ranges = np.full(360, INF)
    ranges[np.arange(rays) - rays // 2] = distance
    return ranges


@pytest.mark.parametrize("kind", KINDS)
@given(
    ranges=st.lists(st.floats(0.0, 5.0) | st.sampled_from([INF, NAN, 0.0]), max_size=40),
    bias=st.floats(-2.0, 2.0),
    high=st.floats(0.2, 4.0),
)
def test_ignore_near_gives_the_original_field(
    kind: FieldKind, ranges: list[float], bias: float, high: float
) -> None:
    bearings = np.linspace(-3.0, 3.0, len(ranges))
    result = field(
        np.array(ranges), bearings, high=high, bias=bias, kind=kind, rays=1, ignore_near=True
    )
    x, y, count = by_the_book(ranges, bearings.tolist(), high, 0.12, bias, kind)
    # Sums of at most 40 terms of size 1, in another order.
    np.testing.assert_allclose(result.vector, [x, y], rtol=0.0, atol=1e-12)
    assert result.count == count
    assert result.is_alone == (count <= 1)


@pytest.mark.parametrize("kind", KINDS)
@given(ranges=st.lists(st.floats(0.12, 5.0) | st.sampled_from([INF, NAN]), max_size=40))
def test_field_without_near_rays_is_the_original(kind: FieldKind, ranges: list[float]) -> None:
    bearings: Array = np.linspace(-3.0, 3.0, len(ranges))
    ours = field(np.array(ranges), bearings, kind=kind)
    original = field(np.array(ranges), bearings, kind=kind, ignore_near=True)
    np.testing.assert_array_equal(ours.vector, original.vector)
    assert ours.count == original.count


@pytest.mark.parametrize("too_near", [0.119, 0.01, 0.0, -1.0, -INF])
def test_near_ray_counts_as_range_min(too_near: float) -> None:
    expected = field(ahead(12, 0.12))
    result = field(ahead(12, too_near))
    assert result.count == expected.count == 12
    np.testing.assert_array_equal(result.vector, expected.vector)
    assert field(ahead(12, too_near), ignore_near=True).count == 0


@pytest.mark.parametrize("distance", [0.5, 1.0, INF, NAN])
def test_ray_at_range_max_does_not_count(distance: float) -> None:
    result = field(np.full(360, distance))
    assert result.count == 0
    assert result.vector.tolist() == [2.0, 0.0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", [0.3, 0.0, -INF])
def test_range_max_of_zero_is_no_field(kind: FieldKind, distance: float) -> None:
    result = field(np.full(360, distance), high=0.0, kind=kind)
    assert result.is_alone
    assert result.count == 0


@given(x=st.floats(-10.0, 10.0), y=st.floats(-10.0, 10.0))
def test_field_command_has_full_speed(x: float, y: float) -> None:
    length = math.hypot(x, y)
    expected = Twist()
    if length > 1e-9:
        expected = Twist(0.26 * x / length, 1.82 * math.asin(max(-1.0, min(1.0, y / length))))
    twist = field_twist(np.array([x, y]), 0.26, 1.82)
    assert twist.linear == pytest.approx(expected.linear)
    assert twist.angular == pytest.approx(expected.angular)


@pytest.mark.parametrize("vector", [(0.0, 0.0), (NAN, 1.0), (INF, 1.0), (1.0, -INF), (1e-12, 0.0)])
def test_field_without_direction_gives_zero(vector: tuple[float, float]) -> None:
    assert field_twist(np.array(vector), 0.26, 1.82) == Twist()

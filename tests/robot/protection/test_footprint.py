from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.robot.protection.footprint import Footprint, ScanGeometry
from swarmd.robot.protection.outline import Outline
from tests.support.barrier_parts import BURGER, interpreted, outline_of, separation
from tests.support.filter_sim import under_barrier

OUTLINE = Outline(BURGER)
BOX = Footprint(np.array([[-0.2, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.2, 0.1]]))


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_gap_equals_the_distance_to_an_axis_aligned_box(x: float, y: float) -> None:
    dx = max(-0.2 - x, 0.0, x - 0.1)
    dy = max(-0.1 - y, 0.0, y - 0.1)
    assert BOX.gaps(np.array([[x, y]]))[0] == pytest.approx(np.hypot(dx, dy), abs=1e-9)


@pytest.mark.parametrize("point", [(0.1, 0.0), (0.1, 0.1), (0.0, 0.1), (0.0, 0.0), (-0.19, 0.0)])
def test_contact_has_a_unit_normal(point: tuple[float, float]) -> None:
    separated = separation(outline_of(BOX.corners), *point)
    assert separated.gap == 0.0
    assert np.hypot(*separated.direction) == pytest.approx(1.0)


def test_points_start_at_the_sensor() -> None:
    bearings = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2])
    spec = ScanSpec(bearings, 5.0, 0.12, 3.5, offset=(-0.064, 0.0))
    scan = Scan(1, 0.0, np.array([1.0, -np.inf, np.inf, 2.0]), bearings, 0.12, 3.5)
    expected = [[0.936, 0.0], [-0.064, 0.12], [-0.064, -2.0]]
    geometry = ScanGeometry(spec)
    assert geometry.points(scan) == pytest.approx(np.array(expected), abs=1e-12)
    fewer = Scan(2, 0.1, np.array([1.0, 0.5]), bearings[1:3], 0.12, 3.5)
    expected = [[-0.064, 1.0], [-0.564, 0.0]]
    assert geometry.points(fewer) == pytest.approx(np.array(expected), abs=1e-12)


def seen(points: Array, offset: tuple[float, float]) -> tuple[Scan, ScanGeometry]:
    """A scan whose rays end at the points."""
    x, y = (points - offset).T
    bearings = np.arctan2(y, x)
    spec = ScanSpec(bearings, 5.0, 0.0, 10.0, offset=offset)
    return Scan(1, 0.0, np.hypot(x, y), bearings, 0.0, 10.0), ScanGeometry(spec)


def test_no_return_has_no_gap() -> None:
    assert BOX.nearest(*seen(np.empty((0, 2)), (0.0, 0.0))) is None
    scan, geometry = seen(np.array([[1.0, 0.0]]), (0.0, 0.0))
    nothing = Scan(1, 0.0, np.array([np.inf]), scan.bearings, 0.0, 10.0)
    assert BOX.nearest(nothing, geometry) is None
    assert OUTLINE.min_gap(nothing) is None


def test_a_return_too_close_to_measure_has_no_gap() -> None:
    scan = Scan(1, 0.0, np.array([0.5, -np.inf]), np.array([0.0, 1.0]), 0.12, 10.0)
    assert OUTLINE.min_gap(scan) == 0.0


def test_a_range_without_a_bearing_is_refused() -> None:
    scan = SimpleNamespace(ranges=np.array([0.5, 0.6]), bearings=np.zeros(1), range_min=0.12)
    with pytest.raises(IndexError):
        OUTLINE.min_gap(scan)  # type: ignore[arg-type]  # a Scan refuses such arrays


@given(
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=20),
    st.sampled_from([(0.0, 0.0), (-0.064, 0.0), (0.09, -0.09), (0.5, 0.2)]),
)
def test_the_nearest_is_the_smallest_of_all_points(
    points: list[tuple[float, float]], offset: tuple[float, float]
) -> None:
    some = np.array(points)
    nearest = BOX.nearest(*seen(some, offset))
    assert nearest is not None
    assert nearest[0] == pytest.approx(BOX.gaps(some).min(), abs=1e-9)


@given(st.lists(st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)), min_size=1, max_size=20))
@example([(-0.032, 0.3), (0.16, 0.244)])  # the second is nearer to the outline, not to the lidar
def test_the_kernel_has_the_gap_of_the_nearest_bit_by_bit(
    points: list[tuple[float, float]],
) -> None:
    scan, geometry = seen(np.array(points), BURGER.scan.offset)
    nearest = Footprint(BURGER.footprint).nearest(scan, geometry)
    assert nearest is not None
    assert OUTLINE.min_gap(scan) == nearest[0]


SQUARE = Footprint(np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]))


@pytest.mark.parametrize(
    ("place", "inner", "outer"),
    [
        ((0.05, 0.0), 0.05, (0.15, 0.1)),
        ((0.3, 0.0), -0.2, (0.4, 0.1)),
        ((0.2, 0.2), -0.1414, (0.3, 0.3)),
    ],
)
def test_circles_inside_of_and_around_a_square(
    place: tuple[float, float], inner: float, outer: tuple[float, float]
) -> None:
    assert SQUARE.circles(place) == pytest.approx((inner, np.hypot(*outer)), abs=1e-4)


@pytest.mark.parametrize(
    ("x", "y", "gap"),
    [(0.0, 0.0, 0.0), (0.1, 0.05, 0.0), (0.4, 0.0, 0.2), (0.2, 0.3, 0.2), (-0.5, 0.0, 0.3)],
)
def test_gap_to_a_triangle(x: float, y: float, gap: float) -> None:
    """Its base from (0.2, -0.1) to (0.2, 0.1), its tip at (-0.2, 0)."""
    triangle = np.array([[0.2, -0.1], [0.2, 0.1], [-0.2, 0.0]])
    assert outline_of(triangle).gap_of(x, y) == pytest.approx(gap, abs=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 40.0, 90.0, 180.0, -130.0])
def test_an_old_scan_still_tells_its_smallest_gap(degrees: float) -> None:
    """Half a metre from the lidar of a Burger, as the outline's gap by numpy."""
    burger = under_barrier(BURGER)
    near = interpreted(BURGER)._feasible.near
    bearings = np.radians([degrees, degrees + 20.0])
    near.set_bearings(bearings)
    near.find_min_gap(np.array([0.5, math.inf]), burger.scan.range_min)
    point = 0.5 * np.array([np.cos(bearings[0]), np.sin(bearings[0])]) + burger.scan.offset
    expected = float(Footprint(burger.footprint).gaps(point[None])[0])
    assert near.min_gap == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("turn", np.linspace(0.0, 6.0, 13))
def test_gaps_of_any_convex_polygon(turn: float) -> None:
    angles = turn + np.array([0.0, 1.1, 2.0, 3.9, 5.0])
    corners = np.array([0.3, -0.1]) + 0.4 * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    polygon = Footprint(corners)
    ahead = (corners + np.roll(corners, -1, axis=0)) / 2.0
    edges = np.roll(corners, -1, axis=0) - corners
    outward = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    outward /= np.hypot(*outward.T)[:, None]
    assert polygon.gaps(ahead + 0.7 * outward) == pytest.approx(np.full(5, 0.7), abs=1e-12)
    assert polygon.gaps(ahead - 0.01 * outward) == pytest.approx(np.zeros(5), abs=1e-12)
    nearest = polygon.nearest(*seen(ahead + 0.7 * outward, (0.0, 0.0)))
    assert nearest is not None
    assert nearest[0] == pytest.approx(0.7, abs=1e-9)

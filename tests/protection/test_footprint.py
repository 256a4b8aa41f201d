from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.protection.footprint import Footprint, seen_points
from swarmd.values import Scan, ScanSpec

BOX = Footprint(np.array([[-0.2, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.2, 0.1]]))


@pytest.mark.parametrize(
    ("point", "gap"),
    [
        ((0.3, 0.0), 0.2),
        ((-0.5, 0.05), 0.3),
        ((0.0, 0.6), 0.5),
        ((0.4, 0.5), 0.5),  # 3-4-5 from the corner
        ((0.05, 0.05), 0.0),
    ],
)
def test_gap_is_the_distance_to_the_outline(point: tuple[float, float], gap: float) -> None:
    assert BOX.gaps(np.array([point]))[0] == pytest.approx(gap, abs=1e-12)


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_gap_agrees_with_the_distance_to_an_axis_aligned_box(x: float, y: float) -> None:
    dx = max(-0.2 - x, 0.0, x - 0.1)
    dy = max(-0.1 - y, 0.0, y - 0.1)
    assert BOX.gaps(np.array([[x, y]]))[0] == pytest.approx(np.hypot(dx, dy), abs=1e-9)


def test_points_are_seen_from_where_the_sensor_is() -> None:
    bearings = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2])
    spec = ScanSpec(bearings, 5.0, 0.12, 3.5, offset=(-0.064, 0.0))
    scan = Scan(1, 0.0, np.array([1.0, -np.inf, np.inf, 2.0]), bearings, 0.12, 3.5)
    expected = [[0.936, 0.0], [-0.064, 0.12], [-0.064, -2.0]]
    assert seen_points(scan, spec) == pytest.approx(np.array(expected), abs=1e-12)

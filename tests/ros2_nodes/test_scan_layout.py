"""Scans of ROS: rays in rising order, evenly spaced, from the first direction of a driver on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Scan
from swarmd.ros2_nodes.launch_file import ScanTopic
from swarmd.ros2_nodes.robot_topics import ScanLayout, scan_layout

RING = np.radians([0.0, 90.0, 180.0, -90.0])


def laid(degrees: list[float], ranges: list[float], topic: ScanTopic | None = None) -> ScanLayout:
    bearings = np.radians(np.array(degrees, dtype=float))
    scan = Scan(0, 0.0, np.array(ranges, dtype=float), bearings, 0.1, 5.0)
    return scan_layout(scan, topic or ScanTopic(), RING)


@pytest.mark.parametrize(
    ("degrees", "ranges", "topic", "first", "step", "wanted"),
    [
        ([0, 90, 180, -90], [1, 2, 3, 4], None, 0, 90, [1, 2, 3, 4]),
        ([-90, 180, 90, 0], [4, 3, 2, 1], None, 0, 90, [1, 2, 3, 4]),  # clockwise
        ([0, 90, 180, -90], [1, 2, 3, 4], -180.0, -180, 90, [3, 4, 1, 2]),
        # A sector of five rays from the right to the left, whatever its order
        ([90, 45, 0, -45, -90], [5, 4, 3, 2, 1], None, -90, 45, [1, 2, 3, 4, 5]),
        # A sector across the rear
        ([170, 180, -170], [1, 2, 3], None, 170, 10, [1, 2, 3]),
        # Uneven rays: each place has the nearest ray
        ([0, 80, 185, -90], [1, 2, 3, 4], None, 0, 90, [1, 2, 3, 4]),
        ([0, 10, 90, 180, -90], [1, 2, 3, 4, 5], None, 0, 72, [1, 3, 4, 4, 5]),
        ([30], [2], None, 30, 0, [2]),
    ],
)
def test_rays_rise_from_the_first_direction(
    degrees: list[float],
    ranges: list[float],
    topic: float | None,
    first: float,
    step: float,
    wanted: list[float],
) -> None:
    found = laid(degrees, ranges, ScanTopic(angle_min_deg=topic))
    assert math.degrees(found.first) == pytest.approx(first)
    assert math.degrees(found.step) == pytest.approx(step)
    assert found.ranges.tolist() == wanted


def test_a_ray_without_a_return_is_infinite_or_what_the_driver_gives() -> None:
    ranges = [1.0, math.inf, -math.inf, math.nan]
    assert laid([0, 90, 180, -90], ranges).ranges[1] == math.inf
    zero = laid([0, 90, 180, -90], ranges, ScanTopic(no_return=0.0)).ranges
    assert zero[:3].tolist() == [1.0, 0.0, -math.inf]
    assert math.isnan(zero[3])


def test_an_empty_scan_has_no_rays() -> None:
    assert laid([], []).ranges.tolist() == []

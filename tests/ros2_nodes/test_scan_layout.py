"""Scans of ROS: rays in rising order, evenly spaced, from the first direction of a driver on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Odometry, Pose, Scan, ScanSpec, Sweep, Twist
from swarmd.robot.sensing.deskew import Deskewer
from swarmd.robot.sensing.odometry_history import OdometryHistory
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


def moved(degrees: list[float], ages: list[float], *, borrowed: int = 0) -> Scan:
    """A scan that de-skew has returned, with ranges 1, 2, 3 and so on."""
    ranges = np.arange(1.0, 1.0 + len(degrees))
    bearings = np.radians(np.array(degrees))
    return Scan(0, 0.0, ranges, bearings, 0.1, 5.0, np.array(ages), 0.0, borrowed=borrowed)


@pytest.mark.parametrize(
    ("degrees", "ages", "borrowed", "wanted"),
    [
        # The robot turns with the sensor: the last ray is nearest to two places.
        ([0, 62, 124, 186], [0.0, 0.05, 0.1, 0.15], 0, [1, 2, 3, 4]),
        # It turns against the sensor, and two rays of the scan before fill the sector.
        ([40, 60, 0, 105, 210, -45], [0.3, 0.3, 0.0, 0.05, 0.1, 0.15], 2, [3, 4, 5, 6]),
        # The driver's first ray is another one: the nearest in direction.
        ([90, 170, 250, -20], [0.0, 0.05, 0.1, 0.15], 0, [4, 1, 2, 3]),
        # The driver has another order.
        ([0, -80, 170, 80], [0.0, 0.05, 0.1, 0.15], 0, [1, 4, 3, 2]),
    ],
)
def test_the_rays_of_a_moving_robot_stand_where_the_sensor_measured_them(
    degrees: list[float], ages: list[float], borrowed: int, wanted: list[float]
) -> None:
    found = scan_layout(moved(degrees, ages, borrowed=borrowed), ScanTopic(), RING)
    assert math.degrees(found.step) == pytest.approx(90.0)
    assert found.ranges.tolist() == wanted


@pytest.mark.parametrize("turn", [1.82, -1.82])
def test_a_scan_that_de_skew_has_turned_is_that_of_the_sensor(turn: float) -> None:
    """A robot that turns on the spot: de-skew moves each ray, and changes no range."""
    bearings = np.radians(np.arange(360.0))
    spec = ScanSpec(bearings, 5.0, 0.12, 3.5, sweep=Sweep(math.radians(-0.5), -1.0, 0.2))
    history = OdometryHistory()
    deskewer = Deskewer(spec, history)
    for k in range(50):
        at = 0.02 * k
        yaw = math.remainder(turn * at, math.tau)
        history.take(Odometry(at, Pose(0.0, 0.0, yaw), Twist(0.0, turn)), at)
    ranges = 0.5 + 0.005 * np.arange(360.0)
    for seq, arrival in ((0, 0.78), (1, 0.98)):
        raw = Scan(seq, arrival - 0.2, ranges, bearings, 0.12, 3.5, None, 0.0)
        moved = deskewer.deskew(raw, arrival, arrival - 0.98)
    assert abs(math.remainder(moved.bearings[-1] - bearings[-1], math.tau)) > 0.3
    laid = scan_layout(moved, ScanTopic(), bearings)
    assert laid.ranges == pytest.approx(ranges)

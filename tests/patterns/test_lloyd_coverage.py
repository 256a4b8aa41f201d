"""Lloyd coverage: one robot in a room, and the cell that it finds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Inputs, Neighbor, Pose, Twist, Value
from swarmd.patterns.lloyd_coverage.pattern import LloydCoverage
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_from, scan_of


class TestLloydCoverage(PatternContract):
    pattern = LloydCoverage


PLATFORM = TestLloydCoverage.subject("burger").platform


MIDDLE = Pose()


def requested(
    *others: tuple[float, float], at: Pose = MIDDLE, room: float = 4.0, **params: Value
) -> tuple[Twist, float]:
    """The command and the way to the centroid in m, in a room with others at range and bearing."""
    pattern = Subject(LloydCoverage, PLATFORM, params).make()
    scan = scan_of(PLATFORM, room=room, pose=at)
    neighbors = tuple(Neighbor(f"b{k}", 0.0, *one, 0.0) for k, one in enumerate(others))
    found = pattern.step(Inputs(0.0, 0.0, scan, True, neighbors=neighbors))
    assert found.twist is not None
    return found.twist, float(found.report["off"])


def test_rests_at_the_centroid_of_the_room_alone() -> None:
    twist, off = requested()
    assert twist == Twist()
    assert off < 0.01


def test_finds_the_centroid_of_the_half_that_is_nearer_to_it() -> None:
    # The other robot is 1 m ahead: the cell reaches from -2 to 0.5 m.
    twist, off = requested((1.0, 0.0))
    assert off == pytest.approx(0.75, abs=0.02)
    assert twist.linear == pytest.approx(-0.22)
    assert twist.angular == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_drives_to_the_centroid_forward_or_backward(yaw: float) -> None:
    twist, off = requested(at=Pose(0.25, 0.5, yaw), room=3.0)
    assert off == pytest.approx(math.hypot(0.25, 0.5), abs=0.02)
    bearing = math.atan2(-0.5, -0.25) - yaw
    assert twist.linear * math.cos(bearing) > 0.0
    assert twist.angular * math.tan(bearing) > 0.0


def test_the_cell_ends_at_the_reach() -> None:
    _, off = requested(at=Pose(1.5, 0.0, 0.0), room=100.0, reach=1.0)
    assert off < 0.05  # the lidar is 0.032 m behind the axle


def test_a_sector_without_rays_is_in_no_cell() -> None:
    bearings = np.linspace(-1.0, 1.0, 101)
    scan = scan_from(PLATFORM, np.full(101, 2.0), bearings)
    pattern = Subject(LloydCoverage, PLATFORM, {}).make()
    found = pattern.step(Inputs(0.0, 0.0, scan, True))
    # The centroid of a sector: 2 r sin(a) / (3 a), less the lidar's offset.
    assert found.report["off"] == pytest.approx(4.0 * math.sin(1.0) / 3.0 - 0.032, abs=0.02)

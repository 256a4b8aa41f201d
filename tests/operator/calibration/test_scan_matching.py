"""Matching of scans of rooms."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.values import Array, Pose
from swarmd.operator.calibration.scan_matching import Reference

BEARINGS = np.radians(np.arange(0.0, 360.0))


def seen(pose: Pose, half: tuple[float, float], seed: int, far: float = 3.5) -> Array:
    """Returns of a room of two times `half`, in the frame of `pose`, with 1 cm of noise."""
    angles = BEARINGS + pose.yaw
    cos, sin = np.cos(angles), np.sin(angles)
    x = (np.sign(cos) * half[0] - pose.x) / np.where(cos == 0.0, 1e-9, cos)
    y = (np.sign(sin) * half[1] - pose.y) / np.where(sin == 0.0, 1e-9, sin)
    ranges = np.minimum(x, y) + 0.01 * np.random.default_rng(seed).standard_normal(360)
    ranges, bearings = ranges[ranges < far], BEARINGS[ranges < far]
    return np.stack((ranges * np.cos(bearings), ranges * np.sin(bearings)), axis=1)


def test_a_pose_in_a_room_is_found() -> None:
    room = (1.3, 1.1)
    reference = Reference([seen(Pose(), room, seed) for seed in range(5)])
    found = reference.locate(seen(Pose(0.2, -0.05, 0.3), room, 9), Pose(0.17, -0.02, 0.22))
    assert found is not None
    assert (found.pose.x, found.pose.y) == pytest.approx((0.2, -0.05), abs=0.004)
    assert found.pose.yaw == pytest.approx(0.3, abs=0.004)
    assert found.binds_place
    assert found.binds_yaw


def test_a_corridor_binds_the_heading_alone() -> None:
    corridor = (20.0, 1.0)
    reference = Reference([seen(Pose(), corridor, seed) for seed in range(5)])
    found = reference.locate(seen(Pose(0.2, 0.0, 0.1), corridor, 9), Pose(0.0, 0.0, 0.05))
    assert found is not None
    assert found.pose.yaw == pytest.approx(0.1, abs=0.005)
    assert not found.binds_place
    assert found.binds_yaw


def test_a_round_room_binds_no_heading() -> None:
    ring = np.stack((1.5 * np.cos(BEARINGS), 1.5 * np.sin(BEARINGS)), axis=1)
    noise = np.random.default_rng(1)
    reference = Reference([ring + 0.01 * noise.standard_normal(ring.shape) for _ in range(5)])
    found = reference.locate(ring, Pose(0.0, 0.0, 0.2))
    assert found is not None
    assert not found.binds_yaw


def test_another_room_does_not_match() -> None:
    reference = Reference([seen(Pose(), (1.3, 1.1), 0)])
    assert reference.locate(seen(Pose(), (2.6, 2.2), 1), Pose()) is None
    assert reference.locate(np.empty((0, 2)), Pose()) is None

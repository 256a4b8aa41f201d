"""Rays as another place would see them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.recorded_scans import KERNEL, assert_same, in_sector, moved, recorded


def test_moved_rays_are_as_recorded() -> None:
    for case in recorded("motion"):
        ranges, bearings, ages = case["rays"].astype(np.float64)
        path, limits = case["path"], case["limits"]
        assert_same(case["moved"], moved(KERNEL, (ranges, bearings, ages), path, limits))
        way, sector = case["way"], case["sector"]
        inside = in_sector(KERNEL, (ranges, bearings, ages), 5, way, sector, limits)
        assert_same(case["inside"], inside)


def test_rays_without_a_distance_turn_and_keep_their_class() -> None:
    ranges = np.array([np.inf, -np.inf, np.nan, 0.13, 3.49])
    bearings, turn = np.zeros(5), np.array(((0.0, 0.0, 0.0, 0.0), (0.2, -0.04, 0.0, 0.3)))
    limits, (moved, turned) = np.array((0.0, 0.0, 0.12, 3.5)), np.empty((2, 5))
    args = (bearings, np.ones(5), np.zeros(5), np.full(5, 0.2), turn, 2, limits, moved, turned)
    KERNEL.move_rays(ranges, *args)
    np.testing.assert_array_equal(moved[:3], ranges[:3])
    np.testing.assert_allclose(turned[:3], 0.3)
    assert moved[3] == -np.inf  # 4 cm nearer, too close to measure
    assert moved[4] == pytest.approx(3.45, abs=2e-3)

"""The memory of each ray: as recorded, and after turns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.robot.sensing.ray_memory import PACKET_RAYS
from swarmd.settings.platforms import load_platform
from tests.support.recorded_scans import KERNEL, recorded


def test_conditioning_is_as_recorded() -> None:
    for case in recorded("memory"):
        platform, zero, guesses_near = case["spec"].tolist()
        spec = replace(load_platform(platform).scan, zero=zero)
        memory = KERNEL.RayMemory(spec, guesses_near=guesses_near == "True")
        for raw, at, expected in zip(case["raw"], case["at"], case["ranges"], strict=True):
            yaw, now, known_at, is_valid = at.tolist()
            got = memory.condition(raw, spec.bearings, yaw, now)
            assert memory.known_at == known_at
            assert (got is not None) == is_valid
            if got is not None:
                np.testing.assert_array_equal(got.astype(np.float32), expected)


def test_two_rays_in_one_direction_keep_a_memory_each() -> None:
    """The bearings come in another array that holds the same."""
    spec = replace(load_platform("burger").scan, zero="no_return")
    bearings = np.tile(spec.bearings, 2)
    first = np.linspace(1.0, 2.0, 720)
    is_known = np.arange(720) % 9 > 0
    memory = KERNEL.RayMemory(spec, guesses_near=False)
    assert memory.condition(first, bearings.copy(), 0.0, 1.0).tolist() == first.tolist()
    got = memory.condition(np.where(is_known, 1.5, np.nan), bearings.copy(), 0.0, 1.0)
    assert got.tolist() == np.where(is_known, 1.5, first).tolist()


@pytest.mark.parametrize("unevenness", [0.3, 0.0])
@pytest.mark.parametrize("turned", [0.3, -1.0])
def test_lost_rays_have_the_range_that_was_measured_nearest_to_their_direction(
    unevenness: float, turned: float
) -> None:
    grid = np.arange(360) * math.tau / 360
    bearings = grid + unevenness * np.sin(grid)
    memory = KERNEL.RayMemory(replace(load_platform("burger").scan, bearings=grid),
                              guesses_near=False)  # fmt: skip
    first, is_lost = np.linspace(1.0, 2.0, 360), np.arange(360) % 9 == 0
    memory.condition(first, bearings, 0.0, 1.0)
    got = memory.condition(np.where(is_lost, np.nan, 1.5), bearings, turned, 1.1)
    turned = round(turned / (math.tau / 360)) * math.tau / 360
    apart = (bearings + turned - bearings[:, None] + math.pi) % math.tau - math.pi
    np.testing.assert_array_equal(got, np.where(is_lost, first[np.abs(apart).argmin(axis=0)], 1.5))


@pytest.mark.parametrize(
    ("width", "wall", "guesses_near", "expected"),
    [
        (2 * PACKET_RAYS, 2.0, False, 2.0),  # two lost packets
        (2 * PACKET_RAYS + 1, 2.0, False, math.inf),  # an obstacle in the blind zone may hide these
        (2 * PACKET_RAYS + 1, 1.0, False, 1.0),  # too near to be left out
        (2 * PACKET_RAYS + 1, 2.0, True, 2.0),  # no other knows of the blind zone
    ],
)
def test_a_long_run_of_zeros_over_far_returns_has_no_return(
    width: int, wall: float, guesses_near: bool, expected: float
) -> None:
    spec = load_platform("burger").scan
    assert spec.zero == "lds"
    memory = KERNEL.RayMemory(spec, guesses_near=guesses_near)
    ranges = np.full(360, wall)
    memory.condition(ranges, spec.bearings, 0.0, 1.0)
    run = np.arange(355, 355 + width) % 360
    ranges[run] = 0.0
    for now in (1.2, 1.4):
        got = memory.condition(ranges, spec.bearings, 0.0, now)
        assert got is not None
        assert set(got[run].tolist()) == {expected}
        assert set(np.delete(got, run).tolist()) == {wall}

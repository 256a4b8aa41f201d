"""The command along a vector, the side to turn to, and the time of a turn."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.kit.steering import Ahead, away_from, drive_along, turn_time
from swarmd.robot.sensing.rays import Ray
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")


@pytest.mark.parametrize(
    ("x", "y", "linear", "turns"),
    [(0.1, 0.0, 0.1, 0.0), (-0.1, 0.0, -0.1, 0.0), (5.0, 1.0, 0.2, 1.0), (-5.0, 1.0, -0.2, -1.0)],
)
def test_drives_along_a_vector_forward_or_backward(
    x: float, y: float, linear: float, turns: float
) -> None:
    twist = drive_along(x, y, speed=0.2, turn=1.0)
    assert twist.linear == linear
    assert np.sign(twist.angular) == turns


def test_turns_away_from_a_return_and_by_chance_without_one() -> None:
    rng = np.random.default_rng(0)
    assert [away_from(Ray(1.0, 0.3), rng), away_from(Ray(1.0, -0.3), rng)] == [-1.0, 1.0]
    assert {away_from(None, rng) for _ in range(20)} == {-1.0, 1.0}


def test_the_time_of_a_turn_is_finite_at_no_rate() -> None:
    assert turn_time(1.0, 2.0) == 0.5
    assert turn_time(1.0, 0.0) == 100.0


def test_a_return_ahead_counts_within_the_distance_only() -> None:
    ahead, scan = Ahead(), scan_of(BURGER, [Disc(1.0, 0.0)])
    assert ahead.within(0.5, scan) is None
    assert ahead.within(2.0, scan) is not None
    assert ahead.within(2.0, scan_of(BURGER, [Disc(-1.0, 0.0)])) is None
    assert ahead.within(2.0, None) is None

"""Ways and speeds of runs whose numbers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarmd.sim.metrics import kinematics
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import run


def half_way(**parts: Any) -> Trace:
    """1 s of two robots; the first goes 1 m in the first half, the second stands."""
    pose = np.zeros((11, 2, 3))
    pose[:6, 0, 0] = np.linspace(0.0, 1.0, 6)
    pose[6:, 0, 0] = 1.0
    return run(pose, **parts)


def test_path_length_and_mean_speed() -> None:
    trace = half_way()
    np.testing.assert_allclose(kinematics.path_lengths(trace), np.array([1.0, 0.0]))
    assert kinematics.path_length(trace) == pytest.approx(0.5)
    assert kinematics.mean_speed(trace) == pytest.approx(0.5)
    assert kinematics.mean_speed(trace, since=0.5) == pytest.approx(0.0)


def test_a_way_there_and_back_counts_twice() -> None:
    pose = np.zeros((3, 1, 3))
    pose[1, 0, :2] = (3.0, 4.0)
    assert kinematics.path_length(run(pose)) == pytest.approx(10.0)
    np.testing.assert_allclose(kinematics.path_lengths_over_time(run(pose)), [0.0, 5.0, 10.0])


def test_speeds_over_time() -> None:
    speeds = kinematics.mean_speeds(half_way())
    np.testing.assert_allclose(speeds, [np.nan, *[1.0] * 5, *[0.0] * 5], atol=1e-12)


def test_speed_is_a_share_of_the_platforms_own() -> None:
    pose = np.zeros((21, 2, 3))
    pose[10:, 0, 0] = 0.011 * np.arange(11)  # 0.11 m/s, half of what a Burger can
    pose[10:, 1, 1] = 0.05 * np.arange(11)  # 0.5 m/s, all that a Jackal can
    trace = run(pose, platforms=("burger", "jackal"))
    assert kinematics.speed_share(trace) == pytest.approx(0.75)
    shares = kinematics.speed_shares(trace)
    assert shares is not None
    np.testing.assert_allclose(shares[1:], [0.0] * 10 + [0.75] * 10, atol=1e-12)
    assert kinematics.speed_share(run(pose, meta={})) is None
    assert kinematics.speed_shares(run(pose, meta={})) is None


def test_a_way_counts_only_while_present() -> None:
    present = np.ones((11, 2), dtype=bool)
    present[3:, 0] = False  # after 0.4 m
    trace = half_way(present=present)
    np.testing.assert_allclose(kinematics.path_lengths(trace), np.array([0.4, 0.0]))
    assert kinematics.mean_speed(trace) == pytest.approx(0.4 / 1.2)
    assert kinematics.path_length(trace) == pytest.approx(0.2)
    joins = half_way(present=~present | [[False, True]])  # for the last 0.4 m
    np.testing.assert_allclose(kinematics.path_lengths(joins), np.array([0.4, 0.0]))


def test_a_robot_that_was_never_present_is_not_in_the_mean() -> None:
    present = np.ones((11, 2), dtype=bool)
    present[:, 1] = False
    assert kinematics.path_length(half_way(present=present)) == pytest.approx(1.0)
    np.testing.assert_allclose(
        kinematics.path_lengths_over_time(half_way(present=present))[-1], 1.0
    )
    nobody = half_way(present=np.zeros((11, 2), dtype=bool))
    assert kinematics.path_length(nobody) is None
    assert np.isnan(kinematics.path_lengths_over_time(nobody)).all()

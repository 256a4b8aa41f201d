"""Wheel odometry: exact if ideal, with the errors of unequal or misjudged wheels otherwise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.values import Array, Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.world import base
from swarmd.sim.world.odometer import Odometers, measurement
from swarmd.sim.world.realism import IDEAL, REALISTIC, OdometryNoise

BURGER = load_platform("burger")
BASE = BURGER.body["wheel_separation"]
START = np.array([[1.0, -2.0, 0.7]])


def names(n: int) -> list[str]:
    return [f"r-{row}" for row in range(n)]


def odometers(
    noise: OdometryNoise, starts: Array, platform: Platform = BURGER, seed: int = 5
) -> Odometers:
    n = len(starts)
    return Odometers(noise, [platform] * n, starts, names(n), seed)


def path(start: Array, linear: float, angular: float, seconds: float, rate: float = 25.0) -> Array:
    """Poses (k, n, 3) of robots that start at `start` (n, 3) and drive on at one twist."""
    t = (np.arange(round(seconds * rate)) + 1.0)[:, None] / rate
    yaw = start[:, 2] + angular * t
    if angular == 0.0:
        x = start[:, 0] + linear * t * np.cos(start[:, 2])
        y = start[:, 1] + linear * t * np.sin(start[:, 2])
    else:
        x = start[:, 0] + linear / angular * (np.sin(yaw) - np.sin(start[:, 2]))
        y = start[:, 1] - linear / angular * (np.cos(yaw) - np.cos(start[:, 2]))
    return np.stack((x, y, yaw + 0.0 * x), axis=-1)


def told(odometry: Odometers, poses: Array, twist: tuple[float, float, float]) -> Array:
    """(k, n, 3) poses and then twists (k, n, 3), stacked, of a reading at each pose."""
    rows = np.arange(poses.shape[1])
    twists = np.tile(twist, (poses.shape[1], 1))
    return np.array([odometry.read(rows, truth, twists) for truth in poses])


def as_python_says(pose: Array, start: Array) -> tuple[float, float, float]:
    x, y = pose[:2] - start[:2]
    cos, sin = math.cos(start[2]), math.sin(start[2])
    yaw = (pose[2] - start[2] + math.pi) % (2.0 * math.pi) - math.pi
    return float(cos * x + sin * y), float(cos * y - sin * x), float(yaw)


def test_ideal_odometry_is_the_relative_pose_bit_by_bit() -> None:
    rng = np.random.default_rng(0)
    starts, poses = rng.uniform(-9.0, 9.0, (2, 500, 3))
    twists = rng.uniform(-1.0, 1.0, (500, 3))
    got, measured = odometers(IDEAL.odometry, starts).read(np.arange(500), poses, twists)
    wanted = [as_python_says(pose, start) for pose, start in zip(poses, starts, strict=True)]
    assert got.tolist() == [list(row) for row in wanted]
    assert np.array_equal(measured, twists)


def test_only_the_asked_for_rows_are_read() -> None:
    starts = np.zeros((3, 3))
    poses = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    got, measured = odometers(IDEAL.odometry, starts).read(np.array([2, 0]), poses, 10.0 * poses)
    assert got[:, 0].tolist() == [3.0, 1.0]
    assert measured[:, 0].tolist() == [30.0, 10.0]


@pytest.mark.parametrize("twist", [(-0.1, -2.8), (0.2, 0.0), (0.0, 1.5), (0.2, 1.0)])
def test_ideal_wheels_measure_the_truth_also_along_arcs(twist: tuple[float, float]) -> None:
    # Errors too small to matter, so that the way over wheels is gone.
    odometry = odometers(OdometryNoise(slip=1e-12), START)
    poses = path(START, *twist, seconds=20.0, rate=5.0)
    got = told(odometry, poses, (*twist, 0.0))
    wanted = np.array([as_python_says(pose[0], START[0]) for pose in poses])
    assert np.abs(got[:, 0, 0] - wanted).max() < 1e-9
    assert np.abs(got[:, 1, 0] - (*twist, 0.0)).max() < 1e-9


def errors(noise: OdometryNoise, linear: float, angular: float, n: int = 400) -> Array:
    """(n, 2): errors of measured path and turn of n robots."""
    odometry = odometers(noise, np.zeros((n, 3)))
    twist = (linear, angular, 0.0)
    off: Array = told(odometry, np.zeros((1, n, 3)), twist)[0, 1, :, :2] - (linear, angular)
    return off


def test_a_turn_is_scaled_by_the_wheelbase_error() -> None:
    off = errors(OdometryNoise(wheelbase=0.015), 0.0, 2.0)
    assert np.abs(off[:, 0]).max() == 0.0
    assert (off[:, 1] / 2.0).std() == pytest.approx(0.015, rel=5.0 / math.sqrt(800.0))
    assert abs((off[:, 1] / 2.0).mean()) < 5.0 * 0.015 / math.sqrt(400.0)


def test_only_unequal_wheels_bend_a_straight_line() -> None:
    off = errors(OdometryNoise(diameter=0.005), 0.2, 0.0)
    # A larger right wheel turns less often, and the robot believes that it went less far there.
    assert off[:, 1].std() == pytest.approx(0.2 * 0.005 / BASE, rel=5.0 / math.sqrt(800.0))
    assert np.abs(off[:, 0]).max() < 0.2 * 0.005**2 * 10.0
    assert not errors(OdometryNoise(wheelbase=0.015), 0.2, 0.0).any()


def test_the_measurement_is_that_of_two_wheels() -> None:
    right_diameter, left_diameter = 2.0 * 1.03 / 2.03, 2.0 / 2.03  # of mean 1 and ratio 1.03
    linear, angular, wheelbase = 0.7, -1.3, 0.98
    right = (linear + angular * BASE * wheelbase / 2.0) / right_diameter
    left = (linear - angular * BASE * wheelbase / 2.0) / left_diameter
    wanted = [(right + left) / 2.0, (right - left) / BASE, 0.4]
    one = np.ones(1)
    (measured,) = measurement(1.03 * one, 0.98 * one, BASE * one, one)
    assert measured.T @ (linear, angular, 0.4) == pytest.approx(wanted)


def test_a_reading_is_the_matrix_times_the_motion_times_the_slip() -> None:
    matrix = np.array([[[2.0, 0.25, 0.0], [0.5, 3.0, 0.0], [0.0, 0.0, 0.75]]])
    rngs = [np.random.default_rng(0)]
    wheels = base.Wheels(matrix, np.zeros((1, 3)), np.zeros((1, 3)), 0.5, rngs)
    slips = *(1.0 + 0.5 * np.random.default_rng(0).standard_normal(2)), 1.0
    reported, measured = np.empty((1, 3)), np.empty((1, 3))
    # A turn by 0.1 rad about a chord of 0.4 m along the mean heading, and 0.2 m to its left.
    chord, left = 0.4, 0.2
    c, s = math.cos(0.05), math.sin(0.05)
    poses = np.array([[c * chord - s * left, s * chord + c * left, 0.1]])
    twist = np.array([[0.3, -1.2, 0.5]])
    wheels.read(np.zeros(1, np.intp), poses, twist, reported, measured)
    speeds = twist[0] @ matrix[0] * slips
    assert measured[0] == pytest.approx(speeds)
    moved, turn, aside = np.array([chord, 0.1, left]) @ matrix[0] * slips
    c, s = math.cos(turn / 2.0), math.sin(turn / 2.0)
    assert reported[0] == pytest.approx([c * moved - s * aside, s * moved + c * aside, turn])


def test_unequal_wheels_measure_their_own_arc() -> None:
    odometry = odometers(OdometryNoise(diameter=0.02, wheelbase=0.02), np.zeros((20, 3)))
    got = told(odometry, path(np.zeros((20, 3)), 0.2, 1.0, 6.0), (0.2, 1.0, 0.0))
    for row in range(20):
        linear, angular, _ = got[0, 1, row]
        believed = path(np.zeros((1, 3)), linear, angular, 6.0)[:, 0, :2]
        assert np.abs(got[:, 0, row, :2] - believed).max() < 2e-5  # of 0.4 m: chords for arcs


def test_slip_is_a_share_of_each_readings_motion() -> None:
    got = told(odometers(OdometryNoise(slip=0.02), START), path(START, 0.2, 1.0, 80.0), (0.2, 1, 0))
    off = got[:, 1, 0, :2] / (0.2, 1.0) - 1.0
    assert off.std(axis=0) == pytest.approx([0.02, 0.02], rel=5.0 / math.sqrt(2.0 * len(off)))
    assert abs((off[:, 0] * off[:, 1]).mean()) / 0.02**2 < 5.0 / math.sqrt(len(off))


def test_a_robot_at_rest_does_not_drift() -> None:
    got = told(odometers(REALISTIC.odometry, START), np.tile(START, (50, 1, 1)), (0.0, 0.0, 0.0))
    assert not got.any()


def test_wheels_do_not_notice_a_shove_to_the_side() -> None:
    shoved = np.array([[[0.0, 0.3, 0.0]]])
    start = np.zeros((1, 3))
    assert not told(odometers(OdometryNoise(slip=1e-12), start), shoved, (0, 0, 0.2)).any()
    limits = structs.replace(BURGER.limits, lateral=0.2)
    omni = odometers(OdometryNoise(slip=1e-12), start, replace(BURGER, limits=limits))
    got = told(omni, shoved, (0.0, 0.0, 0.2))[0, :, 0]
    assert got[0] == pytest.approx([0.0, 0.3, 0.0], abs=1e-9)
    assert got[1] == pytest.approx([0.0, 0.0, 0.2], abs=1e-9)


def test_a_late_reading_gives_no_longer_path_than_possible() -> None:
    odometry = odometers(REALISTIC.odometry, np.zeros((1, 3)))
    poses = np.array([[[0.5, 0.0, 2.0 * math.pi]], [[0.5, 0.5, 20.0]]])
    assert np.abs(told(odometry, poses, (0.1, 1.0, 0.0))[:, 0, 0, :2]).max() < 2.0


def test_yaw_is_wrapped() -> None:
    got = told(odometers(REALISTIC.odometry, START), path(START, 0.0, 2.0, 10.0), (0.0, 2.0, 0.0))
    assert np.abs(got[:, 0, 0, 2]).max() <= math.pi
    assert np.abs(got[:, 0, 0, 2]).max() > 3.0


def test_odometry_does_not_depend_on_other_robots() -> None:
    n = 40
    starts = np.random.default_rng(0).uniform(-3.0, 3.0, (n, 3))
    poses = path(starts, 0.2, 0.9, 2.0)
    twists = np.tile((0.2, 0.9, 0.0), (n, 1))
    together = odometers(REALISTIC.odometry, starts)
    alone = odometers(REALISTIC.odometry, starts)
    for truth in poses:
        whole = np.concatenate(together.read(np.arange(n), truth, twists), axis=1)
        for row in reversed(range(n)):
            lone = np.concatenate(alone.read(np.array([row]), truth, twists), axis=1)[0]
            assert np.array_equal(lone, whole[row])

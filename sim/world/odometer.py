"""Wheel odometry: ideal, or with the systematic errors of real wheels.

Errors after Borenstein and Feng, UMBmark: A Method for Measuring, Comparing, and Correcting
Dead-Reckoning Errors in Mobile Robots (1995). E_d is the ratio of the right wheel's diameter to the
left wheel's. E_b is the ratio of the true wheelbase to the assumed wheelbase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.base import Wheels
from swarmd.sim.world.bodies import value
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.realism import OdometryNoise
from swarmd.sim.world.seeding import generator

ODOMETRY_RATE = 20.0
"""Hz, in live worlds and in lockstep."""


class Odometers:
    """The odometry of n bases, each in the frame of its own start."""

    def __init__(
        self,
        noise: OdometryNoise,
        platforms: Sequence[Platform],
        starts: Array,
        ids: Sequence[str],
        seed: int,
    ) -> None:
        """Draw the systematic errors of n bases by `seed` and robot's id.

        `platforms`, `starts` (n, 3) x, y, yaw and `ids` in the order of rows.
        """
        self._noise = noise
        self._starts = starts.copy()
        # Cosine and sine of the start headings, which turn true poses into the odometry frame. By
        # math, since numpy's vectorised sine differs from math's in the last bit.
        self._turns = np.array([(math.cos(yaw), math.sin(yaw)) for yaw in starts[:, 2]])
        self._turns = self._turns.reshape(-1, 2)
        if noise.is_ideal:  # nothing is drawn, and `read` uses no wheels
            return
        rngs = [generator(seed, "odometry", robot) for robot in ids]
        errors = np.array([rng.standard_normal(2) for rng in rngs]).reshape(-1, 2)
        # (n, 3, 3) from true to measured motion.
        self._measured = measurement(
            diameter=1.0 + noise.diameter * errors[:, 0],
            wheelbase=1.0 + noise.wheelbase * errors[:, 1],
            separation=np.array([value(platform, "wheel_separation") for platform in platforms]),
            is_lateral=np.array([platform.limits.lateral > 0.0 for platform in platforms]),
        )
        truth = starts.copy()
        reported = np.zeros_like(starts)
        self._wheels = Wheels(self._measured, truth, reported, noise.slip, rngs)

    def read(self, rows: Indices, poses: Array, twists: Array) -> tuple[Array, Array]:
        """A reading of robots `rows` (m,): poses x, y, yaw, and twists linear, angular, lateral.

        Both results are (m, 3). `poses` (n, 3) in the world frame, yaw not wrapped, and `twists`
        (n, 3) in the base frames are the ground truth of all robots. Each call is one reading. Like
        real bases, the model takes the motion between two readings for a straight line along the
        mean heading.
        """
        if self._noise.is_ideal:
            return self._relative(rows, poses), twists[rows]
        reported = np.empty((len(rows), 3))
        measured = np.empty((len(rows), 3))
        at = np.ascontiguousarray(rows)
        self._wheels.read(at, poses, twists, reported, measured)
        return reported, measured

    def _relative(self, rows: Indices, poses: Array) -> Array:
        reported: Array = poses.take(rows, axis=0) - self._starts.take(rows, axis=0)
        cos, sin = self._turns.take(rows, axis=0).T
        ahead = cos * reported[:, 0] + sin * reported[:, 1]
        left = cos * reported[:, 1] - sin * reported[:, 0]
        yaw = (reported[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
        return np.stack((ahead, left, yaw), axis=-1)


def measurement(diameter: Array, wheelbase: Array, separation: Array, is_lateral: Array) -> Array:
    """Matrices (n, 3, 3) from true to measured motion (linear, angular, lateral), without slip.

    A row vector of true motion times the matrix is the measured motion. `diameter` and `wheelbase`
    (n,): E_d and E_b of UMBmark, the ratios of right to left wheel diameter and of true to assumed
    wheelbase. Odometry assumes wheels of the mean diameter, `separation` (n,) m apart. A base that
    cannot move sideways (not `is_lateral`) measures no lateral motion.
    """
    # Measured way / true way of each wheel: the mean diameter over the wheel's diameter. The true
    # ways are linear +- angular * base / 2. The measured linear motion is the mean of the measured
    # ways, the measured angular motion their difference / separation.
    right = (1.0 + diameter) / (2.0 * diameter)
    left = (1.0 + diameter) / 2.0
    base = separation * wheelbase
    matrix = np.zeros((len(diameter), 3, 3))
    matrix[:, 0, 0] = (right + left) / 2.0
    matrix[:, 1, 0] = (right - left) * base / 4.0
    matrix[:, 0, 1] = (right - left) / separation
    matrix[:, 1, 1] = (right + left) / 2.0 * wheelbase
    matrix[:, 2, 2] = is_lateral
    return matrix

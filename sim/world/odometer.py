"""What wheels tell of a body's motion: ideal, or with the systematic errors of real wheels.

Errors after Borenstein and Feng, UMBmark: A Method for Measuring, Comparing, and Correcting
Dead-Reckoning Errors in Mobile Robots (1995): E_d, the ratio of the right to the left wheel's
diameter, and E_b, that of the true to the assumed wheelbase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.sim.world.bodies import value
from swarmd.sim.world.lidar import Indices
from swarmd.sim.world.realism import OdometryNoise
from swarmd.sim.world.seeding import generator
from swarmd.values import Array, Platform


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
        """`platforms`, `starts` (n, 3) x, y, yaw and `ids` in the order of rows."""
        self._noise = noise
        self._starts = starts.copy()
        # numpy's vectorised sine and math's differ in the last bit.
        self._turns = np.array([(math.cos(yaw), math.sin(yaw)) for yaw in starts[:, 2]])
        self._turns = self._turns.reshape(-1, 2)
        if noise.is_ideal:
            return
        self._rngs = [generator(seed, "odometry", robot) for robot in ids]
        errors = np.array([rng.standard_normal(2) for rng in self._rngs]).reshape(-1, 2)
        self._measured = measurement(
            1.0 + noise.diameter * errors[:, 0],
            1.0 + noise.wheelbase * errors[:, 1],
            np.array([value(platform, "wheel_separation") for platform in platforms]),
            np.array([platform.limits.lateral > 0.0 for platform in platforms]),
        )
        self._truth, self._told = starts.copy(), np.zeros_like(starts)

    def read(self, rows: Indices, poses: Array, twists: Array) -> tuple[Array, Array]:
        """Poses x, y, yaw and twists linear, angular, lateral, (m, 3) each, of robots `rows` (m,).

        `poses` (n, 3) in the world frame, yaw not wrapped, and `twists` (n, 3) in the base frames
        are the truth of all robots. Each call is a reading: what a robot did since its last one
        is taken for one motion at constant speed, as real odometry takes it.
        """
        if self._noise.is_ideal:
            return self._relative(rows, poses), twists[rows]
        matrices = self._draw(rows)
        motion = _times(matrices, _motion(self._truth[rows], poses[rows]))
        self._truth[rows] = poses[rows]
        told = _moved(self._told[rows], motion)
        self._told[rows] = told
        told = told.copy()
        told[:, 2] = _wrapped(told[:, 2])
        return told, _times(matrices, twists[rows])

    def _relative(self, rows: Indices, poses: Array) -> Array:
        x, y, yaw = (poses[rows] - self._starts[rows]).T
        cos, sin = self._turns[rows].T
        return np.stack((cos * x + sin * y, cos * y - sin * x, _wrapped(yaw)), axis=-1)

    def _draw(self, rows: Indices) -> Array:
        """The matrices (m, 3, 3) from true to measured motions for one reading."""
        slips = np.ones((len(rows), 3))
        if self._noise.slip > 0.0:
            for place, row in enumerate(rows.tolist()):
                slips[place, :2] += self._noise.slip * self._rngs[row].standard_normal(2)
            slips[:, 2] = slips[:, 0]
        return slips[:, :, None] * self._measured[rows]


def measurement(diameter: Array, wheelbase: Array, separation: Array, is_lateral: Array) -> Array:
    """From true to measured motions (linear, angular, lateral): (n, 3, 3), without slip.

    Each wheel is taken to be of the mean diameter, and their distance to be `separation` (n,) m.
    A base that cannot move sideways does not notice that it does.
    """
    right, left = (1.0 + diameter) / (2.0 * diameter), (1.0 + diameter) / 2.0
    base = separation * wheelbase
    matrix = np.zeros((len(diameter), 3, 3))
    matrix[:, 0, 0] = (right + left) / 2.0
    matrix[:, 0, 1] = (right - left) * base / 4.0
    matrix[:, 1, 0] = (right - left) / separation
    matrix[:, 1, 1] = (right + left) / 2.0 * wheelbase
    matrix[:, 2, 2] = is_lateral
    return matrix


def _motion(before: Array, after: Array) -> Array:
    """Linear, angular and lateral way (m, 3) of a steady motion between two poses (m, 3)."""
    x, y, turn = (after - before).T
    middle = before[:, 2] + turn / 2.0
    cos, sin = np.cos(middle), np.sin(middle)
    # The way along an arc for one along its chord; beyond half a turn nobody knows the arc.
    arc = 1.0 / np.sinc(np.clip(turn, -np.pi, np.pi) / (2.0 * np.pi))
    return np.stack((arc * (cos * x + sin * y), turn, arc * (cos * y - sin * x)), axis=-1)


def _moved(before: Array, motion: Array) -> Array:
    """Poses (m, 3) after the steady motion: what `_motion` takes apart."""
    linear, turn, lateral = motion.T
    middle = before[:, 2] + turn / 2.0
    cos, sin = np.cos(middle), np.sin(middle)
    chord = np.sinc(turn / (2.0 * np.pi))
    way = (chord * (cos * linear - sin * lateral), chord * (sin * linear + cos * lateral), turn)
    after: Array = before + np.stack(way, axis=-1)
    return after


def _times(matrices: Array, vectors: Array) -> Array:
    """(m, 3, 3) times (m, 3), each in the same order of sums, however many there are."""
    product: Array = (matrices * vectors[:, None, :]).sum(axis=-1)
    return product


def _wrapped(yaw: Array) -> Array:
    wrapped: Array = (yaw + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped

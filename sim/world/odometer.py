"""Wheel odometry: ideal, or with the systematic errors of real wheels.

Errors after Borenstein and Feng, UMBmark: A Method for Measuring, Comparing, and Correcting
Dead-Reckoning Errors in Mobile Robots (1995): E_d, the ratio of the right to the left wheel's
diameter, and E_b, that of the true to the assumed wheelbase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Platform
from swarmd.sim.world.bodies import value
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.realism import OdometryNoise
from swarmd.sim.world.seeding import generator

if TYPE_CHECKING:  # where it is not compiled the numpy code runs
    from swarmd.sim.world.base_kernel import Wheels

ODOMETRY_RATE = 20.0
"""Hz, in live worlds and in lockstep."""

_DRAWS = 32  # readings whose random numbers are drawn at once


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
        # Drawn in blocks: one draw for each reading takes as long as all the rest.
        self._draws = np.empty((len(ids), _DRAWS, 2))
        self._used = np.full(len(ids), _DRAWS)
        self._truth, self._reported = starts.copy(), np.zeros_like(starts)
        kernel = compiled_kernel("swarmd.sim.world.base_kernel")
        self._wheels: Wheels | None = kernel and kernel.Wheels(
            self._measured, self._truth, self._reported
        )

    def read(self, rows: Indices, poses: Array, twists: Array) -> tuple[Array, Array]:
        """Poses x, y, yaw and twists linear, angular, lateral, (m, 3) each, of robots `rows` (m,).

        `poses` (n, 3) in the world frame, yaw not wrapped, and `twists` (n, 3) in the base frames
        are the truth of all robots. Each call is a reading: what a robot did since its last one
        is taken for a straight way along its mean heading, as real bases take it.
        """
        if self._noise.is_ideal:
            return self._relative(rows, poses), twists[rows]
        slips = self._slips(rows)
        if self._wheels is not None:
            moved, measured = np.empty((len(rows), 3)), np.empty((len(rows), 3))
            at = np.ascontiguousarray(rows)
            self._wheels.read(at, poses, twists, slips, moved, measured)
            return moved, measured
        truth = poses.take(rows, axis=0)
        motions = np.empty((len(rows), 2, 3))
        motions[:, 0] = _motion(self._truth.take(rows, axis=0), truth)
        motions[:, 1] = twists.take(rows, axis=0)
        motions = _measured(motions, self._measured.take(rows, axis=0))
        motions[:, :, :2] *= slips[:, None]
        reported = _moved(self._reported.take(rows, axis=0), motions[:, 0])
        self._truth[rows], self._reported[rows] = truth, reported
        reported[:, 2] = _wrapped(reported[:, 2])
        return reported, motions[:, 1]

    def _relative(self, rows: Indices, poses: Array) -> Array:
        reported: Array = poses.take(rows, axis=0) - self._starts.take(rows, axis=0)
        cos, sin = self._turns.take(rows, axis=0).T
        x, y = _turned_back(reported, cos, sin)
        return np.stack((x, y, _wrapped(reported[:, 2])), axis=-1)

    def _slips(self, rows: Indices) -> Array:
        """(m, 2) random slip factors near 1 on linear and angular motion, for one reading each."""
        used = self._used.take(rows)
        for row in rows[used == _DRAWS].tolist():
            self._rngs[row].standard_normal(out=self._draws[row])
        used %= _DRAWS
        self._used[rows] = used + 1
        slips: Array = 1.0 + self._noise.slip * self._draws[rows, used]
        return slips


def measurement(diameter: Array, wheelbase: Array, separation: Array, is_lateral: Array) -> Array:
    """From true to measured motions (linear, angular, lateral), without slip: (n, 3, 3).

    A true motion, as a row, times its matrix is the measured motion. Odometry assumes wheels of the
    mean diameter, `separation` (n,) m apart. A base that cannot move sideways does not measure
    lateral motion.
    """
    right, left = (1.0 + diameter) / (2.0 * diameter), (1.0 + diameter) / 2.0
    base = separation * wheelbase
    matrix = np.zeros((len(diameter), 3, 3))
    matrix[:, 0, 0] = (right + left) / 2.0
    matrix[:, 1, 0] = (right - left) * base / 4.0
    matrix[:, 0, 1] = (right - left) / separation
    matrix[:, 1, 1] = (right + left) / 2.0 * wheelbase
    matrix[:, 2, 2] = is_lateral
    return matrix


def _measured(motions: Array, matrices: Array) -> Array:
    """Motions (m, 2, 3) times matrices of `measurement` (m, 3, 3).

    Without BLAS, whose rounding depends on the processor.
    """
    linear, angular, lateral = np.moveaxis(motions, 2, 0)
    one = matrices[:, None]
    measured = np.empty_like(motions)
    measured[..., 0] = linear * one[..., 0, 0] + angular * one[..., 1, 0]
    measured[..., 1] = linear * one[..., 0, 1] + angular * one[..., 1, 1]
    measured[..., 2] = lateral * one[..., 2, 2]
    return measured


def _motion(before: Array, after: Array) -> Array:
    """Linear, angular and lateral motion (m, 3) between poses (m, 3), along the mean heading."""
    way = after - before
    middle = before[:, 2] + way[:, 2] / 2.0
    linear, lateral = _turned_back(way, np.cos(middle), np.sin(middle))
    return np.stack((linear, way[:, 2], lateral), axis=-1)


def _turned_back(way: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    """x and y of world vectors (m, ...) in frames at these headings."""
    x, y = way[:, 0], way[:, 1]
    return cos * x + sin * y, cos * y - sin * x


def _moved(before: Array, motion: Array) -> Array:
    """Poses (m, 3) after a motion along the mean heading, the inverse of `_motion`."""
    linear, turn, lateral = motion[:, 0], motion[:, 1], motion[:, 2]
    middle = before[:, 2] + turn / 2.0
    cos, sin = np.cos(middle), np.sin(middle)
    after = before.copy()
    after[:, 0] += cos * linear - sin * lateral
    after[:, 1] += sin * linear + cos * lateral
    after[:, 2] += turn
    return after


def _wrapped(yaw: Array) -> Array:
    wrapped: Array = (yaw + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped

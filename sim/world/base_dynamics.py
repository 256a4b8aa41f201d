"""How simulated bases follow commands: delay, acceleration caps, and a servo whose tyres slip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Platform
from swarmd.sim.world.bodies import inertia, value
from swarmd.sim.world.realism import Actuation

if TYPE_CHECKING:
    import mujoco

    from swarmd.sim.world.base_kernel import Servos

_GRAVITY = 9.81
_FRICTION = 0.8


class BaseDynamics:
    """Velocity servos of n planar bases; row i of every array is platform i.

    `limits` (n, 3) of commands and `gains` (n, 3), their changes in a step; `inert` (n, 3) kg, kg,
    kg m2; `grip` (n,) N and `spin` (n,) N m, the most that the tyres pass on.
    """

    def __init__(self, platforms: Sequence[Platform], dt: float) -> None:
        n = len(platforms)
        self._dt = dt
        self.limits = _limits(platforms)
        self.gains = np.array([_accelerations(p) for p in platforms]).reshape(n, 3) * dt
        mass = np.array([value(p, "mass") for p in platforms])
        self.inert = np.stack((mass, mass, [inertia(p) for p in platforms]), axis=-1)
        self.grip = _FRICTION * _GRAVITY * mass
        self.spin = self.grip * [value(p, "wheel_separation") / 2.0 for p in platforms]
        self._target, self._driven = np.zeros((n, 3)), np.zeros((n, 3))

    def set(self, twists: Array) -> None:
        """Set the commands (n, 3) linear, angular, lateral in each base frame.

        They are clipped to each platform's limits, as firmware does; non-finite values become 0.
        """
        finite = np.where(np.isfinite(twists), twists, 0.0)
        self._target = np.minimum(np.maximum(finite, -self.limits), self.limits)

    def forces(self, pose: Array, velocity: Array) -> Array:
        """Forces and torques (n, 3) for the next step, with poses and world velocities (n, 3).

        The force that reaches the commanded velocity within one step, up to the friction of the
        tyres (Coulomb, isotropic). MuJoCo's velocity actuators are not used: a stiff one with a
        force limit chatters by 0.04 m/s at rest, a soft one lags.
        """
        gain = np.minimum(self._target - self._driven, self.gains)
        self._driven += np.maximum(gain, -self.gains, out=gain)
        linear, angular, lateral = self._driven.T
        # Half a step ahead, the heading at which this step's displacement is a chord of the arc.
        yaw = pose[:, 2] + angular * (self._dt / 2.0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        force = np.empty_like(pose)
        force[:, 0] = cos * linear - sin * lateral
        force[:, 1] = sin * linear + cos * lateral
        force[:, 2] = angular
        force -= velocity
        force *= self.inert
        force /= self._dt
        size = np.hypot(force[:, 0], force[:, 1])
        force[:, :2] *= np.minimum(1.0, self.grip / np.maximum(size, 1e-12))[:, None]
        force[:, 2] = np.minimum(np.maximum(force[:, 2], -self.spin), self.spin)
        return force


def _limits(platforms: Sequence[Platform]) -> Array:
    limits = [(p.limits.linear, p.limits.angular, p.limits.lateral) for p in platforms]
    return np.array(limits).reshape(-1, 3)


def _accelerations(platform: Platform) -> tuple[float, float, float]:
    linear = value(platform, "linear_acceleration")
    return linear, value(platform, "angular_acceleration"), linear


class Actuators:
    """Delays the commands of n bases and caps their accelerations.

    `BaseDynamics` applies each platform's own limits and ramps afterwards. Ideal actuation passes
    commands on unchanged. `gains` (3,): the most that a command changes in a step.
    """

    def __init__(self, actuation: Actuation, platforms: Sequence[Platform], dt: float) -> None:
        """`platforms` (n,) in the order of rows; the delay is rounded to whole steps of `dt` s."""
        n = len(platforms)
        self.delay_steps = round(actuation.delay / dt)
        self._line = [np.zeros((n, 3))] * (self.delay_steps + 1)
        self._step = 0
        linear, angular = actuation.linear_acceleration, actuation.angular_acceleration
        self.is_capped = linear is not None or angular is not None
        caps = [np.inf if cap is None else cap * dt for cap in (linear, angular, linear)]
        self.gains = np.array(caps)
        self.limits = _limits(platforms)
        self._command, self._driven = np.zeros((n, 3)), np.zeros((n, 3))

    def put(self, commands: Array) -> None:
        """Set the commands (n, 3) linear, angular, lateral."""
        self._command = commands.copy()

    def now(self) -> Array:
        """The commands (n, 3) in effect in this step; call once a step."""
        length = len(self._line)
        self._line[self._step % length] = self._command
        self._step += 1
        late = self._line[self._step % length]  # the oldest: from `delay_steps` ago
        if not self.is_capped:
            return late
        # A ramp towards a speed that the base cannot reach would lag when the command reverses.
        target = np.clip(np.where(np.isfinite(late), late, 0.0), -self.limits, self.limits)
        self._driven = self._driven + np.clip(target - self._driven, -self.gains, self.gains)
        return self._driven


class Bases:
    """The bases of a world: delay, acceleration caps and servos, on MuJoCo's own memory."""

    def __init__(
        self, actuation: Actuation, platforms: Sequence[Platform], data: mujoco.MjData, dt: float
    ) -> None:
        """`platforms` (n,) in the order of rows; they are the first bodies of `data`."""
        self._n = len(platforms)
        self._data = data.qpos, data.qvel, data.qfrc_applied  # views of MuJoCo's memory
        self.before: tuple[Array, Array] = self._data[0].copy(), self._data[1].copy()
        """Positions and velocities of all bodies when `drive` was called."""
        self._actuators = Actuators(actuation, platforms, dt)
        self._drives = BaseDynamics(platforms, dt)
        kernel = compiled_kernel("swarmd.sim.world.base_kernel")
        self._servos: Servos | None = kernel and kernel.Servos(
            self._actuators, self._drives, dt, self._data, self.before
        )

    def put(self, twists: Array) -> None:
        """Set the commands (n, 3) linear, angular, lateral; non-finite values become 0."""
        if self._servos is not None:
            self._servos.put(np.ascontiguousarray(twists, dtype=np.float64))
        else:
            self._actuators.put(twists)

    def drive(self) -> None:
        """Set the forces for the next step; call it once a step."""
        if self._servos is not None:
            self._servos.drive()
            return
        qpos, qvel, applied = self._data
        self.before = qpos.copy(), qvel.copy()
        self._drives.set(self._actuators.now())
        poses, velocities = (values.reshape(-1, 3)[: self._n] for values in self.before)
        applied[: 3 * self._n] = self._drives.forces(poses, velocities).ravel()

"""Bases that follow restless commands on a free floor, with monitors of assumptions. No MuJoCo.

Actuation and odometry are those of the simulator: delay, ramps, tyres and wheel errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from swarmd.core.values import Array, Odometry, Platform, Pose, Twist
from swarmd.robot.protection import assumption_monitor
from swarmd.sim.world import base
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.odometer import ODOMETRY_RATE, Odometers
from swarmd.sim.world.realism import REALISTIC, Actuation, OdometryNoise

DT = 0.01  # s
TICK = 5  # steps of DT between two decisions, and two readings
STYLES = ("steps", "curves", "shuttle")
"""Random twists held for 0.3 to 2 s, at once or with smooth changes and stops at once; to and fro
at top speed."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """An event of the monitor of robot `row` at `time` s."""

    row: int
    time: float
    text: str


def noisy(factor: float) -> OdometryNoise:
    """The simulator's realistic odometry, `factor` times as noisy."""
    usual = REALISTIC.odometry
    return OdometryNoise(
        diameter=factor * usual.diameter,
        wheelbase=factor * usual.wheelbase,
        slip=factor * usual.slip,
    )


class RestlessBases:
    """`count` robots of a platform, whose brakes are a share `brakes` of the declared ones.

    `sideways`: share of the declared brakes of a base that moves sideways; None: as `brakes`.
    `styles` of their commands, in turn. `delay` in s from command to base, `lag` in s from a
    reading to its arrival.
    """

    def __init__(
        self,
        platform: Platform,
        count: int,
        *,
        brakes: float = 1.0,
        sideways: float | None = None,
        noise: OdometryNoise | None = None,
        delay: float = REALISTIC.actuation.delay,
        lag: float = 0.0,
        styles: Sequence[str] = STYLES,
        seed: int = 1,
    ) -> None:
        barrier = platform.protection["barrier"]
        body = {
            **platform.body,
            "linear_acceleration": brakes * barrier["braking_linear"],
            "angular_acceleration": brakes * barrier["braking_angular"],
            "lateral_acceleration": barrier["braking_linear"]
            * (brakes if sideways is None else sideways),
        }
        bases = [replace(platform, body=body)] * count
        self._pose, self._velocity, self._force = (np.zeros((count, 3)) for _ in range(3))
        memory = self._pose.ravel(), self._velocity.ravel(), self._force.ravel()
        self._bases = base.Bases(Actuation(delay=delay), bases, memory, DT)
        ids, noise = [f"r{i}" for i in range(count)], noise or REALISTIC.odometry
        self._odometers = Odometers(noise, bases, np.zeros((count, 3)), ids, seed)
        self.monitors = [assumption_monitor.AssumptionMonitor(platform) for _ in range(count)]
        self._rng = np.random.default_rng(seed)
        limits = platform.limits
        axes = (limits.linear, limits.angular, limits.lateral)
        self._top = np.array(axes if limits.lateral > 0.0 else axes[:2])
        self._styles = np.arange(count) % len(styles)
        self._styles = np.array([STYLES.index(style) for style in styles])[self._styles]
        self._until = np.zeros(count)
        self._goals, self._wanted = (np.zeros((count, len(self._top))) for _ in range(2))
        self._coming: list[tuple[float, float, Array, Array]] = []
        self._lag, self._step = lag, 0
        self.alarms: list[Alarm] = []

    def run(self, seconds: float) -> list[Alarm]:
        """Drive on for `seconds`; all alarms so far."""
        rows = np.arange(len(self.monitors))
        for _ in range(round(seconds / DT)):
            now = self._step * DT
            if self._step % TICK == 0:
                self._read(now, rows)
                self._command(now)
            self._bases.drive()
            self._velocity += self._force / self._bases.inert * DT
            self._pose += self._velocity * DT
            self._step += 1
        return self.alarms

    def _read(self, now: float, rows: Indices) -> None:
        yaw = self._pose[:, 2]
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y, turning = self._velocity.T
        twists = np.stack((cos * x + sin * y, turning, cos * y - sin * x), axis=1)
        self._coming.append((now + self._lag, now, *self._odometers.read(rows, self._pose, twists)))
        while self._coming and self._coming[0][0] <= now + 1e-9:
            _, stamp, poses, measured = self._coming.pop(0)
            readings = zip(self.monitors, poses.tolist(), measured.tolist(), strict=True)
            for row, (monitor, pose, twist) in enumerate(readings):
                odometry = Odometry(stamp, Pose(*pose), Twist(*twist))
                self._note(row, now, monitor.on_odometry(odometry))

    def _note(self, row: int, now: float, text: str) -> None:
        if text:
            self.alarms.append(Alarm(row, now, text))

    def _command(self, now: float) -> None:
        count, rng = len(self.monitors), self._rng
        due = now >= self._until
        waits = rng.uniform(0.3, 2.0, count)
        goals = rng.uniform(-1.0, 1.0, (count, len(self._top))) * self._top
        goals[rng.random(count) < 0.3] = 0.0
        self._goals[due] = goals[due]
        smooth = self._wanted + 0.25 * (self._goals - self._wanted)
        is_zero = (self._goals == 0.0).all(axis=1)
        for k, style in enumerate(STYLES):
            rows = self._styles == k
            if style == "steps":
                self._wanted[rows] = self._goals[rows]
            elif style == "curves":
                self._wanted[rows] = np.where(is_zero[:, None], 0.0, smooth)[rows]
            else:
                way = np.eye(len(self._top))[int(now / 2.5) % len(self._top)]
                turn = (np.floor(now / 1.25) % 2.0) * np.sign(np.cos(0.37 * now))
                self._wanted[rows] = turn * self._top * way
        self._until[due] = now + waits[due]
        commands = np.zeros((count, 3))
        commands[:, : len(self._top)] = self._wanted
        commands *= np.array([monitor.speed_share for monitor in self.monitors])[:, None]
        for row, (monitor, twist) in enumerate(zip(self.monitors, commands.tolist(), strict=True)):
            self._note(row, now, monitor.on_command(Twist(*twist)))
        self._bases.put(commands)


assert round(ODOMETRY_RATE * TICK * DT) == 1

"""A swarm in the plane: patterns that see each other and move, without physics or protection.

Robots are points with a round lidar housing that the others see. It shows within a second, and
without MuJoCo, what a pattern does in closed loop, but not whether robots touch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarmd.core.values import ZERO, Array, Inputs, Message, Outputs, Platform, Pose, Scan, Twist
from swarmd.kit.behavior import Pattern
from swarmd.testing.scans import Disc, scan_of

_PERIOD = 0.1
_ACCELERATION = (1.0, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A record every 0.1 s: (t, n, 3) poses, (t, n) speeds, (t, n) nearest ranges in m."""

    poses: Array
    speeds: Array
    nearest: Array


class Flatland:
    """Robots of one platform in a square room; `poses` (n, 3) x, y, yaw.

    Patterns are stepped at 10 Hz; lidars spin at the platform's rate, each in its own phase. All
    others receive a message one step later.
    """

    def __init__(
        self,
        platform: Platform,
        patterns: Sequence[Pattern[Any]],
        poses: Array,
        *,
        room: float,
        seed: int = 0,
        noise: float = 0.01,
    ) -> None:
        self.platform = platform
        self.patterns = patterns
        self.poses = np.array(poses, dtype=np.float64)
        self.room = room
        self.noise = noise
        self.outputs: list[Outputs] = [Outputs() for _ in patterns]
        self._rng = np.random.default_rng(seed)
        self._tick = 0
        self._twists = np.zeros((len(patterns), 2))
        self._scans: list[Scan | None] = [None] * len(patterns)
        self._scan_due = self._rng.uniform(0.0, 1.0 / platform.scan.rate, len(patterns))

    def run(self, seconds: float) -> Course:
        """Simulate so many seconds."""
        poses, speeds, nearest = [], [], []
        for _ in range(round(seconds / _PERIOD)):
            nearest.append(self._step())
            poses.append(self.poses.copy())
            speeds.append(self._twists[:, 0].copy())
        return Course(np.array(poses), np.array(speeds), np.array(nearest))

    def _step(self) -> list[float]:
        now = _PERIOD * self._tick
        said = [dict(outputs.messages) for outputs in self.outputs]
        is_new = [self._scan_if_due(robot, now) for robot in range(len(self.patterns))]
        for robot, pattern in enumerate(self.patterns):
            messages = tuple(
                Message(self.patterns[other].context.robot, channel, value, _PERIOD)
                for other, words in enumerate(said)
                for channel, value in words.items()
                if other != robot
            )
            dt = _PERIOD if self._tick else 0.0
            scan = self._scans[robot]
            inputs = Inputs(now, dt, scan, is_new[robot], messages=messages)
            self.outputs[robot] = pattern.step(inputs)
        self._move([self.platform.limits.clip(one.twist or ZERO) for one in self.outputs])
        self._tick += 1
        return [math.inf if s is None else float(np.min(s.ranges)) for s in self._scans]

    def _scan_if_due(self, robot: int, now: float) -> bool:
        if now < self._scan_due[robot]:
            return False
        self._scan_due[robot] += 1.0 / self.platform.scan.rate
        others = [i for i in range(len(self.patterns)) if i != robot]
        x, y, yaw = self.poses[robot].tolist()
        self._scans[robot] = scan_of(
            self.platform,
            [self._housing(other) for other in others],
            room=self.room,
            pose=Pose(x, y, yaw),
            seq=self._tick,
            noise=self.noise,
            rng=self._rng,
        )
        return True

    def _housing(self, robot: int) -> Disc:
        x, y, yaw = self.poses[robot].tolist()
        ahead, left = self.platform.scan.offset
        return Disc(
            x + ahead * math.cos(yaw) - left * math.sin(yaw),
            y + ahead * math.sin(yaw) + left * math.cos(yaw),
            self.platform.body.get("target_radius", 0.05),
        )

    def _move(self, commands: Sequence[Twist]) -> None:
        wanted = np.array([(command.linear, command.angular) for command in commands])
        step = _PERIOD * np.array(_ACCELERATION)
        self._twists += np.clip(wanted - self._twists, -step, step)
        yaw = self.poses[:, 2] + 0.5 * _PERIOD * self._twists[:, 1]
        self.poses[:, 0] += _PERIOD * self._twists[:, 0] * np.cos(yaw)
        self.poses[:, 1] += _PERIOD * self._twists[:, 0] * np.sin(yaw)
        self.poses[:, 2] += _PERIOD * self._twists[:, 1]

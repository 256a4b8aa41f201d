"""A ROS 2 base on a block behind the real bridge: its wheels turn, and its scan shows a room."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np

from tests.drivers.ros2.dds_rig import DdsRobot
from tests.drivers.ros2.robots import RAYS
from tests.support import ros2_types as dds

PERIOD = 0.05  # s between two readings of odometry
SCAN_EVERY = 4  # periods
SWEEP = 0.2  # s of a revolution: a scan is stamped at its oldest ray
BRAKING = 1.0  # m/s2
SPAN = 2.2  # m, half of the side of the room


class LiftedBase(DdsRobot):
    """Publishes the pose that its wheels make of the commands, and a square room with noise.

    `ignores_zero`: the fault of that name. `speed` in m/s. On a busy machine it is late, but leaves
    nothing out, and its stamps are regular.
    """

    def __init__(self, *, ignores_zero: bool = False, **fields: Any) -> None:
        super().__init__(**fields)
        self.speed = self.way = 0.0
        self._ignores_zero = ignores_zero
        self._is_over = threading.Event()
        self._draws = np.random.default_rng(1)
        self._turning = threading.Thread(target=self._turn)
        self._turning.start()

    def _turn(self) -> None:
        wanted, count, due = 0.0, 0, time.time()
        while not self._is_over.wait(max(0.0, due - time.time())):
            for command in self.commands():
                if not (self._ignores_zero and command.is_zero):
                    wanted = command.linear
            step = BRAKING * PERIOD
            self.speed += max(-step, min(step, wanted - self.speed))
            self.way += PERIOD * self.speed
            self.put("odom", self._odometry(due))
            if count % SCAN_EVERY == 0:
                self.put("scan", self._scan(due - SWEEP))
            count, due = count + 1, due + PERIOD

    def _odometry(self, stamp: float) -> dds.Odometry:
        message = dds.Odometry(dds.stamped(stamp, "odom"), "base_footprint")
        message.pose.pose.position.x = self.way
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x = self.speed
        return message

    def _scan(self, stamp: float) -> dds.LaserScan:
        bearings = np.arange(RAYS) * 2.0 * math.pi / RAYS
        ranges = SPAN / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
        ranges += self._draws.normal(0.0, 0.005, RAYS)
        step = 2.0 * math.pi / RAYS
        return dds.LaserScan(
            dds.stamped(stamp, "base_scan"),
            angle_increment=step,
            angle_max=(RAYS - 1) * step,
            range_min=0.12,
            range_max=3.5,
            ranges=ranges.tolist(),
        )

    def close(self) -> None:
        self._is_over.set()
        self._turning.join()
        super().close()


def is_driving(base: LiftedBase) -> bool:
    """True while its wheels turn."""
    return base.speed > 0.05

"""A robot of which there is nothing but its YAML file: seven ranges over ROS 2, and it drives."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import pytest

from swarmd.core.clock import boottime
from swarmd.core.values import Value
from swarmd.network.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.settings.platforms import load_platform
from tests.driver_api.test_watchdog_drivers import Course
from tests.drivers.ros2.robots import BridgedRobot, odometry
from tests.support import ros2_types as dds
from tests.support.drive_daemon import ROBOT, drive, status
from tests.support.processes import DaemonProcess, unique_swarm, wait_until

pytestmark = pytest.mark.integration

NAMESPACE = ROBOT.replace("-", "_")
FRONT = ("left", "center_left", "center", "center_right", "right")


class Thymio(BridgedRobot):
    """Speaks as thymio_driver does, within its namespace: +inf is nothing seen."""

    platform = load_platform("thymio")

    def __init__(self) -> None:
        self.seen: dict[str, float] = {}
        super().__init__()

    def command_key(self) -> str:
        return f"{NAMESPACE}/cmd_vel"

    def beat(self, count: int) -> None:
        stamp = 100.0 + 0.05 * count
        BridgedRobot.put(self, f"{NAMESPACE}/odom", odometry(stamp, x=0.005 * count))
        for name in (*FRONT, "rear_left", "rear_right") if count % 2 == 0 else ():
            message = dds.Range(header=dds.stamped(stamp), range=self.seen.get(name, math.inf))
            BridgedRobot.put(self, f"{NAMESPACE}/proximity/{name}", message)


class Table(Course):
    """A Thymio that speaks, and what it was told."""

    robot: Thymio

    def _speak(self) -> None:
        count = 0
        while not self._ending.wait(0.05):
            count += 1
            self.robot.beat(count)
            self.told += [(boottime(), twist) for twist in self.robot.commands()]


def test_a_thymio_drives_and_keeps_off_a_hand(tmp_path: Path) -> None:
    swarm, robot = unique_swarm(), Thymio()
    options: dict[str, Value] = {
        "platform": "thymio",
        "driver": "ros2dds",
        "driver_options": {"endpoint": robot.endpoint},
    }
    with (
        contextlib.closing(Table(robot)) as table,
        DaemonProcess(tmp_path, swarm=swarm, robot=ROBOT, endpoint="", options=options) as daemon,
        Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
    ):
        daemon.wait_ready()
        begun = boottime()
        drive(operator)
        table.first(begun, moving=True)
        wait_until(lambda: table.told[-1][1].linear > 0.0, "it drives ahead")
        robot.seen = dict.fromkeys(FRONT, 0.03)  # a hand
        wait_until(lambda: table.told[-1][1].linear < 0.0, "it backs away")
        now = status(operator)
        assert now is not None
        gap = now.decision.min_gap
        assert gap is not None
        assert 0.005 < gap < 0.035  # the hand is rounder than the outline

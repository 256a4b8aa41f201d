"""Every ROS 2 driver's watchdog: its daemon killed and frozen, the robot without a timeout."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.clock import boottime
from swarmd.core.values import Twist, Value
from swarmd.network.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.testing.driver_contract import is_running
from tests.drivers.ros2.dds_rig import DdsRobot
from tests.drivers.ros2.robots import RAYS, BridgedRobot, Robot, ZenohRobot, odometry, scan
from tests.support.drive_daemon import ROBOT, drive
from tests.support.processes import DaemonProcess, unique_swarm, wait_until, watchdogs
from tests.support.ros2_bridge import why_no_bridge

pytestmark = pytest.mark.integration

BRIDGED = "ros2dds, DDS and a real bridge"
NO_BRIDGE = pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge())
KINDS: dict[str, tuple[str, Callable[[], Robot]]] = {
    "ros2dds": ("ros2dds", BridgedRobot),
    "ros2dds, stamped": ("ros2dds", lambda: BridgedRobot(is_stamped=True)),
    BRIDGED: ("ros2dds", DdsRobot),
    "rmw_zenoh": ("rmw_zenoh", ZenohRobot),
    "rmw_zenoh, Humble": ("rmw_zenoh", lambda: ZenohRobot(is_humble=True)),
}
SLACK = 1.0
"""Seconds beyond the 0.6 promised, for a starved machine."""


class Course:
    """A robot that speaks as a TurtleBot3 does, and what it was told, when."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.told: list[tuple[float, Twist]] = []
        self._ending = threading.Event()
        self._rng = np.random.default_rng(1)
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join(30.0)
        self.robot.close()

    def first(self, since: float, *, moving: bool) -> float:
        """When it was first told to move, or to stand, after `since`."""
        found: list[float] = []

        def look() -> bool:
            found[:] = [t for t, twist in self.told if t > since and twist.is_zero != moving]
            return bool(found)

        wait_until(look, "it is told to move" if moving else "it is told to stand")
        return found[0]

    def stands(self, since: float, seconds: float) -> None:
        """From `since` on it is told to stand, again and again, for so long."""
        wait_until(lambda: self.told[-1][0] > since + seconds, "commands for long enough")
        after = [(t - since, twist) for t, twist in self.told if t >= since]
        assert not [t for t, twist in after if not twist.is_zero]
        assert len(after) > 5.0 * seconds

    def _speak(self) -> None:
        count = 0
        while not self._ending.wait(0.05):
            count += 1
            stamp = 100.0 + 0.05 * count
            self.robot.put("odom", odometry(stamp, x=0.005 * count))
            if count % 4 == 0:
                ranges = 2.0 + 0.01 * self._rng.standard_normal(RAYS)
                self.robot.put("scan", scan(stamp, ranges.tolist()))
            self.told += [(boottime(), twist) for twist in self.robot.commands()]


@pytest.fixture(
    params=[pytest.param(kind, marks=NO_BRIDGE if kind == BRIDGED else ()) for kind in KINDS]
)
def driven(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Iterator[tuple[Course, DaemonProcess]]:
    """A robot that drives under a daemon, and moves."""
    driver, make = KINDS[request.param]
    swarm, robot = unique_swarm(), make()
    options: dict[str, Value] = {
        "platform": "burger",
        "driver": driver,
        "driver_options": dict(robot.options({"domain": 0} if driver == "rmw_zenoh" else {})),
    }
    with (
        contextlib.closing(Course(robot)) as course,
        DaemonProcess(tmp_path, swarm=swarm, robot=ROBOT, endpoint="", options=options) as daemon,
        Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
    ):
        daemon.wait_ready()
        begun = boottime()
        drive(operator)
        course.first(begun, moving=True)
        assert watchdogs(swarm, ROBOT)
        yield course, daemon


def test_a_killed_daemon_is_stopped_for(driven: tuple[Course, DaemonProcess]) -> None:
    course, daemon = driven
    killed = boottime()
    daemon.kill()
    zero = course.first(killed, moving=False)
    assert zero - killed < 0.6 + SLACK
    course.stands(zero, 3.0)
    assert watchdogs(daemon.swarm, ROBOT), "it goes on until a daemon is back"


def test_a_frozen_daemon_is_stopped_for(driven: tuple[Course, DaemonProcess]) -> None:
    course, daemon = driven
    frozen = boottime()
    daemon.freeze()
    try:
        zero = course.first(frozen, moving=False)
        assert 0.3 < zero - frozen < 0.6 + SLACK
        course.stands(zero, 3.0)
        thawed = boottime()
    finally:
        daemon.thaw()
    wait_until(lambda: course.told[-1][0] > thawed + 1.0, "it commands again")
    assert is_running(daemon.process.pid)
    late = [t - thawed for t, twist in course.told if t > thawed + 0.2 and not twist.is_zero]
    assert not late, "a daemon that stood for so long does not drive on"

"""Whole daemons with the ROS drivers, killed and frozen while the robot moves without a timeout."""

from __future__ import annotations

import contextlib
import math
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import State
from swarmd.core.refusal import Refusal
from swarmd.core.values import Twist, Value
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import Rig, is_running
from tests.drivers.ros1.rig import RosRobot
from tests.drivers.ros2.dds_rig import DdsRobot
from tests.drivers.ros2.robots import RAYS, BridgedRobot, Robot, ZenohRobot, command, odometry, scan
from tests.support import ros2_types as dds
from tests.support.drive_daemon import ROBOT, drive, status
from tests.support.fake_body import IN_FLIGHT
from tests.support.processes import DaemonProcess, children, unique_swarm, wait_until, watchdogs
from tests.support.ros2_bridge import why_no_bridge
from tests.support.swarmctl import heard_statuses

pytestmark = pytest.mark.integration

NO_BRIDGE = pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge())
NAMESPACE = ROBOT.replace("-", "_")
RIVAL_SPEED = 0.3
FRONT = ("left", "center_left", "center", "center_right", "right")


@dataclass(frozen=True)
class Setup:
    """A robot and the daemon's options for it; `publish` is called every 50 ms with a count.

    `zero_time`: seconds of zeros after the daemon's end. `slack`: seconds beyond the 0.6 promised,
    for a starved machine.
    """

    driver: str
    robot: Rig
    options: Mapping[str, Value]
    publish: Callable[[int], None]
    platform: str = "burger"
    zero_time: float = 3.0
    slack: float = 4.0


class Course:
    """A robot that publishes, and the commands that reached it, with their times."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.commands: list[tuple[float, Twist]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join(30.0)
        self.setup.robot.close()

    def moves(self, since: float) -> None:
        """A command to move comes after `since`."""

        def has_come() -> bool:
            return any(t > since and not twist.is_zero for t, twist in self.commands)

        wait_until(has_come, "a command to move")

    def stands(self, since: float, seconds: float) -> float:
        """When the zeros began that come for `seconds` at least, more than 5 for each of these.

        A command to move may follow a zero in one reading: a late decision gives one zero, too.
        The adapter of ROS 1 ends after 2 s of zeros, which a stall squeezes into one reading: no
        command to move follows them for `seconds`, then.
        """
        zeros: list[float] = []
        has_end = self.setup.driver == "ros1"

        def have_come() -> bool:
            after = [(t, twist) for t, twist in self.commands if t > since]
            zeros[:] = [t for t, _ in takewhile(lambda one: one[1].is_zero, reversed(after))]
            if len(zeros) <= 5.0 * seconds:
                return False
            return (boottime() if has_end else zeros[0]) - zeros[-1] > seconds

        wait_until(have_come, "zeros for long enough")
        return zeros[-1]

    def gets_only_zeros(self, since: float, seconds: float) -> None:
        """Only zeros arrive for `seconds` at least, more than 5 for each of these."""
        after: list[tuple[float, Twist]] = []

        def have_come() -> bool:
            after[:] = [(t - since, twist) for t, twist in self.commands if t >= since]
            return self.commands[-1][0] > since + seconds and len(after) > 5.0 * seconds

        wait_until(have_come, "commands for long enough")
        assert not [t for t, twist in after if not twist.is_zero]

    def _run(self) -> None:
        count = 0
        while not self._ending.wait(0.05):
            count += 1
            self.setup.publish(count)
            self.commands += [(boottime(), twist) for twist in self.setup.robot.commands()]


def ros2(driver: str, robot: Robot) -> Setup:
    rng, start = np.random.default_rng(1), boottime() - 100.0

    def publish(count: int) -> None:
        stamp = boottime() - start  # by a count, a busy machine would seem to have late scans
        robot.put("odom", odometry(stamp, x=0.1 * stamp))
        if count % 4 == 0:
            ranges = 2.0 + 0.01 * rng.standard_normal(RAYS)
            robot.put("scan", scan(stamp, ranges.tolist()))

    domain: dict[str, Value] = {"domain": 0} if driver == "rmw_zenoh" else {}
    return Setup(driver, robot, robot.options(domain), publish)


def ros1(request: pytest.FixtureRequest) -> Setup:
    robot = RosRobot(request.getfixturevalue("roscore"))
    robot.do("rate", hz=10)
    return Setup("ros1", robot, robot.options, lambda count: None, zero_time=1.0, slack=5.0)


KINDS: dict[str, Callable[[pytest.FixtureRequest], Setup]] = {
    "ros2dds": lambda request: ros2("ros2dds", BridgedRobot()),
    "ros2dds, real bridge": lambda request: ros2("ros2dds", DdsRobot()),
    "rmw_zenoh": lambda request: ros2("rmw_zenoh", ZenohRobot()),
    "ros1": ros1,
}


@contextlib.contextmanager
def driven(setup: Setup, folder: Path) -> Iterator[tuple[Course, DaemonProcess, Operator]]:
    """A robot that a daemon has made to move."""
    swarm = unique_swarm()
    options: dict[str, Value] = {
        "platform": setup.platform,
        "driver": setup.driver,
        "driver_options": dict(setup.options),
    }
    with (
        contextlib.closing(Course(setup)) as course,
        DaemonProcess(folder, swarm=swarm, robot=ROBOT, endpoint="", options=options) as daemon,
        Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
    ):
        daemon.wait_ready()
        begun = boottime()
        drive(operator)
        course.moves(begun)
        yield course, daemon, operator


@pytest.fixture(
    params=[pytest.param(kind, marks=NO_BRIDGE if "bridge" in kind else ()) for kind in KINDS]
)
def moving(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Iterator[tuple[Course, DaemonProcess]]:
    with driven(KINDS[request.param](request), tmp_path) as (course, daemon, _):
        yield course, daemon


def test_the_robot_of_a_killed_daemon_stops(moving: tuple[Course, DaemonProcess]) -> None:
    course, daemon = moving
    has_watchdog = course.setup.driver != "ros1"  # whose adapter ends after 2 s of zeros
    assert bool(watchdogs(daemon.swarm, ROBOT)) == has_watchdog
    started, killed = children(daemon.process.pid), boottime()
    daemon.kill()
    zero = course.stands(killed, course.setup.zero_time)
    assert zero - killed < 0.6 + course.setup.slack
    assert bool(watchdogs(daemon.swarm, ROBOT)) == has_watchdog, "until a daemon is back"
    wait_until(lambda: not any(map(is_running, started)), "its child processes have ended")


def test_the_robot_of_a_frozen_daemon_stops(moving: tuple[Course, DaemonProcess]) -> None:
    course, daemon = moving
    frozen = boottime()
    daemon.freeze()
    try:
        zero = course.stands(frozen, 1.5)  # more than the 1 s after which a run ends
        # Not before 0.4 s of silence: tests/driver_api/test_watchdog.py, to the tick.
        assert zero - frozen < 0.6 + course.setup.slack
        thawed = boottime()
    finally:
        daemon.thaw()
    wait_until(lambda: course.commands[-1][0] > thawed + 1.0, "the daemon commands again")
    assert is_running(daemon.process.pid)
    late = [t - thawed for t, twist in course.commands if t > thawed and not twist.is_zero]
    assert len(late) <= IN_FLIGHT, "the stall has ended the run"


@pytest.mark.smoke
def test_a_robot_on_the_emulated_hub_is_driven_and_stopped(tmp_path: Path) -> None:
    with driven(ros2("ros2dds", BridgedRobot()), tmp_path) as (course, _, operator):
        asked = boottime()
        operator.send_stop("estop", reason="test")
        course.stands(asked, 1.0)

        def is_latched() -> bool:
            now = status(operator)
            return now is not None and now.state is State.ESTOPPED

        wait_until(is_latched, "its status says so")


class Rival:
    """Another node that commands the robot 50 times a second."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join(30.0)

    def _run(self) -> None:
        while not self._ending.wait(0.02):
            self._robot.put("cmd_vel", command(RIVAL_SPEED))


@pytest.mark.parametrize(("driver", "make"), [("ros2dds", BridgedRobot), ("rmw_zenoh", ZenohRobot)])
def test_an_estopped_robot_gets_zero_after_each_command_of_another_node(
    driver: str, make: Callable[[], Robot], tmp_path: Path
) -> None:
    robot = make()

    def shows(operator: Operator, text: str) -> bool:
        now = status(operator)
        return now is not None and now.health.driver.startswith(text)

    with driven(ros2(driver, robot), tmp_path) as (course, _, operator):
        with contextlib.closing(Rival(robot)):
            wait_until(lambda: shows(operator, "someone else drives"), "its status says so")
            reply = operator.send_stop("estop", reason="test").replies[ROBOT]
            assert reply.text.startswith("commanded zero; someone else drives: ")
            assert re.search(r"measured 0\.10 m/s, 0\.30 rad/s, \d\.\d s ago: not", reply.text), (
                reply
            )
            assert reply.refusal is Refusal.NOT_STOPPED  # the robot moves on
            since = boottime()
            wait_until(lambda: course.commands[-1][0] > since + 2.0, "two seconds of commands")
            speeds = [twist.linear for t, twist in course.commands if t > since]
            zeros = speeds.count(0.0)
            assert {*speeds} == {0.0, RIVAL_SPEED}
            assert zeros > 0.9 * speeds.count(RIVAL_SPEED)
        wait_until(lambda: not shows(operator, "someone else drives"), "it is over")
        course.gets_only_zeros(boottime(), 1.0)


class Thymio(BridgedRobot):
    """Publishes as thymio_driver does, within its namespace: +inf is no return."""

    platform = load_platform("thymio")

    def __init__(self) -> None:
        self.ranges: dict[str, float] = {}
        super().__init__()

    def command_key(self) -> str:
        return f"{NAMESPACE}/cmd_vel"

    def publish_count(self, count: int) -> None:
        stamp = boottime()
        self.put(f"{NAMESPACE}/odom", odometry(stamp, x=0.1 * stamp))
        for name in (*FRONT, "rear_left", "rear_right") if count % 2 == 0 else ():
            message = dds.Range(header=dds.stamped(stamp), range=self.ranges.get(name, math.inf))
            self.put(f"{NAMESPACE}/proximity/{name}", message)


def test_a_thymio_drives_with_its_platform_file_and_avoids_a_hand(tmp_path: Path) -> None:
    robot = Thymio()
    options: dict[str, Value] = {"endpoint": robot.endpoint, "cmd_vel_type": "twist"}
    setup = Setup("ros2dds", robot, options, robot.publish_count, platform="thymio")
    with driven(setup, tmp_path) as (course, _, operator):
        wait_until(lambda: course.commands[-1][1].linear > 0.0, "it drives ahead")
        robot.ranges = dict.fromkeys(FRONT, 0.03)  # a hand
        wait_until(lambda: course.commands[-1][1].linear < 0.0, "it backs away")
        gap = heard_statuses(operator, [ROBOT])[ROBOT].decision.min_gap
        assert gap is not None
        assert 0.005 < gap < 0.035  # the hand is rounder than the outline

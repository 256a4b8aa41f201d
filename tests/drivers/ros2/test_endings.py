"""Every way to end a robot of robot.launch.xml whose base has no command timeout: the base stands.

The bridge is real. `ros2 launch` has its processes in one process group, so that a signal reaches
the bridge and the daemon at once: here each gets the signal, the bridge first.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from swarmd.core.values import Twist
from swarmd.testing.driver_contract import is_running
from tests.drivers.ros2.dds_rig import DdsRobot
from tests.support.launch_files import PACKAGE, executables
from tests.support.processes import (
    CAP,
    children,
    end_process,
    unique_swarm,
    wait_until,
    watchdogs,
)
from tests.support.ros2_bridge import why_no_bridge
from tests.support.swarmctl import Running, swarmctl

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]

ROBOT = "tb3-01"


class Base(DdsRobot):
    """A base whose bridge the launch file starts."""

    def reconnect(self) -> None:
        self.bridge.configure()


class LaunchedRobot:
    """A Burger without a command timeout, and what robot.launch.xml starts for it."""

    def __init__(self, folder: Path) -> None:
        self._left = contextlib.ExitStack()
        self.base = Base()
        self._left.callback(self.base.close)
        self.swarm = unique_swarm()
        self.commands: list[Twist] = []
        self._is_over = threading.Event()
        self._feeding = threading.Thread(target=self._feed)
        self.bridge, self.daemon = self._launch(folder)

    def __enter__(self) -> LaunchedRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._feeding.join()
        self._left.close()
        for pid in watchdogs(self.swarm, ROBOT):
            end_process(pid)

    def drive(self) -> None:
        """Return once the base moves."""
        self._feeding.start()
        wait_until(lambda: bool(self.commands), "the base is commanded")
        wait_until(self._drives, "it moves")

    def _drives(self) -> bool:
        swarmctl("--swarm", self.swarm, "run", "drive", ROBOT, "-p", "speed=0.1")
        with contextlib.suppress(AssertionError):  # the run ended, since the base was not found yet
            wait_until(self.moves, "it moves", cap=3.0)
        return self.moves()

    def _launch(self, folder: Path) -> list[Running]:
        config, program = folder / "robot.yaml", folder / "zenoh-bridge-ros2dds"
        options = {"endpoint": self.base.endpoint}
        settings = {"platform": "burger", "driver": "ros2dds", "driver_options": options}
        config.write_text(yaml.safe_dump({**settings, "state_dir": str(folder / "state")}))
        program.write_text(f"#!/bin/sh\nexec {' '.join(self.base.bridge.command)}\n")
        program.chmod(0o755)
        environ = {**self.base.bridge.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
        given = {"robot": ROBOT, "swarm": self.swarm, "config": str(config)}
        started: list[Running] = []
        for one in executables(PACKAGE / "launch/robot.launch.xml", given):
            name, *words = one.words
            running = Running(*words, environ={**environ, **one.environ}, program=name)
            started.append(self._left.enter_context(running))
        return started

    def _feed(self) -> None:
        """Publish sensors and take commands; each command lasts until the next."""
        while not self._is_over.wait(0.1):
            self.base.publish()
            self.commands += self.base.commands()

    def moves(self) -> bool:
        """Whether the last command moves the base."""
        return bool(self.commands) and not self.commands[-1].is_zero

    def pids(self) -> set[int]:
        """All processes of the robot, as a control group has them."""
        found, new = set[int](), {self.bridge.pid, self.daemon.pid, *watchdogs(self.swarm, ROBOT)}
        while new:
            found |= new
            new = {child for pid in new for child in children(pid)} - found
        return found


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[LaunchedRobot]:
    with LaunchedRobot(tmp_path) as made:
        made.drive()
        yield made


def send_all(robot: LaunchedRobot, number: signal.Signals) -> None:
    robot.bridge.send_signal(number)
    robot.daemon.send_signal(number)


def interrupt(robot: LaunchedRobot) -> None:
    """Ctrl-C in the terminal of `ros2 launch`: to the process group."""
    send_all(robot, signal.SIGINT)


def hang_up(robot: LaunchedRobot) -> None:
    """The terminal is closed, or ssh ends: to the process group."""
    send_all(robot, signal.SIGHUP)


def end_group(robot: LaunchedRobot) -> None:
    """The end of a service or of a user's session: to all its processes, the bridge first."""
    pids = robot.pids() - {robot.daemon.pid}
    for pid in (*pids, robot.daemon.pid):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)


def kill_daemon(robot: LaunchedRobot) -> None:
    """The daemon is killed, such as for lack of memory; then the launch ends."""
    robot.daemon.kill()
    robot.daemon.wait(CAP)
    interrupt(robot)


def kill_launch(robot: LaunchedRobot) -> None:
    """`ros2 launch` kills what has not ended in time, the bridge first."""
    send_all(robot, signal.SIGKILL)


ENDINGS: list[Callable[[LaunchedRobot], None]] = [interrupt]
MORE_ENDINGS = [hang_up, end_group, kill_daemon, kill_launch]


@pytest.mark.parametrize(
    "end",
    [*ENDINGS, *(pytest.param(one, marks=pytest.mark.evidence) for one in MORE_ENDINGS)],
    ids=lambda end: end.__name__,
)
def test_a_base_without_a_command_timeout_stands(
    robot: LaunchedRobot, end: Callable[[LaunchedRobot], None]
) -> None:
    pids = robot.pids() - set(watchdogs(robot.swarm, ROBOT))  # that of a killed daemon stays
    end(robot)
    wait_until(lambda: not any(map(is_running, pids)), "all processes have ended")
    wait_until(lambda: not robot.moves(), "the base stands", cap=2.0)

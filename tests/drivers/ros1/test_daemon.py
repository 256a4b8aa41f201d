"""A whole daemon with driver `ros1`: it drives a robot in rospy, is frozen, thawed and killed."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import pytest

from swarmd.core.values import Twist, Value
from swarmd.network.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.testing.driver_contract import is_running
from tests.drivers.ros1.rig import RosRobot
from tests.support.drive_daemon import ROBOT, drive
from tests.support.processes import DaemonProcess, children, unique_swarm, wait_until
from tests.support.roscore import RosCore

pytestmark = pytest.mark.integration

SLACK = 2.0  # s beyond the 0.4 and a beat, for a starved machine


def adapters(daemon: DaemonProcess) -> list[int]:
    def is_one(pid: int) -> bool:
        return b"adapter_process" in Path(f"/proc/{pid}/cmdline").read_bytes()

    return [pid for pid in children(daemon.process.pid) if is_one(pid)]


def until(body: RosRobot, *, moving: bool) -> float:
    """Seconds until it is told to move, or to stand."""
    begin = time.monotonic()
    wait_until(
        lambda: any(twist.is_zero != moving for twist in body.commands()[-1:]),
        "it is told to move" if moving else "it is told to stand",
    )
    return time.monotonic() - begin


def all_for(body: RosRobot, seconds: float) -> list[Twist]:
    body.commands()
    time.sleep(seconds)
    return list(body.commands())


def test_a_daemon_drives_and_its_end_stops_the_robot(roscore: RosCore, tmp_path: Path) -> None:
    swarm = unique_swarm()
    with closing(RosRobot(roscore)) as body:
        options: dict[str, Value] = {
            "platform": "burger",
            "driver": "ros1",
            "driver_options": dict(body.options),
        }
        with (
            DaemonProcess(
                tmp_path, swarm=swarm, robot=ROBOT, endpoint="", options=options
            ) as daemon,
            Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
        ):
            daemon.wait_ready()
            body.do("rate", hz=10)
            drive(operator)
            until(body, moving=True)
            (adapter,) = adapters(daemon)
            daemon.freeze()
            assert until(body, moving=False) < 0.5 + SLACK
            told = all_for(body, 2.0)
            assert len(told) > 10
            assert all(twist.is_zero for twist in told)
            daemon.thaw()
            drive(operator)
            until(body, moving=True)
            daemon.kill()
            assert until(body, moving=False) < 0.5 + SLACK
            assert all(twist.is_zero for twist in all_for(body, 1.0))
            wait_until(lambda: not is_running(adapter), "the adapter has left")

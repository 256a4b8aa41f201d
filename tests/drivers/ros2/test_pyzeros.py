"""Driver `rmw_zenoh` with a base of another library, PyZeROS, which needs no ROS.

Its codec cydr compiles C at the first message, so the cache of the compiled code is kept.
"""

from __future__ import annotations

import asyncio
import importlib.util
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import zenoh

from swarmd.core.messages import Code, Reply
from swarmd.core.values import Twist
from swarmd.driver_api.command_source import Answer, DriverCommand, command_source
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.harness import drive
from tests.drivers.ros2.robots import ZenohRobot, open_session
from tests.support.stories import story

_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
os.environ.setdefault(
    "CYDR_CACHE_DIR", str(_CACHE / "swarmd" / "cydr")
)  # else it is `./.cydr_cache`
HAS_PYZEROS = importlib.util.find_spec("pyzeros") is not None
pytestmark = [
    pytest.mark.integration,
    pytest.mark.timeout(600),  # compiling takes minutes at worst
    pytest.mark.skipif(not HAS_PYZEROS, reason="no pyzeros here"),
]
pyzeros: Any
MESSAGES: Any
SERVICES: Any
if HAS_PYZEROS:
    pyzeros = importlib.import_module("pyzeros")
    MESSAGES = importlib.import_module("ros2_pyterfaces.cyclone.all_msgs")
    SERVICES = importlib.import_module("ros2_pyterfaces.cyclone.all_srvs")

RAYS = 360
DOMAIN = 5
OPTIONS: dict[str, Any] = {
    "services": {"operator": "ros", "runs": {"go": {"pattern": "drive"}}},
}


class PyzerosRobot(ZenohRobot):
    """A hub, and at it a node of PyZeROS with scan, odometry and commands."""

    def __init__(self) -> None:
        super().__init__(domain=DOMAIN)
        self._session: zenoh.Session | None = None
        self.node: Any = None
        self._twists: list[Twist] = []

    def start(self) -> None:
        """Begin the node, on the running loop."""
        self._session = open_session("peer", "connect/endpoints", self.endpoint)
        self.node = pyzeros.Session(node="base", zenoh_session=self._session, domain_id=DOMAIN)
        self._scan = pyzeros.Pub(MESSAGES.LaserScan, "scan", session=self.node)
        self._odometry = pyzeros.Pub(MESSAGES.Odometry, "odom", session=self.node)
        self._sub = pyzeros.sub.RawSub(
            MESSAGES.Twist, "cmd_vel", self._on_command, session=self.node
        )

    def _on_command(self, sample: zenoh.Sample) -> None:
        twist = MESSAGES.Twist.deserialize(sample.payload.to_bytes())
        self._twists.append(Twist(twist.linear.x, twist.angular.z, twist.linear.y))

    def options(self, given: Any) -> Any:
        return {**super().options({}), "cmd_vel_type": "auto", **given}

    def publish(self) -> None:
        if self.node is None:
            self.start()
        stamp = self._stamp()
        header = MESSAGES.Header(
            stamp=MESSAGES.Time(sec=int(stamp), nanosec=round(1e9 * math.modf(stamp)[0])),
            frame_id="base_scan",
        )
        self._scan.publish(
            MESSAGES.LaserScan(
                header=header,
                angle_min=0.0,
                angle_max=2.0 * math.pi,
                angle_increment=2.0 * math.pi / RAYS,
                range_min=0.12,
                range_max=3.5,
                ranges=[2.0 + 0.009 * math.modf(6.18034 * stamp)[0]] * RAYS,
            )
        )
        self._odometry.publish(MESSAGES.Odometry(header=header, child_frame_id="base_link"))

    def commands(self) -> Sequence[Twist]:
        taken = self._twists[:]
        del self._twists[: len(taken)]
        return taken

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
        super().close()


@story(PyzerosRobot)
async def test_scans_come_and_commands_arrive(harness: DriverHarness, robot: PyzerosRobot) -> None:
    assert len(harness.sink.scans[-1].ranges) == RAYS
    assert 2.0 <= harness.sink.scans[-1].ranges[0] < 2.01
    assert harness.sink.odometries
    await drive(harness)


@story(PyzerosRobot, **OPTIONS)
async def test_a_client_calls_a_service(harness: DriverHarness, robot: PyzerosRobot) -> None:
    commands = list[DriverCommand]()
    source = command_source(harness.driver)
    assert source is not None

    def take(command: DriverCommand, answer: Answer) -> None:
        commands.append(command)
        answer(Reply(id="i", robot="r", code=Code.APPLIED, text="done"))

    source.serve(take)
    client = pyzeros.Client(SERVICES.Trigger, "swarmd/reset", session=robot.node)
    await client.wait_for_service()
    call = asyncio.create_task(client.call_async(SERVICES.Trigger.Request()))
    await harness.until(call.done, publishing=True)
    answer = call.result()
    assert (answer.success, answer.message, commands[0].verb) == (True, "done", "reset")

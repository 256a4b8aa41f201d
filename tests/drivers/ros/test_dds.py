"""A DDS participant with ROS 2's topic and type names stands in for the robot.

It is cyclonedds' own, which also writes and reads every byte of the messages. Between it and the
driver: a gateway of a few lines that does what the bridge does with these two topics, and the real
zenoh-bridge-ros2dds where there is one.
"""

from __future__ import annotations

import asyncio
import math
import os
import shutil
import subprocess
import threading
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

import pytest
import zenoh
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from swarmd.drivers import ros2dds
from swarmd.drivers.ros import cdr, conversion, messages
from swarmd.drivers.ros.driver import RosDriver
from swarmd.testing.driver_contract import Stage, on_stage
from swarmd.values import Twist, Value
from tests.drivers.ros import dds_types, robots

DOMAIN = 100 + os.getpid() % 100
BRIDGE = shutil.which("zenoh-bridge-ros2dds")
LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers>"
    '<Peer address="127.0.0.1"/></Peers><ParticipantIndex>auto</ParticipantIndex></Discovery>'
    "</Domain></CycloneDDS>"
)
SENSOR = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
COMMAND = Qos(Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(10))


class DdsRobot:
    """Says scans on rt/scan and hears commands on rt/cmd_vel."""

    platform = robots.PLATFORM

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.participant = DomainParticipant(DOMAIN)
        scans = Topic(self.participant, "rt/scan", dds_types.LaserScan, SENSOR)
        commands = Topic(self.participant, "rt/cmd_vel", dds_types.Twist, COMMAND)
        self.writer = DataWriter(self.participant, scans)
        self.reader = DataReader(self.participant, commands)
        self._spoken = 0

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        return ros2dds.make_driver(
            swarm="s",
            robot="r",
            platform=self.platform,
            options={"endpoint": self.endpoint, **options},
        )

    def close(self) -> None:
        del self.writer, self.reader, self.participant

    def speak(self) -> None:
        self._spoken += 1
        stamp = dds_types.Time(self._spoken, 0)
        step = 2.0 * math.pi / 360
        self.writer.write(
            dds_types.LaserScan(
                header=dds_types.Header(stamp, "base_scan"),
                angle_increment=step,
                ranges=[1.0 + 0.001 * i for i in range(360)],
            )
        )

    def commands(self) -> list[Twist]:
        taken = [said for said in self.reader.take(50) if isinstance(said, dds_types.Twist)]
        return [Twist(said.linear.x, said.angular.z) for said in taken]


class Gateway:
    """What a bridge does with these two topics, as raw CDR, from a participant of its own."""

    def __init__(self, endpoint: str) -> None:
        self._hub = robots.open_session("router", "listen/endpoints", endpoint)
        self._participant = participant = DomainParticipant(DOMAIN)
        scans = Topic(participant, "rt/scan", dds_types.LaserScan, SENSOR)
        commands = Topic(participant, "rt/cmd_vel", dds_types.Twist, COMMAND)
        self._reader = DataReader(participant, scans)
        self._writer = DataWriter(participant, commands)
        self._hub.declare_subscriber("cmd_vel", self._to_dds)
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._from_dds)
        self._thread.start()

    def close(self) -> None:
        self._is_ending.set()
        self._thread.join()
        self._hub.close()
        del self._reader, self._writer, self._participant

    def _to_dds(self, sample: zenoh.Sample) -> None:
        self._writer.write(dds_types.Twist.deserialize(sample.payload.to_bytes()))

    def _from_dds(self) -> None:
        while not self._is_ending.wait(0.005):
            for message in self._reader.take(10):
                if isinstance(message, dds_types.LaserScan):  # else a writer's end
                    self._hub.put("scan", message.serialize())


@contextmanager
def gateway(endpoint: str) -> Iterator[None]:
    running = Gateway(endpoint)
    try:
        yield
    finally:
        running.close()


@contextmanager
def bridge(endpoint: str) -> Iterator[None]:
    assert BRIDGE is not None
    command = [BRIDGE, "-d", str(DOMAIN), "-l", endpoint, "--no-multicast-scouting"]
    environ = {**os.environ, "CYCLONEDDS_URI": LOOPBACK, "ROS_DISTRO": "jazzy"}
    with subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL) as running:
        try:
            yield
        finally:
            running.terminate()


def play(robot: DdsRobot, story: Callable[[Stage], Awaitable[None]]) -> None:
    async def run() -> None:
        async with on_stage(robot) as stage:
            await stage.connect()
            await story(stage)

    asyncio.run(run())


@pytest.mark.integration
@pytest.mark.parametrize(
    "between",
    [
        gateway,
        pytest.param(
            bridge,
            marks=pytest.mark.skipif(
                BRIDGE is None,
                reason="no zenoh-bridge-ros2dds on PATH: the leg through the real bridge is not"
                " tested here",
            ),
        ),
    ],
)
def test_scans_come_in_and_commands_go_out_over_dds(
    between: Callable[[str], AbstractContextManager[None]],
) -> None:
    endpoint = robots.free_endpoint()
    domain = Domain(DOMAIN, LOOPBACK)  # ends, with all that is in it, when it is deleted
    robot = DdsRobot(endpoint)

    async def story(stage: Stage) -> None:
        await stage.until(lambda: len(stage.heard.scans) >= 3, speaking=True)
        scan = stage.heard.scans[-1]
        assert scan.ranges[100] == pytest.approx(1.1)
        taken: list[Twist] = []

        def moves() -> bool:
            stage.driver.send(Twist(0.1, -0.2), 1, 1)
            taken.extend(robot.commands())
            return bool(taken) and not taken[-1].is_zero

        await stage.until(moves, speaking=True)
        assert taken[0].is_zero
        assert taken[-1] == Twist(0.1, -0.2)
        await stage.end()

        def stands() -> bool:
            taken.extend(robot.commands())
            return taken[-1].is_zero

        await stage.until(stands)

    with between(endpoint):
        play(robot, story)
    del domain


def test_bytes_are_those_of_cyclonedds_too() -> None:
    scan = dds_types.LaserScan(
        header=dds_types.Header(dds_types.Time(7, 5), "base_scan"),
        angle_min=-1.5,
        angle_increment=0.25,
        ranges=[0.0, math.inf, 1.5],
        intensities=[1.0, 2.0, 3.0],
    )
    written = scan.serialize()
    read = cdr.decode(messages.LaserScan, written)
    assert read.ranges.tolist() == scan.ranges
    assert cdr.encode(read) == written
    twist = dds_types.Twist(dds_types.Vector3(0.1, 0.0, 0.0), dds_types.Vector3(0.0, 0.0, -0.2))
    assert cdr.encode(conversion.twist_message(Twist(0.1, -0.2))) == twist.serialize()

"""The rmw_zenoh driver against a stand-in for a robot's nodes and router, over real Zenoh."""

from __future__ import annotations

import asyncio
import struct

import pytest
import zenoh

from swarmd.core.values import Twist
from swarmd.drivers.ros.messages import dds_name
from swarmd.drivers.ros2 import rmw_zenoh
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros.contract import RosContract
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import check, drive, reported
from tests.drivers.ros2.robots import ZenohRobot
from tests.support.stories import story

pytestmark = pytest.mark.long

LASER = "sensor_msgs/msg/LaserScan"


class TestContract(RosContract):
    def rig(self) -> ZenohRobot:
        return ZenohRobot()


@story(lambda: ZenohRobot(domain=7, is_humble=True, is_stamped=True))
async def test_a_robot_of_humble_that_wants_stamped_commands_is_driven(
    harness: DriverHarness, robot: ZenohRobot
) -> None:
    await drive(harness)
    assert harness.sink.scans


def tokens(robot: ZenohRobot) -> list[str]:
    replies = robot.hub.liveliness().get("@ros2_lv/**")
    return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)


@story(lambda: ZenohRobot(domain=5))
async def test_a_command_carries_sequence_time_and_the_gid_of_our_token(
    harness: DriverHarness, robot: ZenohRobot
) -> None:
    taken: list[zenoh.Sample] = []

    def has_two() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend(robot.samples())
        return len(taken) >= 2

    await harness.until(has_two, publishing=True)
    read = [struct.unpack("<qqB16s", s.attachment.to_bytes()) for s in taken if s.attachment]
    assert [r[0] for r in read] == list(range(read[0][0], read[0][0] + len(taken)))
    announced = [token for token in tokens(robot) if "/%cmd_vel/" in token]
    assert len(announced) == 1
    assert {r[3] for r in read} == {rmw_zenoh.gid_of(announced[0])}
    assert {r[2] for r in read} == {16}


@pytest.mark.parametrize("is_humble", [False, True])
@story(lambda is_humble: ZenohRobot(is_humble=is_humble))
async def test_it_is_a_node_of_the_graph_while_it_runs(
    harness: DriverHarness, robot: ZenohRobot, is_humble: bool
) -> None:
    def own() -> list[str]:
        return [token for token in tokens(robot) if "/%/swarmd_services" not in token]

    await harness.until(lambda: len(own()) == 4, publishing=True)
    node, *ends = own()
    assert node.endswith("/0/0/NN/%/%/swarmd")
    parts = [token.split("/") for token in ends]
    assert [part[5] for part in parts] == ["MS", "MS", "MP"]
    assert [part[9] for part in parts] == ["%scan", "%odom", "%cmd_vel"]
    hashes = [part[11] for part in parts]
    assert (hashes == ["TypeHashNotSupported"] * 3) == is_humble
    await harness.end()
    await harness.until(lambda: not tokens(robot))


def test_a_malformed_token_is_ignored() -> None:
    robot = ZenohRobot()

    async def story(harness: DriverHarness) -> None:
        crashes: list[object] = []
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: crashes.append(context))
        await harness.connect()
        count = len(harness.sink.scans)
        await harness.until(lambda: len(harness.sink.scans) > count + 2, publishing=True)
        assert not crashes

    declare = robot.hub.liveliness().declare_token
    held = [
        declare(f"@ros2_lv/{domain}/aa/0/1/MP/%/%/node/%scan/T/H/q")
        for domain in ("9" * 5000, "x", "-1")
    ]
    play(robot, story, connected=False)
    assert held, "the tokens exist as long as the driver runs"


def test_a_check_announces_no_node() -> None:
    robot = ZenohRobot()
    seen: list[str] = []

    def publish() -> None:
        robot.publish()
        seen.extend(tokens(robot))

    found = check(robot, publish, tries=3)
    assert all(finding.is_well for finding in found.values())
    assert not seen


def test_nodes_that_are_peers_of_the_router_are_received_and_commanded() -> None:
    robot = ZenohRobot()
    node = robots.open_session("peer", "connect/endpoints", robot.endpoint)
    taken: list[zenoh.Sample] = []
    node.declare_subscriber(robot.command_key(), taken.append)

    def twists() -> list[Twist]:
        return [robots.twist(sample.payload.to_bytes(), is_stamped=False) for sample in taken]

    async def story(harness: DriverHarness) -> None:
        stamps = iter(range(1, 10_000))

        def is_up() -> bool:
            node.put(robot.key("scan", "LaserScan"), robots.scan(float(next(stamps))).serialize())
            return harness.sink.is_up

        await harness.until(is_up)

        def is_commanded() -> bool:
            is_up()
            harness.driver.send(Twist(0.1), 1, 1)
            return Twist(0.1) in twists()

        await harness.until(is_commanded)

    try:
        play(robot, story, connected=False)
    finally:
        node.close()
    assert twists()[0].is_zero


@pytest.mark.parametrize(
    ("key", "wanted"),
    [
        (f"0/scan/{dds_name(LASER)}/RIHS01_{'0' * 64}", "type hash"),
        (f"0/scan/{dds_name('sensor_msgs/msg/PointCloud2')}/RIHS01_{'0' * 64}", "carries sensor_"),
    ],
)
@story(ZenohRobot, connected=False)
async def test_another_type_or_hash_is_dropped_and_reported(
    harness: DriverHarness, robot: ZenohRobot, key: str, wanted: str
) -> None:
    def is_reported() -> bool:
        robot.put_on(key, robots.scan(1.0).serialize())
        return reported(harness, wanted)

    await harness.until(is_reported)
    assert not harness.sink.is_up
    assert not harness.sink.scans
    assert set(harness.sink.lost) <= {"scan:type", "scan:type:overtaken"}


def test_check_finds_the_topic_in_another_domain() -> None:
    robot = ZenohRobot()
    robot.announce("MP", "rosout", "rcl_interfaces/msg/Log")
    robot.announce("MP", "bot1/scan", LASER)
    robot.announce("MP", "scan", LASER, 30)
    found = check(robot, robot.publish_odometry, seconds=2.0)
    assert "no /scan in domain 0, but in 30; correct driver_options.domain" in found["scan"].text

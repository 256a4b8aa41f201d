"""Emulated ROS 2 robots: their messages through a second codec, and each driver with them."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from msgspec import structs

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.core.events import DetectionsInput, OdometryInput, RangesInput, ReadingsInput, ScanInput
from swarmd.core.values import Detection, Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.driver_api.driver import Driver
from swarmd.driver_api.emulator import Emulator
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.to_ros import LaserScanEncoder, odometry_message
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.key_scheme import TopicEnd
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh, gid_of
from swarmd.drivers.ros2.session import open_session
from swarmd.link.carriers.session import has_subscriber
from swarmd.plugins import load_driver, load_emulator
from swarmd.settings.driver_options import BaseOptions, stops_after
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink
from tests.drivers.ros2.robots import HASHES
from tests.support import ros2_types as dds
from tests.support.processes import wait_until
from tests.support.range_ring import RING_DEG, ring_spec, with_ring
from tests.support.vendor_messages import detections_folder

ANY_PORT = "tcp/127.0.0.1:0"
BURGER = load_platform("burger")
ENDS = (
    TopicEnd("/a/scan", messages.LaserScan, is_publisher=True, is_reliable=False, depth=5),
    TopicEnd("/a/odom", messages.Odometry, is_publisher=True, is_reliable=True, depth=10),
    TopicEnd("/a/cmd_vel", messages.Twist, is_publisher=False, is_reliable=True, depth=10),
)


def varied_scan(platform: Platform, seq: int = 1) -> Scan:
    """Ranges that differ between rays, and each value that is no distance."""
    spec = platform.scan
    nearest = max(spec.range_min, 0.09) + 0.01  # beyond the rim on which a Thymio's sensors sit
    ranges = np.linspace(nearest, spec.range_max - 0.01, len(spec.bearings))
    ranges[1:5] = 0.0, math.inf, -math.inf, math.nan
    return Scan(seq, seq / spec.rate, ranges, spec.bearings, spec.range_min, spec.range_max)


TAGS: dict[str, Value] = {
    "topic": "detections",
    "type": "apriltag_msgs/AprilTagDetectionArray",
    "at": [-0.06, 0.02],
    "bearing_deg": 10.0,
    "image_width": 1280,
    "field_of_view_deg": 63.0,
    "size": 0.1,
    "kinds": {"tag36h11": "robot", "7": "box"},
}


def odometry(seq: int = 1) -> Odometry:
    return Odometry(0.1 * seq, Pose(1.0, -2.0, 2.5), Twist(0.1, -0.2))


class Stage:
    """Two emulated robots of a platform, and the commands that reached them."""

    def __init__(self, scheme: str, platform: Platform) -> None:
        self.scheme, self.platform = scheme, platform
        self.commands: list[tuple[str, Twist]] = []
        self.side: Emulator = load_emulator(scheme)(
            robots=dict.fromkeys(("r-1", "r-2"), platform),
            endpoint=ANY_PORT,
            on_command=lambda robot, twist: self.commands.append((robot, twist)),
        )

    def driver(self, robot: str) -> Driver:
        given = {**self.platform.drivers[self.scheme], **self.side.driver_options}
        options = {k: v for k, v in given.items() if k not in BaseOptions.__struct_fields__}
        factory = load_driver(self.scheme)
        return factory(swarm="s", robot=robot, platform=self.platform, options=options)


@pytest.fixture(
    params=[
        ("ros2dds", "burger"),
        ("ros2dds", "thymio"),
        ("rmw_zenoh", "waffle_pi"),
        ("rmw_zenoh", "jackal"),
    ],
    ids=" ".join,
)
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    scheme, platform = request.param
    one = Stage(scheme, load_platform(platform))
    yield one
    one.side.close()


def test_a_laser_scan_is_as_an_lds_sends_it() -> None:
    original = varied_scan(BURGER)
    (message,) = LaserScanEncoder(RosOptions(), BURGER).encode(original)
    received = dds.LaserScan.deserialize(cdr.encode(message))
    assert received.angle_min == 0.0
    assert received.angle_increment == pytest.approx(math.radians(1.0), abs=1e-8)
    assert received.angle_max == pytest.approx(math.radians(359.0), abs=1e-6)
    assert (received.range_min, received.range_max) == pytest.approx((0.12, 3.5))
    assert received.scan_time == pytest.approx(0.2)
    assert np.array_equal(np.array(received.ranges), original.ranges.astype("<f4"), equal_nan=True)
    assert (received.header.stamp.sec, received.header.stamp.nanosec) == (0, 200_000_000)
    assert received.header.frame_id == "base_scan"


@pytest.mark.parametrize("hangs", [False, True])
def test_a_scan_is_the_same_for_each_mounting_of_the_lidar(hangs: bool) -> None:
    options, original = RosOptions(scan_yaw_deg=70.0, scan_upside_down=hangs), varied_scan(BURGER)
    (message,) = LaserScanEncoder(options, BURGER).encode(original)
    sink = CollectingSink()
    Subscriptions(options, BURGER).read("scan", cdr.encode(message), 0.0)(sink)
    off = np.abs(np.exp(1j * sink.scans[0].bearings) - np.exp(1j * original.bearings))
    assert off.max() < 1e-5


def test_odometry_is_that_of_nav_msgs() -> None:
    received = dds.Odometry.deserialize(cdr.encode(odometry_message(odometry())))
    at, moving = received.pose.pose, received.twist.twist
    assert (at.position.x, at.position.y) == (1.0, -2.0)
    assert 2.0 * math.atan2(at.orientation.z, at.orientation.w) == pytest.approx(2.5)
    assert (moving.linear.x, moving.angular.z) == (0.1, -0.2)
    assert received.header.frame_id == "odom"


def test_a_bridges_tokens_are_those_that_the_driver_knows() -> None:
    tokens = Ros2Dds().tokens("ab12", ENDS)
    assert tokens[0] == "@/ab12/@ros2_lv/MP/a§scan/sensor_msgs§msg§LaserScan/:0::0,5"
    found = [Ros2Dds().parse_token(token) for token in tokens]
    assert [(e.topic, e.is_publisher) for e in found if e] == [
        ("/a/scan", True),
        ("/a/odom", True),
        ("/a/cmd_vel", False),
    ]


def test_a_nodes_tokens_are_those_that_the_driver_knows() -> None:
    node, *tokens = RmwZenoh(30, "/a/cmd_vel", "/a", "base", 2).tokens("ab12", ENDS)
    assert node == "@ros2_lv/30/ab12/2/200/NN/%/%a/base"
    kind = f"sensor_msgs::msg::dds_::LaserScan_/{HASHES['LaserScan']}"
    assert tokens[0] == f"@ros2_lv/30/ab12/2/201/MP/%/%a/base/%a%scan/{kind}/2::,5:,:,:,,"
    found = [RmwZenoh(30, "/a/cmd_vel").parse_token(token) for token in tokens]
    assert [(e.topic, e.is_publisher, e.domain) for e in found if e] == [
        ("/a/scan", True, 30),
        ("/a/odom", True, 30),
        ("/a/cmd_vel", False, 30),
    ]


def test_each_publisher_of_a_node_has_its_own_sequence() -> None:
    node = RmwZenoh(0, "/a/cmd_vel", "/a", "base")
    _, scans, poses, _ = node.tokens("ab12", ENDS)
    payloads = [node.attachment(token) for token in (scans, poses, scans)]
    read = [struct.unpack("<qqB16s", payload or b"") for payload in payloads]
    assert [sequence for sequence, *_ in read] == [1, 1, 2]
    assert [gid for *_, gid in read] == [gid_of(scans), gid_of(poses), gid_of(scans)]


def test_a_driver_receives_its_robots_data_and_commands_no_other_robot(stage: Stage) -> None:
    async def story() -> None:
        driver, sink = stage.driver("r-2"), CollectingSink()
        task = asyncio.create_task(driver.run(sink))
        seq = 0
        try:
            async with asyncio.timeout(60.0):
                while (
                    len([t for _, t in stage.commands if not t.is_zero]) < 3 or len(sink.scans) < 3
                ):
                    seq += 1
                    stage.side.publish("r-2", ScanInput(varied_scan(stage.platform, seq)))
                    stage.side.publish("r-2", OdometryInput(odometry(seq)))
                    driver.send(Twist(0.1, 0.3), seq, seq)
                    await asyncio.sleep(0.05)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        original, got = varied_scan(stage.platform), sink.scans[-1]
        assert np.allclose(got.ranges, original.ranges, atol=1e-5, equal_nan=True)
        apart = np.angle(np.exp(1j * (got.bearings - original.bearings)))
        assert np.abs(apart).max() < 1e-5

    asyncio.run(story())
    assert {robot for robot, _ in stage.commands} == {"r-2"}
    assert stage.commands[0][1].is_zero
    assert (Twist(0.1, 0.3)) in [twist for _, twist in stage.commands]


@pytest.mark.parametrize("size", [100_000, 300_000])
def test_a_stop_of_another_node_passes_the_hub_whatever_its_size(size: int) -> None:
    """Such a message comes in fragments, for all of which the hub has room at once."""
    hub = Stage("ros2dds", BURGER)
    endpoint = str(hub.side.driver_options["endpoint"])
    config = zenoh.Config()
    for path, value in (
        ("mode", '"client"'),
        ("connect/endpoints", f'["{endpoint}"]'),
        ("scouting/multicast/enabled", "false"),
        ("transport/link/tx/queue/size/data", "16"),
    ):
        config.insert_json5(path, value)
    sizes: list[int] = []
    driver = open_session(endpoint)
    assert driver is not None
    with driver, zenoh.open(config) as node:
        driver.declare_subscriber("r-1/swarmd/estop", lambda one: sizes.append(len(one.payload)))
        publisher = node.declare_publisher("r-1/swarmd/estop")
        wait_until(lambda: has_subscriber(publisher), "the hub knows the driver")
        for _ in range(8):  # a node repeats a stop
            publisher.put(bytes(size))
            with suppress(AssertionError):
                wait_until(lambda: bool(sizes), "it arrives", cap=3.0)
            if sizes:
                break
    hub.side.close()
    assert set(sizes) == {size}


def test_a_command_that_no_base_could_follow_is_counted_and_dropped() -> None:
    stage = Stage("ros2dds", BURGER)
    mad = (dds.Twist(linear=dds.Vector3(x=math.nan)), dds.Twist(dds.Vector3(x=1e9)))
    session = open_session(str(stage.side.driver_options["endpoint"]), within=10.0)
    assert session is not None
    try:
        payloads = [b"", b"\xff" * 20, *(message.serialize() for message in mad)]

        def counted() -> bool:
            for payload in payloads:
                session.put("r_1/cmd_vel", payload)
            return stage.side.dropped >= 2 * len(payloads)

        wait_until(counted, "all of it is counted")
    finally:
        session.close()
        stage.side.close()
    assert stage.commands == []


def given(platform: Platform, **options: Any) -> Platform:
    return replace(platform, drivers={"ros2dds": options})


@pytest.mark.parametrize(
    ("platform", "complaint"),
    [
        (given(load_platform("thymio")), "not evenly spread"),
        (given(load_platform("thymio"), ranges={"left": 90.0}), "ranges.left"),
        (given(BURGER, scan="/scan"), "r-1 and r-2 have one topic /scan"),
        (given(BURGER, cmd_vel="/cmd_vel"), "r-1 and r-2 have one topic /cmd_vel"),
        (given(BURGER, scam="scan"), "did you mean 'scan'"),
    ],
)
def test_a_platform_that_cannot_be_emulated_is_one_clear_error(
    platform: Platform, complaint: str
) -> None:
    with pytest.raises(ConfigError, match=complaint):
        Stage("ros2dds", platform)


def test_an_endpoint_in_use_is_one_clear_error() -> None:
    stage = Stage("ros2dds", BURGER)
    try:
        with pytest.raises(NetworkError, match="no session for the robots' ros2dds"):
            load_emulator("ros2dds")(
                robots={"r": BURGER},
                endpoint=str(stage.side.driver_options["endpoint"]),
                on_command=lambda robot, twist: None,
            )
    finally:
        stage.side.close()


@pytest.mark.parametrize(
    ("command_timeout", "seconds"),
    [("none", math.inf), (None, math.inf), ("base", 0.5), (0.25, 0.25)],
)
def test_a_base_stops_by_itself_as_its_platform_declares(
    command_timeout: Any, seconds: float
) -> None:
    assert (
        stops_after({} if command_timeout is None else {"command_timeout": command_timeout}, "x")
        == seconds
    )


@pytest.mark.parametrize("scheme", ["ros2dds", "rmw_zenoh"])
def test_readings_of_the_platform_reach_the_driver_by_topics(scheme: str) -> None:
    stage = Stage(scheme, replace(BURGER, provides=BURGER.provides | {"reading:light"}))

    async def story() -> None:
        sink = CollectingSink()
        task = asyncio.create_task(stage.driver("r-1").run(sink))
        async with asyncio.timeout(TIMEOUT):
            while not (sink.taken["readings"] and sink.taken["readings"][-1].get("light") == 0.25):
                stage.side.publish("r-1", ScanInput(varied_scan(BURGER)))
                stage.side.publish("r-1", OdometryInput(odometry()))
                stage.side.publish("r-1", ReadingsInput({"light": 0.25}))
                stage.side.publish("r-2", ReadingsInput({"light": 0.75}))
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    try:
        asyncio.run(story())
    finally:
        stage.side.close()


def with_tags(folder: Path, **kinds: str) -> Platform:
    path = str(detections_folder(folder))
    return given(BURGER, message_path=path, detections={"tags": {**TAGS, "kinds": kinds}})


def test_a_tag_with_the_number_of_a_robot_is_one_clear_error(tmp_path: Path) -> None:
    platform = with_tags(tmp_path, tag36h11="robot", **{"2": "box"})
    with pytest.raises(ConfigError, match=r"detections.tags.kinds: .* robot r-2 .* for box"):
        Stage("ros2dds", platform)


@pytest.mark.parametrize(
    "kinds",
    [
        {"tag36h11": "robot", "2": "robot", "7": "box"},
        {"9": "robot", "2": "box"},  # all robots have tag 9
        {"2": "box"},  # robots have no tag
    ],
)
def test_other_tags_may_have_any_number(kinds: dict[str, str], tmp_path: Path) -> None:
    Stage("ros2dds", with_tags(tmp_path, **kinds)).side.close()


@pytest.mark.parametrize("scheme", ["ros2dds", "rmw_zenoh"])
def test_objects_with_a_kind_of_the_platform_reach_the_driver_as_tags(
    scheme: str, tmp_path: Path
) -> None:
    own: dict[str, Value] = {
        "message_path": str(detections_folder(tmp_path)),
        "detections": {"tags": TAGS},
    }
    platform = replace(BURGER, drivers={scheme: {**BURGER.drivers[scheme], **own}})
    stage, sink = Stage(scheme, platform), CollectingSink()
    seen = [Detection("robot", 0.3, 1.5, "r-02"), Detection("box", -0.2, 2.0, "crate")]
    unseen = [Detection("lamp", 0.0, 2.0, "light"), Detection("box", 1.2, 2.0, "crate")]

    async def story() -> None:
        task = asyncio.create_task(stage.driver("r-1").run(sink))
        async with asyncio.timeout(TIMEOUT):
            count = 0
            while not (sink.taken["detections"] and sink.taken["detections"][-1]):
                count += 1
                stage.side.publish("r-1", ScanInput(varied_scan(BURGER, count)))
                stage.side.publish("r-1", OdometryInput(odometry(count)))
                stage.side.publish("r-1", DetectionsInput((*seen, *unseen)))
                stage.side.publish("r-2", DetectionsInput(tuple(unseen)))
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    try:
        asyncio.run(story())
    finally:
        stage.side.close()
    found = sink.taken["detections"][-1] or ()
    assert [(one.kind, one.id) for one in found] == [("robot", "2"), ("box", "7")]
    for one, original in zip(found, seen, strict=True):
        assert one.bearing == pytest.approx(original.bearing, abs=1e-6)
        assert one.distance == pytest.approx(original.distance, abs=1e-6)


def test_an_emulated_ring_arrives_beside_the_scan() -> None:
    spec = ring_spec()
    topics: dict[str, Value] = {f"ir_{n}": [deg, 0.04] for n, deg in enumerate(RING_DEG)}
    drivers: dict[str, dict[str, Value]] = {
        "ros2dds": {**BURGER.drivers["ros2dds"], "ranges": topics}
    }
    stage = Stage("ros2dds", replace(with_ring(BURGER), drivers=drivers))
    seen = Scan(1, 2.0, np.array([0.5, np.inf, 0.25, -np.inf, 0.75, 1.0]), spec.bearings, 0.05, 1.0)

    async def story() -> CollectingSink:
        sink = CollectingSink()
        task = asyncio.create_task(stage.driver("r-1").run(sink))
        count = 0
        try:
            async with asyncio.timeout(TIMEOUT):
                while not (len(sink.rings) > 2 and sink.scans):
                    count += 1
                    stage.side.publish("r-1", ScanInput(varied_scan(BURGER, count)))
                    stage.side.publish("r-1", OdometryInput(odometry(count)))
                    stage.side.publish(
                        "r-1", RangesInput(structs.replace(seen, seq=count, stamp=0.1 * count))
                    )
                    await asyncio.sleep(0.02)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        return sink

    sink = asyncio.run(story())
    stage.side.close()
    ring = sink.rings[-1]
    np.testing.assert_allclose(ring.ranges, seen.ranges, rtol=1e-6)
    np.testing.assert_allclose(np.exp(1j * ring.bearings), np.exp(1j * spec.bearings), atol=1e-6)
    assert len(sink.scans[-1].ranges) == 360

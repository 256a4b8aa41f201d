"""The state of a robot as ROS 2 topics, read by a second codec; off without the option."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import zenoh

from swarmd.core.errors import ConfigError
from swarmd.core.messages import (
    DecisionSummary,
    Latch,
    LimitingObstacle,
    Motion,
    Reason,
    ShownPose,
    State,
)
from swarmd.core.values import Twist, Value
from swarmd.driver_api.driver import state_display
from swarmd.drivers.ros.options import Ros1Options, read_options
from swarmd.drivers.ros2.state_topics import DIAGNOSTICS, MARKERS, POSE
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.harness import check, drive
from tests.drivers.ros2.robots import CLOCKS_APART, BridgedRobot, Robot, ZenohRobot
from tests.support import ros2_types as dds
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.statuses import status
from tests.support.stories import story

pytestmark = pytest.mark.long

TYPES = {
    POSE: ("geometry_msgs", dds.PoseStamped),
    MARKERS: ("visualization_msgs", dds.MarkerArray),
    DIAGNOSTICS: ("diagnostic_msgs", dds.DiagnosticArray),
}
ON: dict[str, Value] = {"publish_state": True}
MOTION = Motion("r", 5.0, 1.0, 2.0, 0.0, (0.2, 0.0, 0.0), (0.1, 0.0, 0.0), True)
HELD = status(
    "r",
    reason=Reason.STALE_SCAN,
    decision=DecisionSummary(rows=(LimitingObstacle(0.5, 0.25, 0.08),), is_active=True),
)


class Listener:
    """A node at the hub of a robot that takes the topics of its state."""

    def __init__(self, robot: Robot, *topics: str) -> None:
        self.taken: dict[str, list[zenoh.Sample]] = {topic: [] for topic in topics}
        for topic, samples in self.taken.items():
            key = f"{robot.domain}/{topic}/*/*" if isinstance(robot, ZenohRobot) else topic
            robot.hub.declare_subscriber(key, samples.append)

    def last(self, topic: str) -> Any:
        return TYPES[topic][1].deserialize(self.taken[topic][-1].payload.to_bytes())


@story(BridgedRobot, ZenohRobot, publish_state=True)
async def test_pose_markers_and_diagnostics_tell_the_state(
    harness: DriverHarness, robot: Robot
) -> None:
    display = state_display(harness.driver)
    assert display is not None
    listener = Listener(robot, *TYPES)

    def show(pose: ShownPose | None = None, **changes: Any) -> bool:
        display.show(status("r", **changes) if changes else HELD, MOTION, pose)
        return all(listener.taken.values())

    await harness.until(show, publishing=True)
    pose, shown = listener.last(POSE), listener.last(MARKERS).markers
    assert (pose.header.frame_id, pose.pose.position.x, pose.pose.position.y) == ("odom", 1.0, 2.0)
    outline, heading, text = shown
    assert [one.ns for one in shown] == ["swarmd/r"] * 3
    assert len(outline.points) == len(robot.platform.footprint) + 1
    assert heading.points[1].x > 0.0
    assert text.text == "r: running\nstale_scan"
    assert outline.color.r > outline.color.g > outline.color.b  # orange: held
    (told,) = listener.last(DIAGNOSTICS).status
    values = {one.key: one.value for one in told.values}
    assert (told.hardware_id, told.level, told.message) == ("r", 1, "running: stale_scan")
    assert values["hold"] == "stale_scan"
    assert values["limit"] == "0.08 m/s towards 29 deg, gap 0.25 m"

    shared = ShownPose(
        robot="r", at=5.0, age=0.1, x=7.0, y=8.0, yaw=0.0, error=0.1, yaw_error=0.1, frame="hall"
    )
    latched = {"state": State.ESTOPPED, "latches": {"e": Latch(issuer="a", scope="swarm")}}

    def is_shared() -> bool:
        show(shared, **latched)
        levels = [one.level for one in listener.last(DIAGNOSTICS).status]
        placed = (listener.last(POSE), listener.last(MARKERS).markers[0])
        return {one.header.frame_id for one in placed} == {"hall"} and levels == [2]

    await harness.until(is_shared, publishing=True)
    assert listener.last(POSE).pose.position.x == 7.0


@story(lambda: ZenohRobot(domain=3), publish_state=True)
async def test_keys_hold_type_and_hash_and_the_node_announces_the_topics(
    harness: DriverHarness, robot: ZenohRobot
) -> None:
    display = state_display(harness.driver)
    assert display is not None
    listener = Listener(robot, *TYPES)

    def has_all() -> bool:
        display.show(HELD, MOTION, None)
        return all(listener.taken.values())

    await harness.until(has_all, publishing=True)
    for topic, samples in listener.taken.items():
        package, kind = TYPES[topic]
        domain, key = str(samples[0].key_expr).split("/", 1)
        assert (domain, key.split("/RIHS01_")[0]) == (
            "3",
            f"{topic}/{package}::msg::dds_::{kind.__name__}_",
        )
        assert samples[0].attachment is not None
    replies = robot.hub.liveliness().get("@ros2_lv/**")
    found = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
    announced = {part[9].replace("%", "/") for part in found if part[5] == "MP"}
    assert announced == {"/cmd_vel", "/swarmd/state", *(f"/{topic}" for topic in TYPES)}


@story(BridgedRobot, publish_state=True)
async def test_a_place_has_the_time_of_its_measurement_and_ends_with_the_odometry(
    harness: DriverHarness, robot: Robot
) -> None:
    display = state_display(harness.driver)
    assert display is not None
    listener = Listener(robot, *TYPES)

    def show(pose: ShownPose | None = None) -> None:
        display.show(HELD, MOTION, pose)

    def has_all() -> bool:
        show()
        return all(listener.taken.values())

    await harness.until(has_all, publishing=True)
    last = CLOCKS_APART + robot._published_count * 0.1 + 100.0  # the stamp of the last odometry
    await harness.until(lambda: harness.sink.odometries[-1].stamp > last - 0.05)
    odometry_at = time.time()
    told = counts(listener)

    def ends() -> bool:
        show()
        now = counts(listener)
        if now[POSE] > told[POSE] or now[MARKERS] > told[MARKERS]:
            told.update(now)
        return now[DIAGNOSTICS] >= told[DIAGNOSTICS] + 5  # they go on alone

    await harness.until(ends)
    assert seconds(listener.last(POSE)) <= odometry_at + 0.2
    assert time.time() - odometry_at > 1.0
    shared = ShownPose(
        robot="r", at=5.0, age=0.4, x=7.0, y=8.0, yaw=0.0, error=0.1, yaw_error=0.1, frame="hall"
    )

    def is_shared() -> bool:
        show(shared)
        now = counts(listener)
        return now[POSE] > told[POSE] and now[MARKERS] > told[MARKERS]

    await harness.until(is_shared)
    assert seconds(listener.last(POSE)) <= time.time() - 0.4
    assert seconds(listener.last(MARKERS).markers[0]) <= time.time() - 0.4


def counts(listener: Listener) -> dict[str, int]:
    return {topic: len(samples) for topic, samples in listener.taken.items()}


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


class Broken:
    """A publisher that raises an error of no declared kind."""

    def __init__(self) -> None:
        self.count = 0

    def put(self, *_: Any, **__: Any) -> None:
        self.count += 1
        raise RuntimeError("out of order")


@story(BridgedRobot, publish_state=True)
async def test_a_topic_that_fails_ends_neither_the_driver_nor_the_others(
    harness: DriverHarness, robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    driver: Any = harness.driver
    listener = Listener(robot, *TYPES)

    def has_all() -> bool:
        driver.show(HELD, MOTION, None)
        return all(listener.taken.values())

    await harness.until(has_all, publishing=True)
    broken = driver._state._publishers[POSE] = Broken()
    before = counts(listener)

    def goes_on() -> bool:
        driver.show(HELD, MOTION, None)
        driver.send(Twist(0.1), 1, 1)
        now = counts(listener)
        return all(now[topic] > before[topic] + 2 for topic in (MARKERS, DIAGNOSTICS))

    await harness.until(goes_on, publishing=True)
    await drive(harness)
    assert broken.count == 1
    assert caplog.text.count("swarmd/pose is not published any more") == 1


@story(BridgedRobot)
async def test_without_the_option_nothing_is_published(
    harness: DriverHarness, robot: Robot
) -> None:
    assert state_display(harness.driver) is None
    listener = Listener(robot, *TYPES)
    shown: Any = harness.driver
    for _ in range(5):
        shown.show(HELD, MOTION, None)
        harness.driver.send(Twist(0.1), 1, 1)
        await harness.until(lambda: bool(robot.commands()), publishing=True)
    assert not any(listener.taken.values())


def test_a_check_names_the_topics() -> None:
    robot = BridgedRobot()
    finding = check(robot, robot.publish, namespace="tb3_01", publish_state=True)["state topics"]
    assert "/tb3_01/swarmd/pose" in finding.text
    assert "/tb3_01/diagnostics" in finding.text


def test_the_driver_of_ros_1_refuses_the_option() -> None:
    with pytest.raises(ConfigError, match="publish_state"):
        read_options(Ros1Options, ON, "ros1", "r")


@pytest.mark.integration
def test_a_daemon_shows_the_state_of_its_robot(tmp_path: Path) -> None:
    robot = BridgedRobot()
    listener = Listener(robot, *TYPES)

    def has_all() -> bool:
        robot.publish()
        return all(listener.taken.values())

    options: dict[str, Any] = {"driver": "ros2dds", "driver_options": dict(robot.options(ON))}
    daemon = DaemonProcess(
        tmp_path, swarm=unique_swarm(), robot="r7", endpoint="", platform="burger", options=options
    )
    try:
        with daemon:
            daemon.wait_ready()
            wait_until(has_all, "the state is published")
            assert listener.last(DIAGNOSTICS).status[0].name == "swarmd: r7"
            assert listener.last(MARKERS).markers[2].text.startswith("r7: idle")
    finally:
        robot.close()

"""Readings of topics over both ways of ROS 2: heard, stale, back, and checked."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from rosbags.typesys import Stores

from swarmd.core.values import Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.testing.driver_contract import TIMEOUT, DriverHarness, play
from tests.drivers.ros.contract import DOCKED, docked
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.support import ros2_types as dds
from tests.support.stories import story
from tests.support.vendor_messages import PACKAGE, vendor_folder

pytestmark = pytest.mark.long

ENTRY: dict[str, Value] = {
    "topic": "/temp",
    "type": "sensor_msgs/Temperature",
    "field": "temperature",
    "unit": "degC",
    "stale_after": 0.3,
}
OPTION: dict[str, Value] = {"temperature": ENTRY}


@story(BridgedRobot, ZenohRobot, connected=False, readings=OPTION)
async def test_a_reading_arrives_becomes_stale_and_comes_back(
    harness: DriverHarness, robot: Robot
) -> None:
    def heat(harness: DriverHarness) -> float:
        values = harness.sink.taken["readings"]
        return values[-1].get("temperature", -1.0) if values else -1.0

    def is_heat(harness: DriverHarness, degrees: float) -> bool:
        return heat(harness) == degrees

    await harness.connect()
    await harness.until(lambda: math.isnan(heat(harness)), publishing=True)
    for degrees in (20.0, 21.0):
        robot.put("temp", dds.Temperature(temperature=degrees))
        await harness.until(partial(is_heat, harness, degrees), publishing=True)
        await harness.until(lambda: math.isnan(heat(harness)), publishing=True)
    assert harness.sink.is_up


def test_a_check_tells_value_unit_and_age() -> None:
    robot = BridgedRobot()

    def publish() -> None:
        robot.publish()
        robot.put("temp", dds.Temperature(temperature=20.5))

    lasting: dict[str, Value] = {"temperature": {**ENTRY, "stale_after": TIMEOUT}}
    found = check(robot, publish, readings=lasting)["readings.temperature"]
    assert found.is_well, found.text
    assert "/temp (sensor_msgs/msg/Temperature)" in found.text
    assert "temperature 20.5 degC" in found.text
    assert found.text.endswith("s ago")


def test_a_check_has_a_line_for_an_array_and_for_each_topic_of_several() -> None:
    robot = BridgedRobot()
    options: dict[str, Value] = {
        "ground": {"topic": "line", "type": "std_msgs/Float32MultiArray", "field": "data.*",
                   "count": 2},
        "light": {"topic": ["light/l", "light/r"], "type": "std_msgs/Float32"},
    }  # fmt: skip

    def publish() -> None:
        robot.publish()
        robot.put("line", dds.Float32MultiArray(data=[0.5, 0.75]))
        robot.put("light/l", dds.Float32(data=3.0))

    found = check(robot, publish, readings=options)
    assert found["readings.ground"].is_well
    assert "ground_1 0.5, ground_2 0.75" in found["readings.ground"].text
    assert "light_1 3" in found["readings.light_1"].text
    assert not found["readings.light_2"].is_well
    assert "/light/r" in found["readings.light_2"].text


@pytest.mark.parametrize("is_heard", [True, False])
def test_a_check_has_a_line_for_each_entry_of_a_topic(is_heard: bool) -> None:
    imu: dict[str, Value] = {"topic": "imu", "type": "sensor_msgs/Imu"}
    tilt: dict[str, Value] = {"field": "linear_acceleration.z", "below": -1.0, "means": "lifted"}
    robot, stamps = BridgedRobot(), itertools.count(1.0, 0.1)

    def publish() -> None:
        robot.publish()
        if is_heard:
            header = dds.stamped(next(stamps), "imu")
            robot.put("imu", dds.Imu(header, orientation=dds.Quaternion(w=1.0)))

    found = check(
        robot,
        publish,
        imu="imu",
        readings={"yaw_rate": {**imu, "field": "angular_velocity.z"}},
        hazards={"tilt": {**imu, **tilt}},
    )
    assert found["imu"].is_well
    for entry in ("readings.yaw_rate", "hazards.tilt"):
        assert found[entry].is_well is is_heard
        assert "/imu" in found[entry].text


@pytest.mark.parametrize("make", [BridgedRobot, ZenohRobot])
@pytest.mark.parametrize("stale_after", ["never", 30.0])
def test_a_reading_that_came_before_the_base_was_connected_counts(
    make: Callable[[], Robot], stale_after: Value
) -> None:
    robot = make()
    dock = robot.dock(is_latched=False)
    entry: dict[str, Value] = {"topic": "dock", "type": "std_msgs/Bool", "stale_after": stale_after}

    async def told(harness: DriverHarness) -> None:
        await harness.until(dock.is_heard)
        dock.put(True)
        await harness.connect()
        await harness.until(lambda: docked(harness) == 1.0, publishing=True)

    play(robot, told, connected=False, readings={"docked": entry})


@story(BridgedRobot, ZenohRobot, readings=DOCKED)
async def test_a_node_that_comes_later_is_asked_for_its_latched_message(
    harness: DriverHarness, robot: Robot
) -> None:
    await harness.until(lambda: math.isnan(docked(harness)), publishing=True)
    dock = robot.dock(is_latched=True)
    dock.put(True)
    await harness.until(lambda: docked(harness) == 1.0, publishing=True)
    dock.close()


@pytest.mark.parametrize("make", [BridgedRobot, ZenohRobot])
def test_a_vendors_message_is_read(make: Callable[[], Robot], tmp_path: Path) -> None:
    robot, path = make(), str(vendor_folder(tmp_path))
    name = f"{PACKAGE}/HazardDetectionVector"
    types = MessageTypes(Stores.ROS2_JAZZY, [path])
    header = types.kind("std_msgs/Header")(types.kind("builtin_interfaces/Time")(1, 2), "base")
    hazard = types.kind(f"{PACKAGE}/HazardDetection")(header=header, type=4)
    kind = types.kind(name)
    payload = cdr.encode(kind(header=header, detections=[hazard]))
    key = f"0/hazards/{PACKAGE}::msg::dds_::HazardDetectionVector_/{cdr.type_hash(kind)}"
    entry: dict[str, Value] = {"topic": "hazards", "type": name, "field": "detections.0.type"}

    async def story(harness: DriverHarness) -> None:
        def is_read() -> bool:
            robot.hub.put(key if isinstance(robot, ZenohRobot) else "hazards", payload)
            return harness.sink.taken["readings"][-1:] == [{"hazard": 4.0}]

        await harness.until(is_read, publishing=True)
        # On a busy machine a newer message overtakes a message that still waits.
        assert all(one.endswith(":overtaken") for one in harness.sink.lost)

    play(robot, story, readings={"hazard": entry}, message_path=path)

"""Readings of topics over both ways of ROS 2: heard, stale, back, and checked."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import pytest

from swarmd.core.values import Value
from swarmd.drivers.ros import cdr
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import HASHES, BridgedRobot, Robot, ZenohRobot
from tests.support import ros2_types as dds

OPTION: dict[str, Value] = {
    "temperature": {
        "topic": "/temp",
        "type": "sensor_msgs/Temperature",
        "field": "temperature",
        "unit": "degC",
        "stale_after": 0.3,
    }
}
MAKERS = pytest.mark.parametrize("make", [BridgedRobot, ZenohRobot])


@pytest.fixture(autouse=True)
def _hash(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = cdr.store().types["sensor_msgs/msg/Temperature"]
    monkeypatch.setitem(HASHES, "Temperature", cdr.type_hash(kind))


@MAKERS
def test_a_reading_arrives_becomes_stale_and_comes_back(make: Callable[[], Robot]) -> None:
    robot = make()

    def heat(harness: DriverHarness) -> float:
        values = harness.sink.values
        return values[-1].get("temperature", -1.0) if values else -1.0

    def is_heat(harness: DriverHarness, degrees: float) -> bool:
        return heat(harness) == degrees

    async def story(harness: DriverHarness) -> None:
        await harness.until(lambda: math.isnan(heat(harness)), publishing=True)
        for degrees in (20.0, 21.0):
            robot.put("temp", dds.Temperature(temperature=degrees))
            await harness.until(partial(is_heat, harness, degrees), publishing=True)
            await harness.until(lambda: math.isnan(heat(harness)), publishing=True)
        assert harness.sink.is_up

    play(robot, story, readings=OPTION)


@MAKERS
def test_a_check_tells_value_unit_and_age(make: Callable[[], Robot]) -> None:
    robot = make()

    def publish() -> None:
        robot.publish()
        robot.put("temp", dds.Temperature(temperature=20.5))

    found = check(robot, publish, readings=OPTION)["readings.temperature"]
    assert found.is_well, found.text
    assert "/temp (sensor_msgs/msg/Temperature)" in found.text
    assert "temperature 20.5 degC" in found.text
    assert found.text.endswith("s ago")


@MAKERS
def test_a_check_tells_that_a_topic_is_not_heard(make: Callable[[], Robot]) -> None:
    robot = make()
    found = check(robot, robot.publish, seconds=1.2, readings=OPTION)["readings.temperature"]
    assert not found.is_well
    assert "/temp" in found.text

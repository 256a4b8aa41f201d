"""Readings of any topic: by type and field, with their age."""

from __future__ import annotations

import math
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds

TEMPERATURE: dict[str, Value] = {
    "topic": "/temp",
    "type": "sensor_msgs/Temperature",
    "field": "temperature",
    "unit": "degC",
}


def options(**readings: dict[str, Value]) -> RosOptions:
    return read_options(RosOptions, {"readings": readings}, "ros2dds", "r")  # type: ignore[dict-item]


def subscribed(**readings: dict[str, Value]) -> Subscriptions:
    return Subscriptions(options(**readings), robots.PLATFORM)


def values(subscriptions: Subscriptions, name: str, message: Any, now: float) -> dict[str, float]:
    """What the sink gets of a message that arrives at `now`."""
    sink = CollectingSink()
    subscriptions.read(name, message.serialize(), now)(sink)
    return dict(sink.values[-1])


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
@pytest.mark.parametrize(
    ("change", "subject"),
    [
        ({"type": "sensor_msgs/Temprature"}, "readings.heat.type"),
        ({"type": "Temperature"}, "readings.heat.type"),
        ({"field": "temprature"}, "'temperature'"),
        ({"field": "header"}, "readings.heat.field"),
        ({"field": "header.frame_id"}, "readings.heat.field"),
        ({"field": "temperature.x"}, "readings.heat.field"),
        ({"type": "std_msgs/Float32MultiArray"}, "readings.heat.field"),
        ({"type": "sensor_msgs/Imu", "field": "orientation_covariance.9"}, "below 9"),
        ({"type": "sensor_msgs/Imu", "field": "orientation_covariance"}, "index"),
        ({"stale_after": 0}, "readings.heat.stale_after"),
        ({"unti": "K"}, "'unit'"),
        ({"topic": "odom"}, "odometry and readings.heat"),
        ({"topic": "1st"}, "readings.heat"),
    ],
)
def test_a_wrong_entry_is_one_line_that_names_it(
    kind: type[TopicOptions], change: dict[str, Value], subject: str
) -> None:
    readings: dict[str, Value] = {"heat": {**TEMPERATURE, **change}}
    with pytest.raises(ConfigError) as caught:
        read_options(kind, {"readings": readings}, "ros", "r")
    assert subject in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["battery", "x-y", "", "x" * 64])
def test_a_name_that_no_pattern_could_need_is_refused(name: str) -> None:
    with pytest.raises(ConfigError):
        options(**{name: TEMPERATURE})


@pytest.mark.parametrize(
    ("kind", "field", "message", "wanted"),
    [
        ("sensor_msgs/msg/Temperature", "temperature", dds.Temperature(temperature=21.5), 21.5),
        ("std_msgs/Float32", "data", dds.Float32(data=0.25), 0.25),
        ("std_msgs/Bool", "data", dds.Bool(data=True), 1.0),
        ("sensor_msgs/Imu", "angular_velocity.z",
         dds.Imu(angular_velocity=dds.Vector3(z=-2.0)), -2.0),
        ("sensor_msgs/Imu", "orientation_covariance.8",
         dds.Imu(orientation_covariance=[0.0] * 8 + [3.0]), 3.0),
        ("sensor_msgs/Joy", "axes.1", dds.Joy(axes=[0.0, 0.5]), 0.5),
    ],
)  # fmt: skip
def test_the_field_of_a_message_is_the_reading(
    kind: str, field: str, message: Any, wanted: float
) -> None:
    entry: dict[str, Value] = {"topic": "x", "type": kind, "field": field}
    assert values(subscribed(one=entry), "readings.one", message, 1.0) == {"one": wanted}


@pytest.mark.parametrize(
    ("kind", "field", "message"),
    [
        ("sensor_msgs/Temperature", "temperature", dds.Temperature(temperature=math.inf)),
        ("sensor_msgs/Joy", "axes.1", dds.Joy(axes=[0.0])),
    ],
)
def test_a_message_without_a_finite_value_gives_none(kind: str, field: str, message: Any) -> None:
    entry: dict[str, Value] = {"topic": "x", "type": kind, "field": field}
    assert math.isnan(values(subscribed(one=entry), "readings.one", message, 1.0)["one"])


def test_two_readings_come_from_one_topic() -> None:
    variance = {**TEMPERATURE, "field": "variance"}
    both = subscribed(heat=TEMPERATURE, spread=variance)
    message = dds.Temperature(temperature=20.0, variance=0.5)
    assert values(both, "readings.heat", message, 1.0) == {"heat": 20.0, "spread": 0.5}
    with pytest.raises(ConfigError):
        options(heat=TEMPERATURE, other={**TEMPERATURE, "type": "std_msgs/Float32"})


def test_a_silent_topic_becomes_stale_and_comes_back() -> None:
    subscriptions = subscribed(heat={**TEMPERATURE, "stale_after": 2.0})
    sink = CollectingSink()

    def looked(now: float) -> bool:
        news = subscriptions.stale_readings(now)
        if news is not None:
            news(sink)
        return news is not None

    assert looked(0.0)  # never heard
    assert math.isnan(sink.values[-1]["heat"])
    assert not looked(0.5)
    message = dds.Temperature(temperature=20.0)
    assert values(subscriptions, "readings.heat", message, 1.0) == {"heat": 20.0}
    assert not looked(3.0)
    assert looked(3.1)
    assert math.isnan(sink.values[-1]["heat"])
    assert values(subscriptions, "readings.heat", message, 4.0) == {"heat": 20.0}


def test_a_message_that_repeats_its_stamp_is_as_old_as_the_first() -> None:
    subscriptions = subscribed(heat=TEMPERATURE)

    def taken(stamp: float, now: float) -> float:
        message = dds.Temperature(header=dds.stamped(stamp, "base"), temperature=20.0)
        return values(subscriptions, "readings.heat", message, now)["heat"]

    assert [taken(5.0, now) for now in (0.0, 0.6)] == [20.0, 20.0]
    assert math.isnan(taken(5.0, 1.2))
    assert taken(6.0, 1.3) == 20.0


def test_a_battery_stays_beside_a_stale_reading() -> None:
    read = read_options(
        RosOptions, {"battery": "power", "readings": {"heat": TEMPERATURE}}, "ros2dds", "r"
    )
    subscriptions = Subscriptions(read, robots.PLATFORM)
    battery = dds.BatteryState(voltage=12.0, percentage=0.5)
    found = values(subscriptions, "battery", battery, 1.0)
    assert found["battery"] == 0.5
    assert math.isnan(found["heat"])

"""Readings of any topic: by type and field, with their age."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_readings import TopicReading
from swarmd.drivers.ros1 import serialization
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds
from tests.support.vendor_messages import PACKAGE, vendor_folder

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
    return dict(sink.taken["readings"][-1])


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
        ({"field": "temperature.length"}, "readings.heat.field"),
        ({"type": "std_msgs/Float32MultiArray", "field": "data.lenght"}, "length"),
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
        ("sensor_msgs/Joy", "axes.length", dds.Joy(axes=[0.0, 0.5]), 2.0),
        ("sensor_msgs/Joy", "axes.length", dds.Joy(), 0.0),
        ("std_msgs/Byte", "data", dds.Byte(data=200), 200.0),
        ("std_msgs/ByteMultiArray", "data.1", dds.ByteMultiArray(data=[1, 200]), 200.0),
        ("std_msgs/Char", "data", dds.Char(data=200), 200.0),
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


def test_a_byte_of_ros1_has_a_sign() -> None:
    entry: dict[str, Value] = {"topic": "x", "type": "std_msgs/Byte"}
    read = read_options(Ros1Options, {"readings": {"one": entry}}, "ros1", "r")
    reading = read.topic_entries["readings"]["one"]
    assert isinstance(reading, TopicReading)
    assert reading.value(serialization.decode(reading.message_type, b"\xc8")) == -56.0


def test_the_number_of_hazards_in_a_vendors_message_is_a_reading(tmp_path: Path) -> None:
    entries: dict[str, Value] = {
        name: {"topic": "hazards", "type": f"{PACKAGE}/HazardDetectionVector", "field": field}
        for name, field in (("count", "detections.length"), ("first", "detections.0.type"))
    }
    given: dict[str, Value] = {"readings": entries, "message_path": str(vendor_folder(tmp_path))}
    subscriptions = Subscriptions(read_options(RosOptions, given, "ros2dds", "r"), robots.PLATFORM)
    types = read_options(RosOptions, given, "ros2dds", "r").message_types
    header = types.kind("std_msgs/Header")(types.kind("builtin_interfaces/Time")(1, 0), "base")
    hazard = types.kind(f"{PACKAGE}/HazardDetection")(header=header, type=4)
    message = types.kind(f"{PACKAGE}/HazardDetectionVector")(header=header, detections=[hazard] * 2)
    sink = CollectingSink()
    subscriptions.read("readings.count", cdr.encode(message), 1.0)(sink)
    assert sink.taken["readings"][-1] == {"count": 2.0, "first": 4.0}


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
        before = len(sink.taken["readings"])
        subscriptions.deliver_inputs(sink, now)
        return len(sink.taken["readings"]) > before

    assert looked(0.0)  # never heard
    assert math.isnan(sink.taken["readings"][-1]["heat"])
    assert not looked(0.5)
    message = dds.Temperature(temperature=20.0)
    assert values(subscriptions, "readings.heat", message, 1.0) == {"heat": 20.0}
    assert not looked(3.0)
    assert looked(3.1)
    assert math.isnan(sink.taken["readings"][-1]["heat"])
    assert values(subscriptions, "readings.heat", message, 4.0) == {"heat": 20.0}


def test_a_message_that_repeats_its_stamp_is_as_old_as_the_first() -> None:
    subscriptions, sink = subscribed(heat=TEMPERATURE), CollectingSink()

    def taken(stamp: float, now: float) -> float:
        message = dds.Temperature(header=dds.stamped(stamp, "base"), temperature=20.0)
        subscriptions.read("readings.heat", message.serialize(), now)(sink)
        return float(sink.taken["readings"][-1]["heat"])

    assert [taken(5.0, now) for now in (0.0, 0.6)] == [20.0, 20.0]
    assert math.isnan(taken(5.0, 1.2))
    assert taken(6.0, 1.3) == 20.0


def test_a_battery_stays_beside_a_stale_reading() -> None:
    read = read_options(
        RosOptions,
        {"battery": "power", "battery_percentage": "share", "readings": {"heat": TEMPERATURE}},
        "ros2dds",
        "r",
    )
    subscriptions = Subscriptions(read, robots.PLATFORM)
    battery = dds.BatteryState(voltage=12.0, percentage=0.5)
    found = values(subscriptions, "battery", battery, 1.0)
    assert found["battery"] == 0.5
    assert math.isnan(found["heat"])


DOCKED: dict[str, Value] = {"topic": "/dock", "type": "std_msgs/Bool", "stale_after": "never"}


def docked(subscriptions: Subscriptions, now: float) -> float:
    """What a base that is connected at `now` gets."""
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, now, again=True)
    return float(sink.taken["readings"][-1]["docked"])


def heard(subscriptions: Subscriptions, is_docked: bool, now: float, *, is_kept: bool) -> None:
    payload = dds.Bool(data=is_docked).serialize()
    subscriptions.read("readings.docked", payload, now, is_kept=is_kept)


def test_a_reading_that_holds_is_never_stale() -> None:
    subscriptions = subscribed(docked=DOCKED)
    assert math.isnan(docked(subscriptions, 0.0))
    heard(subscriptions, True, 1.0, is_kept=False)
    assert docked(subscriptions, 1e6) == 1.0
    subscriptions.forget()
    assert math.isnan(docked(subscriptions, 1e6))


def test_a_message_of_a_cache_does_not_replace_a_newer_one() -> None:
    subscriptions = subscribed(docked=DOCKED)
    heard(subscriptions, False, 1.0, is_kept=True)
    assert docked(subscriptions, 1.0) == 0.0
    heard(subscriptions, True, 2.0, is_kept=False)
    heard(subscriptions, False, 2.1, is_kept=True)
    assert docked(subscriptions, 3.0) == 1.0


def test_a_message_without_a_value_ends_what_holds() -> None:
    entry = {**TEMPERATURE, "stale_after": "never"}
    subscriptions = subscribed(heat=entry)
    warm, none = dds.Temperature(temperature=20.0), dds.Temperature(temperature=math.nan)
    assert values(subscriptions, "readings.heat", warm, 1.0) == {"heat": 20.0}
    assert math.isnan(values(subscriptions, "readings.heat", none, 2.0)["heat"])


def test_a_reading_of_a_dropped_delivery_is_told_at_the_next_look() -> None:
    """The driver delivers nothing before its base is connected."""
    subscriptions = subscribed(docked=DOCKED)
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, 0.0, again=True)
    heard(subscriptions, True, 1.0, is_kept=False)
    subscriptions.deliver_inputs(sink, 2.0, again=True)
    assert sink.taken["readings"][-1] == {"docked": 1.0}


BATTERY: dict[str, Value] = {"topic": "power", "type": "sensor_msgs/BatteryState"}
IMU: dict[str, Value] = {"topic": "imu", "type": "sensor_msgs/msg/Imu"}


def test_an_option_and_readings_of_one_topic_are_read_from_one_message() -> None:
    given: dict[str, Value] = {
        "battery": "power",
        "readings": {"current": {**BATTERY, "field": "current"},
                     "cell": {**BATTERY, "topic": "/power", "field": "cell_voltage.1"}},
    }  # fmt: skip
    subscriptions = Subscriptions(read_options(RosOptions, given, "ros2dds", "r"), robots.PLATFORM)
    assert [stats.topic for stats in subscriptions.topics.values()].count("/power") == 1
    message = dds.BatteryState(voltage=12.0, current=-0.5, cell_voltage=[4.0, 3.9])
    found = values(subscriptions, "battery", message, 1.0)
    assert found == pytest.approx({"battery_voltage": 12.0, "current": -0.5, "cell": 3.9})
    assert "current -0.5" in subscriptions.topics["battery"].summary
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, 3.0)
    assert sink.taken["readings"]


def test_a_reading_of_the_odometry_comes_with_it() -> None:
    entry: dict[str, Value] = {
        "topic": "odom", "type": "nav_msgs/Odometry", "field": "twist.twist.linear.x"
    }  # fmt: skip
    subscriptions, sink = subscribed(speed=entry), CollectingSink()
    payload = robots.odometry(1.0, speed=0.25).serialize()
    subscriptions.read("odometry", payload, 1.0)(sink)
    assert sink.taken["readings"] == [{"speed": 0.25}]
    assert len(sink.odometries) == 1
    assert subscriptions.last_arrival == 1.0


def test_a_reading_is_heard_although_the_option_cannot_read_the_message() -> None:
    """As of a filter that has diverged."""
    given: dict[str, Value] = {
        "imu": "imu", "readings": {"yaw_rate": {**IMU, "field": "angular_velocity.z"}}
    }  # fmt: skip
    subscriptions = Subscriptions(read_options(RosOptions, given, "ros2dds", "r"), robots.PLATFORM)
    message = dds.Imu(angular_velocity=dds.Vector3(z=0.5), orientation=dds.Quaternion(w=math.nan))
    with pytest.raises(CodecError):
        subscriptions.read("imu", message.serialize(), 1.0)
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, 1.1)
    assert sink.taken["readings"] == [{"yaw_rate": 0.5}]


@pytest.mark.parametrize(
    "given",
    [
        {"imu": "power", "readings": {"current": {**BATTERY, "field": "current"}}},
        {"readings": {"a": {**BATTERY, "field": "current"}, "b": {**IMU, "topic": "power",
                                                              "field": "angular_velocity.z"}}},
        {"imu": "power", "battery": "power"},
        {"readings": {"a": {**IMU, "topic": "cmd_vel", "field": "angular_velocity.z"}}},
        {"readings": {"a": {"topic": "cmd_vel", "type": "geometry_msgs/Twist",
                            "field": "linear.x"}}},
    ],
)  # fmt: skip
def test_two_types_of_one_topic_are_one_line(given: dict[str, Value]) -> None:
    with pytest.raises(ConfigError) as caught:
        read_options(RosOptions, given, "ros2dds", "r")
    assert "are both /" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [0, "ever", True, 1e9])
def test_a_time_that_is_none_is_refused(value: Value) -> None:
    with pytest.raises(ConfigError):
        options(docked={**DOCKED, "stale_after": value})


@pytest.mark.parametrize("name", ["scan", "odometry"])
def test_what_is_late_is_a_reading_and_moves_nothing(name: str) -> None:
    """A cache may be asked for a topic that is also the scan's or the odometry's."""
    entry: dict[str, Value] = {
        "scan": {"topic": "scan", "type": "sensor_msgs/LaserScan", "field": "range_max"},
        "odometry": {"topic": "odom", "type": "nav_msgs/Odometry", "field": "pose.pose.position.x"},
    }  # fmt: skip
    made = {"scan": robots.scan(5.0), "odometry": robots.odometry(5.0)}
    subscriptions, sink = subscribed(late={**entry[name], "stale_after": "never"}), CollectingSink()  # type: ignore[dict-item]
    subscriptions.read(name, made[name].serialize(), 1.0, is_kept=True)(sink)
    assert set(sink.taken["readings"][-1]) == {"late"}
    assert math.isfinite(sink.taken["readings"][-1]["late"])
    assert not sink.scans
    assert not sink.odometries
    assert subscriptions.last_arrival == -math.inf
    assert subscriptions.topics[name].count == 0


ARRAY: dict[str, Value] = {
    "topic": "cliffs",
    "type": "std_msgs/Float32MultiArray",
    "field": "data.*",
    "count": 3,
}


def test_the_items_of_a_list_are_sensors_with_their_mean() -> None:
    subscriptions = subscribed(ground=ARRAY)
    message = dds.Float32MultiArray(data=[0.0, 0.25, 0.5, 9.0])
    found = values(subscriptions, "readings.ground", message, 1.0)
    assert found == {"ground": 0.25, "ground_1": 0.0, "ground_2": 0.25, "ground_3": 0.5}
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, 2.5)
    assert len(sink.taken["readings"][-1]) == 4
    assert all(math.isnan(value) for value in sink.taken["readings"][-1].values())


def test_a_list_that_is_too_short_gives_no_mean() -> None:
    message = dds.Float32MultiArray(data=[0.5])
    found = values(subscribed(ground=ARRAY), "readings.ground", message, 1.0)
    assert found.pop("ground_1") == 0.5
    assert sorted(found) == ["ground", "ground_2", "ground_3"]
    assert all(math.isnan(value) for value in found.values())


def test_messages_in_a_list_of_a_vendor_type_are_sensors(tmp_path: Path) -> None:
    cliff = {"topic": "cliff_intensity", "type": "irobot_create_msgs/IrIntensityVector"}
    entry = {**cliff, "field": "readings.*.value", "count": 2}
    folder = tmp_path / "irobot_create_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "IrIntensity.msg").write_text("std_msgs/Header header\nint16 value\n")
    vector = "std_msgs/Header header\nirobot_create_msgs/IrIntensity[] readings\n"
    (folder / "IrIntensityVector.msg").write_text(vector)
    given = {"readings": {"ground": entry}, "message_path": str(tmp_path)}
    chosen = read_options(RosOptions, given, "ros2dds", "r")  # type: ignore[arg-type]
    types, subscriptions = chosen.message_types, Subscriptions(chosen, robots.PLATFORM)
    header = types.kind("std_msgs/Header")(types.kind("builtin_interfaces/Time")(7, 0), "base")
    one, many = types.kind("irobot_create_msgs/IrIntensity"), types.kind(cliff["type"])
    payload = cdr.encode(many(header, [one(header, 100), one(header, 300)]))
    sink = CollectingSink()
    subscriptions.read("readings.ground", payload, 1.0)(sink)
    assert sink.taken["readings"][-1] == {"ground": 200.0, "ground_1": 100.0, "ground_2": 300.0}


def test_sensors_of_several_topics_have_a_mean_while_all_are_heard() -> None:
    entry: dict[str, Value] = {"topic": ["left", "right"], "type": "std_msgs/Float32"}
    subscriptions = subscribed(light=entry)
    found = values(subscriptions, "readings.light_2", dds.Float32(data=3.0), 1.0)
    assert found.pop("light_2") == 3.0
    assert all(math.isnan(value) for value in found.values())
    found = values(subscriptions, "readings.light_1", dds.Float32(data=1.0), 1.5)
    assert found == {"light": 2.0, "light_1": 1.0, "light_2": 3.0}
    found = values(subscriptions, "readings.light_1", dds.Float32(data=1.0), 2.2)
    assert math.isnan(found["light"])
    assert math.isnan(found["light_2"])


@pytest.mark.parametrize(
    ("change", "subject"),
    [
        ({"count": None}, "readings.ground.count"),
        ({"field": "data.0"}, "readings.ground.count"),
        ({"count": 65}, "readings.ground.count"),
        ({"topic": ["one"]}, "readings.ground.topic"),
        ({"field": "layout.*"}, "readings.ground.field"),
        ({"type": "sensor_msgs/Imu", "field": "orientation_covariance.*", "count": 10}, "below 9"),
    ],
)
def test_a_wrong_array_is_one_line_that_names_it(change: dict[str, Value], subject: str) -> None:
    with pytest.raises(ConfigError) as caught:
        options(ground={**ARRAY, **change})
    assert subject in str(caught.value)


def test_an_array_and_another_reading_cannot_have_one_name() -> None:
    with pytest.raises(ConfigError) as caught:
        options(ground=ARRAY, ground_2=TEMPERATURE)
    assert "ground_2" in str(caught.value)
    with pytest.raises(ConfigError):
        options(ground_2=TEMPERATURE, ground=ARRAY)

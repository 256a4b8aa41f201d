"""What a message says that it does not measure is no reading, and a check says why: one table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from swarmd.core.errors import CodecError
from swarmd.core.values import Scan, Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.absence import _RULES
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros.test_diagnosis import found
from tests.drivers.ros2 import robots
from tests.support.vendor_messages import detections_folder

Fields = Mapping[str, Any]
Options = Mapping[str, Value]


def filled(options: TopicOptions, name: str, fields: Fields) -> Any:
    """A message of zeros, empty lists and texts but for these fields, by dotted names."""
    types = options.message_types
    kind = types.kind(name)
    return kind(
        **{
            field: _value(options, node, _below(fields, field))
            for field, node in types.fielddefs[f"{name.replace('/', '/msg/')}"][1]
        }
    )


def _below(fields: Fields, field: str) -> Fields:
    """What is given of a field: the whole under "", or parts of it by their names."""
    given = {name.partition("."): value for name, value in fields.items()}
    return {rest: value for (first, _, rest), value in given.items() if first == field}


def _value(options: TopicOptions, node: Any, given: Fields) -> Any:
    kind, detail = node
    if kind is Nodetype.NAME:
        return filled(options, detail.replace("/msg/", "/"), given)
    if kind is Nodetype.BASE:
        texts = detail[0] in ("string", "wstring")
        return given.get("", "" if texts else False if detail[0] == "bool" else 0)
    item, length = detail
    if item[0] is Nodetype.NAME:
        parts = given.get("", [{}] * length if kind is Nodetype.ARRAY else [])
        return [_value(options, item, part) for part in parts]
    values = given.get("", [0.0] * length if kind is Nodetype.ARRAY else [])
    return np.array(values, item[1][0])


def reading(kind: str, field: str, **more: Value) -> Options:
    entry: dict[str, Value] = {"topic": "x", "type": kind, "field": field, **more}
    return {"readings": {"x": entry}}


def covariance(first: float, size: int = 9) -> Sequence[float]:
    return [first, *[0.0] * (size - 1)]


FLOOR: Options = {"hazards": {"x": {
    "topic": "x", "type": "sensor_msgs/Range", "field": "range", "above": 0.06, "means": "cliff",
}}}  # fmt: skip
BOXES: Options = {"detections": {"x": {
    "topic": "x", "type": "vision_msgs/Detection2DArray", "image_width": 640,
    "field_of_view_deg": 60,
}}}  # fmt: skip
TAGS: Options = {"detections": {"x": {
    "topic": "x", "type": "apriltag_msgs/AprilTagDetectionArray", "image_width": 640,
    "field_of_view_deg": 60,
}}}  # fmt: skip
CLOUD: Options = {"detections": {"x": {"topic": "x", "type": "vision_msgs/Detection3DArray"}}}
VOLTS: Options = {"battery": "x", "battery_volts": [11.0, 12.6]}
SHARE: Options = {"battery": "x", "battery_percentage": "share"}
UPRIGHT: Fields = {"orientation.w": 1.0}
PLACED: Fields = {"pose.pose.orientation.w": 1.0, "twist.twist.linear.x": 0.25}
MOCAP: Fields = {"pose.orientation.w": 1.0, "header.frame_id": "mocap"}
MOCAP_WIDE: Fields = {"pose.pose.orientation.w": 1.0, "header.frame_id": "mocap"}
FULL: Fields = {"voltage": 12.0, "percentage": 0.5, "current": -0.5}
EMPTY: Fields = {"voltage": 0.0, "percentage": 0.0, "present": False}
UNKNOWN: Fields = {"voltage": math.nan}
NEAR: Fields = {"range": 0.05, "min_range": 0.02, "max_range": 0.3}
FIX: Fields = {"latitude": 48.1, "longitude": 11.6}
FAR: Fields = {"ranges": [2.0] * 360, "angle_increment": math.tau / 360, "angle_max": 6.27,
               "range_min": 0.1, "range_max": 10.0}  # fmt: skip
PIXEL: Fields = {"detections": [{"bbox.center.position.x": 320.0, "bbox.size_y": 10.0}]}
TAG: Fields = {"detections": [{"centre.x": 320.0, "corners": [{"x": 1.0}, {}, {}, {}]}]}
AHEAD: Fields = {"detections": [{"bbox.center.position.z": 2.0, "bbox.size.x": 0.1}]}

# The options, the topic, the type, a message that measures, what makes it one that does not, and
# the words of the check.
CASES: list[tuple[Options, str, str, Fields, Fields, str]] = [
    (VOLTS, "battery", "BatteryState", FULL, EMPTY, "present"),
    (VOLTS, "battery", "BatteryState", FULL, {**EMPTY, **UNKNOWN}, "present"),
    (VOLTS, "battery", "BatteryState", FULL, {**EMPTY, "present": True}, "0 V"),
    (VOLTS, "battery", "BatteryState", FULL, {**UNKNOWN, "present": True}, "not measured"),
    (SHARE, "battery", "BatteryState", FULL, EMPTY, "present"),
    (SHARE, "battery", "BatteryState", FULL, {"voltage": 0.0}, "present"),
    (SHARE, "battery", "BatteryState", FULL, {**EMPTY, "present": True}, "0 V"),
    (reading("sensor_msgs/BatteryState", "current"), "readings.x", "BatteryState", FULL,
     EMPTY, "present"),
    ({"imu": "x"}, "imu", "Imu", UPRIGHT, {"orientation_covariance": covariance(-1.0)}, "-1"),
    ({"imu": "x"}, "imu", "Imu", UPRIGHT, {"orientation.w": 0.0}, "orientation"),
    *[(reading("sensor_msgs/Imu", f"{part}.z"), "readings.x", "Imu", {f"{part}.z": 0.5},
       {f"{part}_covariance": covariance(-1.0)}, "-1")
      for part in ("angular_velocity", "linear_acceleration")],
    (reading("sensor_msgs/MagneticField", "magnetic_field.x"), "readings.x", "MagneticField",
     {"magnetic_field.x": 1e-5}, {"magnetic_field_covariance": covariance(-1.0)}, "-1"),
    *[(reading(f"sensor_msgs/{kind}", field), "readings.x", kind, {field: 0.5},
       {"variance": -1.0}, "variance")
      for kind, field in (("Temperature", "temperature"), ("FluidPressure", "fluid_pressure"),
                          ("RelativeHumidity", "relative_humidity"),
                          ("Illuminance", "illuminance"))],
    *[(reading("sensor_msgs/NavSatFix", "latitude"), "readings.x", "NavSatFix", FIX,
       {"status.status": status}, "no fix") for status in (-1, -2)],
    (reading("sensor_msgs/NavSatFix", "latitude", stale_after="never"), "readings.x", "NavSatFix",
     FIX, {"latitude": math.nan}, "not finite"),
    *[(reading("sensor_msgs/Range", "range"), "readings.x", "Range", NEAR, far, words)
      for far, words in (({"range": 0.01}, "limits"), ({"range": 0.31}, "limits"),
                         ({"range": math.inf}, "not finite"), ({"range": -math.inf}, "not finite"),
                         ({"range": 0.0, "min_range": 0.0, "max_range": 0.0}, "0 m"))],
    (reading("sensor_msgs/LaserScan", "ranges.1"), "readings.x", "LaserScan", FAR,
     {"ranges": [0.0] * 360}, "limits"),
    (reading("sensor_msgs/Joy", "axes.1"), "readings.x", "Joy", {"axes": [0.0, 1.0]},
     {"axes": [0.0]}, "no item"),
    (FLOOR, "hazards.x", "Range", NEAR, {"range": 0.0}, "limits"),
    (FLOOR, "hazards.x", "Range", NEAR, {"range": math.nan}, "not finite"),
    (BOXES, "detections.x", "vision_msgs/Detection2DArray", PIXEL, {"detections": [{}]},
     "1 without"),
    (TAGS, "detections.x", "apriltag_msgs/AprilTagDetectionArray", TAG,
     {"detections": [{"corners": [{}] * 4}]}, "1 without"),
    (CLOUD, "detections.x", "vision_msgs/Detection3DArray", AHEAD, {"detections": [{}]},
     "1 without"),
    ({}, "odometry", "nav_msgs/Odometry", PLACED, {"pose.covariance": covariance(-1.0, 36)}, "-1"),
    ({}, "odometry", "nav_msgs/Odometry", PLACED, {"twist.covariance": covariance(-1.0, 36)}, "-1"),
    ({}, "odometry", "nav_msgs/Odometry", PLACED, {"pose.pose.orientation.w": 0.0}, "quaternion"),
    ({"shared_pose": "x"}, "shared_pose", "geometry_msgs/PoseStamped", MOCAP,
     {"pose.orientation.w": 0.0}, "quaternion"),
    ({"shared_pose": "x", "shared_pose_type": "pose_with_covariance"}, "shared_pose",
     "geometry_msgs/PoseWithCovarianceStamped", MOCAP_WIDE,
     {"pose.covariance": covariance(-1.0, 36)}, "negative"),
    ({}, "scan", "LaserScan", FAR, {"ranges": [0.0] * 360}, "ranges are 0"),
    ({}, "scan", "LaserScan", FAR, {"ranges": []}, " 0 rays"),
    ({}, "scan", "LaserScan", FAR, {"ranges": [math.nan] * 360}, "has a return"),
]  # fmt: skip


def values(sink: CollectingSink) -> int:
    """How many values a robot gets; hazards that are not heard, NaN and invalid scans are none."""
    some = [
        value
        for given in sink.taken["readings"]
        for value in given.values()
        if math.isfinite(value)
    ]
    known = [
        one
        for one in sink.taken["hazards"]
        if not any("not heard" in hazard.text for hazard in one)
    ]
    objects = [one for seen in sink.taken["detections"] for one in seen or ()]
    conditioner = ScanConditioner(robots.PLATFORM.scan)
    scans = [scan for scan in sink.scans if isinstance(conditioner.take(scan, None, 0.0), Scan)]
    kinds = some, known, objects, sink.odometries, sink.taken["pose"], scans
    return sum(len(one) for one in kinds)


def taken(
    subscriptions: Subscriptions, codec: ModuleType, topic: str, message: Any
) -> tuple[int, str]:
    """How many values a message gives, and the line of a check about its topic."""
    sink, stats = CollectingSink(), subscriptions.topics[topic]
    try:
        subscriptions.read(topic, codec.encode(message), 0.0)(sink)
    except CodecError as error:
        stats.record_fault(0.0, f"cannot be read: {error}")
    return values(sink), found(Ros2Dds(), subscriptions)[topic].text


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
@pytest.mark.parametrize(
    ("given", "topic", "name", "measured", "absent", "words"),
    CASES,
    ids=[f"{i}-{topic}-{name.rpartition('/')[2]}" for i, (_, topic, name, *_) in enumerate(CASES)],
)
def test_what_a_message_does_not_measure_is_no_reading_and_a_check_says_why(
    kind: type[TopicOptions], given: Options, topic: str, name: str,
    measured: Fields, absent: Fields, words: str, tmp_path: Any,
) -> None:  # fmt: skip
    path = {"message_path": str(detections_folder(tmp_path))} if "detections" in given else {}
    options = read_options(kind, {**given, **path}, "ros", "r")
    codec = cdr if kind is RosOptions else serialization
    full = name if "/" in name else f"sensor_msgs/{name}"
    for fields, is_measured in ((measured, True), ({**measured, **absent}, False)):
        subscriptions = Subscriptions(options, robots.PLATFORM, codec.decode)
        count, line = taken(subscriptions, codec, topic, filled(options, full, fields))
        assert (count > 0) is is_measured
        assert (words in line) is not is_measured


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
def test_a_battery_whose_driver_never_sets_present_keeps_its_voltage(
    kind: type[TopicOptions],
) -> None:
    options = read_options(kind, VOLTS, "ros", "r")
    codec = cdr if kind is RosOptions else serialization
    sink = CollectingSink()
    message = filled(options, "sensor_msgs/BatteryState", {"voltage": 11.8})
    Subscriptions(options, robots.PLATFORM, codec.decode).read(
        "battery", codec.encode(message), 0.0
    )(sink)
    assert sink.taken["readings"][-1] == pytest.approx({"battery": 0.5, "battery_voltage": 11.8})


@pytest.mark.parametrize(("metres", "is_cliff"), [(0.31, True), (math.inf, True), (0.05, False)])
def test_a_floor_sensor_that_sees_nothing_within_its_limits_is_over_a_cliff(
    metres: float, is_cliff: bool
) -> None:
    options = read_options(RosOptions, FLOOR, "ros", "r")
    message = filled(options, "sensor_msgs/Range", {**NEAR, "range": metres})
    sink = CollectingSink()
    Subscriptions(options, robots.PLATFORM).read("hazards.x", cdr.encode(message), 0.0)(sink)
    assert [hazard.kind for hazard in sink.taken["hazards"][-1]] == ["cliff"] * is_cliff


def test_the_page_has_each_type_that_says_so() -> None:
    page = (Path(__file__).parents[3] / "docs/ros.md").read_text()
    table = page.partition("### Messages that say that they measure nothing")[2].partition("###")[0]
    assert {kind for kinds, _ in _RULES for kind in kinds if f"`{kind}`" not in table} == set()

"""A robot's topics as values for a sink, for any payload."""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.errors import CodecError
from swarmd.core.values import Pose, SharedPose
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds
from tests.support.examples import examples
from tests.support.range_ring import with_ring

OPTIONS = RosOptions(imu="imu", battery="battery", battery_percentage="share", shared_pose="pose")
COVARIANT = RosOptions(shared_pose="/mocap/pose", shared_pose_type="pose_with_covariance")
RING = RosOptions(ranges={"a": 0.0, "b": (90.0, 0.1)})
singles, doubles = st.floats(width=32), st.floats()
vectors = st.builds(dds.Vector3, doubles, doubles, doubles)
turned = st.builds(dds.Quaternion, doubles, doubles, doubles, doubles)
twists = st.builds(dds.Twist, vectors, vectors)
messages = [
    ("scan", st.builds(dds.LaserScan, ranges=st.lists(singles), angle_min=singles,
                       angle_increment=singles)),
    ("odometry", st.builds(
        dds.Odometry,
        pose=st.builds(dds.PoseWithCovariance, st.builds(dds.Pose, vectors, turned)),
        twist=st.builds(dds.TwistWithCovariance, twists),
    )),
    ("shared_pose", st.builds(
        dds.PoseStamped,
        header=st.builds(dds.stamped, st.just(1.0), st.text()),
        pose=st.builds(dds.Pose, vectors, turned),
    )),
    ("imu", st.builds(dds.Imu, orientation=turned)),
    ("battery", st.builds(dds.BatteryState, voltage=singles, percentage=singles)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "values"), messages)
def test_any_payload_gives_a_value_or_one_error(name: str, values: st.SearchStrategy[Any]) -> None:
    @settings(max_examples=examples(150), deadline=None)
    @given(values)
    def check(value: Any) -> None:
        sink = CollectingSink()
        with suppress(CodecError):
            Subscriptions(OPTIONS, robots.PLATFORM).read(name, value.serialize(), 0.0)(sink)
        assert all(np.isfinite(scan.bearings).all() for scan in sink.scans)
        assert all(odometry.pose.is_finite for odometry in sink.odometries)
        assert all(pose.is_valid for pose in sink.taken["pose"])
        assert all(np.isfinite(list(values.values())).all() for values in sink.taken["readings"])

    check()


def covariant(*, x: float = 0.0, y: float = 0.0, xy: float = 0.0, yaw: float = 0.0) -> bytes:
    """A pose whose covariance has these elements."""
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[1, 1], covariance[5, 5] = x, y, yaw
    covariance[0, 1] = covariance[1, 0] = xy
    middle = dds.Pose(dds.Vector3(3.0, -4.0, 0.5), dds.Quaternion(0.0, 0.0, 1.0, 0.0))
    pose = dds.PoseWithCovariance(middle, covariance.ravel())
    header = dds.stamped(2.5, "/mocap")
    return bytes(dds.PoseWithCovarianceStamped(header=header, pose=pose).serialize())


def shared_pose(payload: bytes) -> SharedPose:
    sink = CollectingSink()
    Subscriptions(COVARIANT, robots.PLATFORM).read("shared_pose", payload, 0.0)(sink)
    pose: SharedPose = sink.taken["pose"][0]
    return pose


def test_a_shared_pose_has_the_errors_of_the_options_or_of_its_covariance_if_more() -> None:
    pose = shared_pose(covariant())
    assert (pose.stamp, pose.frame) == (2.5, "mocap")
    assert pose.pose == Pose(3.0, -4.0, math.pi)
    assert (pose.error, pose.yaw_error) == (0.05, math.radians(3.0))
    pose = shared_pose(covariant(x=0.01, y=0.01, xy=0.006, yaw=0.04))
    assert pose.error == pytest.approx(3.0 * math.sqrt(0.016))  # along the diagonal
    assert pose.yaw_error == pytest.approx(0.6)


@pytest.mark.parametrize(
    "payload",
    [covariant(x=-1.0), covariant(xy=0.1), covariant(yaw=-1.0), covariant(y=math.nan),
     covariant(yaw=math.inf), covariant(x=1e9)],
)  # fmt: skip
def test_a_covariance_without_sense_is_refused(payload: bytes) -> None:
    with pytest.raises(CodecError):
        shared_pose(payload)


def test_only_scans_and_odometry_count_as_a_sign_of_life() -> None:
    subscriptions = Subscriptions(OPTIONS, robots.PLATFORM)
    subscriptions.read("battery", dds.BatteryState().serialize(), 5.0)
    assert subscriptions.last_arrival < 0.0
    subscriptions.read("odometry", robots.odometry(1.0).serialize(), 6.0)
    assert subscriptions.last_arrival == 6.0


def test_a_needed_silent_topic_is_missing() -> None:
    subscriptions = Subscriptions(OPTIONS, robots.PLATFORM)
    assert [sense.name for sense in subscriptions.silent(0.0, 2.0)] == ["scan", "odometry"]
    subscriptions.read("scan", robots.scan(1.0).serialize(), 0.0)
    assert [sense.name for sense in subscriptions.silent(1.0, 2.0)] == ["odometry"]
    assert [sense.name for sense in subscriptions.silent(3.0, 2.0)] == ["scan", "odometry"]


def test_a_ring_replaces_the_scan() -> None:
    subscriptions, sink = Subscriptions(RING, robots.PLATFORM), CollectingSink()
    assert "scan" not in subscriptions.topics
    for name, metres in (("ranges.a", 0.5), ("ranges.b", 0.25)):
        message = dds.OlderRange(header=dds.stamped(1.0), range=metres)
        subscriptions.read(name, message.serialize(), 0.0)(sink)
    assert sink.scans[0].ranges.tolist() == pytest.approx([0.5, 0.35])


def test_a_lidar_and_a_ring_are_two_scans_of_a_platform_that_has_both() -> None:
    platform = with_ring(robots.PLATFORM)
    subscriptions, sink = Subscriptions(RING, platform), CollectingSink()
    assert [one for one in subscriptions.topics if one != "odometry"] == [
        "scan",
        "ranges.a",
        "ranges.b",
    ]
    subscriptions.read("scan", robots.scan(1.0).serialize(), 0.0)(sink)
    for name, metres in (("ranges.a", 0.5), ("ranges.b", 0.25)):
        message = dds.OlderRange(header=dds.stamped(1.0), range=metres)
        subscriptions.read(name, message.serialize(), 0.0)(sink)
    assert [len(scan.ranges) for scan in sink.scans] == [360]
    (ring,) = sink.rings
    assert ring.ranges.tolist() == np.array([0.5, 0.35], np.float32).tolist()
    assert ring.bearings.tolist() == pytest.approx([0.0, math.pi / 2.0])
    assert platform.ranges is not None
    assert (ring.range_min, ring.range_max) == (0.05, 1.0)
    assert sink.scans[0].range_max == platform.scan.range_max
    assert subscriptions.scan is sink.scans[0]


def test_readings_of_several_sensors_are_delivered_together() -> None:
    subscriptions, sink = Subscriptions(OPTIONS, robots.PLATFORM), CollectingSink()
    subscriptions.read("imu", dds.Imu().serialize(), 0.0)(sink)
    battery = dds.BatteryState(voltage=12.0, percentage=0.5)
    subscriptions.read("battery", battery.serialize(), 0.0)(sink)
    assert sink.taken["readings"][-1] == {"yaw": 0.0, "battery": 0.5, "battery_voltage": 12.0}
    for orientation in (dds.Quaternion(w=0.0), dds.Quaternion(w=math.nan)):
        subscriptions.read("imu", dds.Imu().serialize(), 1.0)(sink)
        with suppress(CodecError):
            subscriptions.read("imu", dds.Imu(orientation=orientation).serialize(), 2.0)(sink)
        subscriptions.deliver_inputs(sink, 2.1)
        assert "yaw" not in sink.taken["readings"][-1], "the one before does not count any more"


def test_the_lidars_turn_is_in_degrees_counted_to_the_left() -> None:
    sink = CollectingSink()
    turned = Subscriptions(RosOptions(scan_yaw_deg=90.0), robots.PLATFORM)
    turned.read("scan", robots.scan(1.0, [1.0] * 4).serialize(), 0.0)(sink)
    assert np.degrees(sink.scans[0].bearings[:2]).tolist() == pytest.approx([90.0, -180.0])


def test_a_topic_is_silent_after_more_than_the_timeout() -> None:
    subscriptions = Subscriptions(OPTIONS, robots.PLATFORM)
    for name, message in (("scan", robots.scan(1.0)), ("odometry", robots.odometry(1.0))):
        subscriptions.read(name, message.serialize(), 10.0)
    assert not subscriptions.silent(12.0, 2.0)
    assert len(subscriptions.silent(12.001, 2.0)) == 2


@pytest.mark.parametrize(
    ("options", "subject"),
    [
        (RosOptions(battery="battery"), "battery_volts"),
        (RosOptions(battery="battery", battery_percentage="share"), "71"),
    ],
)
def test_a_check_says_why_a_battery_has_no_share(options: RosOptions, subject: str) -> None:
    subscriptions = Subscriptions(options, robots.PLATFORM)
    message = dds.BatteryState(voltage=12.0, percentage=71.0)
    subscriptions.read("battery", message.serialize(), 1.0)
    assert "battery_voltage 12" in subscriptions.topics["battery"].summary
    assert subject in subscriptions.topics["battery"].summary


def test_a_signalling_nan_of_a_scan_is_unknown() -> None:
    """numpy warns of it where it becomes a quiet one; warnings are errors here."""
    subscriptions = Subscriptions(RosOptions(), robots.PLATFORM)
    payload = robots.scan(1.0, [2.0, math.nan, 3.0]).serialize()
    signalling = payload.replace(struct.pack("<f", math.nan), b"\x01\x00\xa0\x7f")
    assert signalling != payload
    sink = CollectingSink()
    subscriptions.read("scan", signalling, 1.0)(sink)
    np.testing.assert_array_equal(sink.scans[-1].ranges, [2.0, math.nan, 3.0])


@pytest.mark.parametrize("end", ["uncertain", "gone", "another topic"])
def test_a_pose_ends_with_its_localisation(end: str) -> None:
    """A base at rest, at 2.5 s; the localisation says then that it is lost, or its node ends."""
    subscriptions, sink = Subscriptions(COVARIANT, robots.PLATFORM), CollectingSink()

    def rest(stamp: float) -> int:
        """The number of poses after one more reading of odometry."""
        odometry = dds.Odometry(header=dds.stamped(stamp, "odom")).serialize()
        subscriptions.read("odometry", odometry, stamp)(sink)
        return len(sink.taken["pose"])

    for tick in range(60):
        rest(0.05 * tick)
    subscriptions.read("shared_pose", covariant(), 3.0)(sink)
    before = rest(3.0)
    assert rest(3.05) == before + 1
    if end == "uncertain":
        with pytest.raises(CodecError):
            subscriptions.read("shared_pose", covariant(x=1e9), 3.1)
    else:
        subscriptions.forget("/mocap/pose" if end == "gone" else "/bumper")
    assert rest(3.1) == before + (2 if end == "another topic" else 1)

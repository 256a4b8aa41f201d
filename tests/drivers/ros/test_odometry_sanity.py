"""Odometry and poses that no base can have: refused with the value, or told of in the check."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

import pytest

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.drivers.ros import cdr, from_ros, messages
from swarmd.drivers.ros.diagnosis import DriverCheck, Graph, rare_odometry
from swarmd.drivers.ros.foreign_commands import ROS2_ACTIONS, ForeignCommands
from swarmd.drivers.ros.odometry_jumps import JUMP_TIME, OdometryJumps
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.master_graph import Ros1
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds

UP = (0.0, 0.0, 0.0, 1.0)


def message(
    x: float = 0.5,
    orientation: Sequence[float] = UP,
    speed: float = 0.1,
    rate: float = 0.0,
    nanosec: int = 0,
    sec: int = 5,
) -> messages.Odometry:
    """An Odometry as ROS nodes send it."""
    made = cdr.decode(messages.Odometry, bytes(robots.odometry(5.0, x=x, speed=speed).serialize()))
    made.pose.pose.orientation = messages.Quaternion(*orientation)
    made.twist.twist.angular = messages.Vector3(0.0, 0.0, rate)
    made.header.stamp = messages.Time(sec, nanosec)
    return made


def tilted(deg: float, yaw: float = 0.4) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation by `deg` about x, and then by `yaw` about z."""
    half, turn = math.radians(deg) / 2.0, yaw / 2.0
    return (
        math.sin(half) * math.cos(turn),
        math.sin(half) * math.sin(turn),
        math.cos(half) * math.sin(turn),
        math.cos(half) * math.cos(turn),
    )


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"x": 1e256}, "1e+256"),
        ({"x": -1.1e9}, "-1.1e+09"),
        ({"x": math.nan}, "nan"),
        ({"x": math.inf}, "inf"),
        ({"speed": 101.0}, "101"),
        ({"rate": -250.0}, "-250"),
        ({"speed": math.nan}, "nan"),
        ({"nanosec": 1_000_000_000}, "1000000000"),
        ({"nanosec": 1_700_000_000}, "1700000000"),
        ({"orientation": (0.0, 0.0, 0.0, 0.0)}, "(0, 0, 0, 0)"),
        ({"orientation": (0.0, 0.0, 0.0, 1.2)}, "1.2"),
        ({"orientation": (math.nan, 0.0, 0.0, 1.0)}, "nan"),
        ({"orientation": (0.0, 0.0, 0.0, math.inf)}, "inf"),
        ({"orientation": tilted(57.0)}, "57 deg"),
        ({"orientation": tilted(90.0)}, "90 deg"),  # y up, as trackers have it
        ({"orientation": tilted(180.0)}, "180 deg"),
    ],
    ids=str,
)
def test_odometry_that_no_base_has_is_refused_with_its_value(
    fields: dict[str, float], told: str
) -> None:
    with pytest.raises(CodecError) as raised:
        from_ros.odometry_of(message(**fields))  # type: ignore[arg-type]
    assert told in str(raised.value)


@pytest.mark.parametrize("deg", [0.0, 12.0, 44.0])
def test_a_base_on_a_slope_has_its_yaw(deg: float) -> None:
    odometry = from_ros.odometry_of(message(orientation=tilted(deg)))
    assert odometry.pose.yaw == pytest.approx(0.4)


@pytest.mark.parametrize("sec", [0, -1, -(2**31), 2**31 - 1])
def test_seconds_of_a_stamp_are_any_and_nanoseconds_below_a_second(sec: int) -> None:
    assert from_ros.odometry_of(message(sec=sec, nanosec=999_999_999)).stamp == pytest.approx(
        sec + 0.999999999
    )


@pytest.mark.parametrize("deg", [57.0, 90.0])
def test_a_shared_pose_of_a_tracker_with_y_up_is_refused_with_its_tilt(deg: float) -> None:
    pose = dds.PoseStamped(
        header=dds.stamped(1.0, "map"),
        pose=dds.Pose(dds.Vector3(1.0, 2.0), dds.Quaternion(*tilted(deg))),
    )
    topics = Subscriptions(RosOptions(shared_pose="pose"), robots.PLATFORM)
    with pytest.raises(CodecError, match=f"{deg:.0f} deg"):
        topics.read("shared_pose", bytes(pose.serialize()), 0.0)


def test_a_stamp_of_ros_1_with_too_many_nanoseconds_is_refused() -> None:
    """A Header (seq, secs, nsecs, frame_id), and the rest of an Odometry of zeros with w = 1."""
    rest = struct.pack("<I", 0) + struct.pack("<7d", 0, 0, 0, 0, 0, 0, 1) + bytes(36 * 8)
    rest += struct.pack("<6d", *[0] * 6) + bytes(36 * 8)
    for nsecs, is_good in ((999_999_999, True), (1_500_000_000, False)):
        payload = struct.pack("<IIII", 0, 7, nsecs, 0) + rest
        topics = Subscriptions(Ros1Options(), robots.PLATFORM, serialization.decode)
        if is_good:
            topics.read("odometry", payload, 0.0)
        else:
            with pytest.raises(CodecError, match="1500000000"):
                topics.read("odometry", payload, 0.0)


def reading(stamp: float, x: float = 0.0, yaw: float = 0.0) -> Odometry:
    return Odometry(stamp, Pose(x, 0.0, yaw), Twist(0.2))


@pytest.mark.parametrize(
    ("after", "told"),
    [
        (reading(1.05, 0.01), ""),
        (reading(1.05, 0.99), ""),  # of 1 m that such a base might move
        (reading(1.05, 28.5), "28.5 m"),
        (reading(1.05, 0.0, 1.5), "86 deg"),
        (reading(1.0, 0.6), "0.6 m"),  # in no time
        (reading(3.0, 20.0), ""),  # in 2 s
        (reading(0.5, 28.5), ""),  # the clock was set: told by its stamps
    ],
)
def test_a_jump_that_no_base_makes_is_told_with_its_size(after: Odometry, told: str) -> None:
    jumps = OdometryJumps()
    assert jumps.take(reading(1.0), 10.0) == ""
    text = jumps.take(after, 10.05)
    assert told in text
    assert bool(text) == bool(told)


def test_a_jump_is_told_for_half_a_minute() -> None:
    jumps = OdometryJumps()
    jumps.take(reading(1.0), 10.0)
    assert jumps.take(reading(1.05, 28.5), 10.05)
    assert jumps.take(reading(31.0, 28.5), 10.05 + JUMP_TIME - 0.01)
    assert jumps.take(reading(31.1, 28.5), 10.05 + JUMP_TIME + 0.01) == ""


def checked(topics: Subscriptions, now: float, ros: Ros1 | Ros2Dds) -> Finding:
    """What a check says of odometry."""
    options = TopicOptions()
    check = DriverCheck(
        graph=Graph(middleware=ros, options=options, now=now),
        endpoint="here",
        subscriptions=topics,
        spec=robots.PLATFORM.scan,
        cmd_vel="/cmd_vel",
        command_types=(messages.Twist,),
        has_subscriber=True,
        foreign=ForeignCommands(options, ROS2_ACTIONS),
        now=now,
    )
    (one,) = (one for one in check.findings() if one.subject == "odometry")
    return one


@pytest.mark.parametrize(
    ("second", "told"),
    [
        (lambda stamp: robots.odometry(stamp), ""),
        (lambda stamp: robots.odometry(stamp, x=1e256), "1e+256"),
        (lambda stamp: robots.odometry(stamp, x=29.0), "28.5 m"),
    ],
    ids=["good", "too far", "jump"],
)
@pytest.mark.parametrize("ros", [Ros1(), Ros2Dds()], ids=["ros1", "ros2"])
def test_a_check_tells_of_odometry_that_cannot_be(
    ros: Ros1 | Ros2Dds, second: Callable[[float], dds.Odometry], told: str
) -> None:
    topics = Subscriptions(TopicOptions(), robots.PLATFORM)
    now = 10.0
    for count in range(20):
        now = 10.0 + 0.05 * count
        made = robots.odometry(now) if count != 15 else second(now)
        try:
            topics.read("odometry", bytes(made.serialize()), now)
        except CodecError as error:  # as a driver does
            topics.topics["odometry"].record_fault(now, str(error))
    finding = checked(topics, now, ros)
    assert finding.is_well == (not told)
    assert told in finding.text


@pytest.mark.parametrize(("rate", "is_rare"), [(1.0, True), (1.9, True), (2.1, False)])
def test_odometry_that_is_older_than_permitted_between_two_readings_is_rare(
    rate: float, is_rare: bool
) -> None:
    """docs/safety.md: odometry counts for 0.5 s."""
    stats = TopicStats("odometry", "odometry", "/odom", messages.Odometry, is_needed=True)
    for n in range(10):
        stats.record(n / rate, n / rate)
    assert bool(rare_odometry(stats)) is is_rare

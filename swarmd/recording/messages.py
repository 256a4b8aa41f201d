"""The ROS 2 messages of a recording: definitions, and conversion from and to swarmd's values.

A value that ROS has a message for is written as that message; the others have definitions of
their own in `swarmd_msgs`. All are in CDR, the encoding of ROS 2, with their definitions in the
file, so that a viewer needs nothing installed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from swarmd.core.errors import CodecError
from swarmd.core.values import Array, Neighbor, Odometry, Pose, Scan, SharedPose, Twist
from swarmd.recording.frames import DecisionEntry

_EMPTY = np.zeros(0)
LASER_SCAN = "sensor_msgs/msg/LaserScan"

OWN = {
    "ScanGeometry": (
        "std_msgs/Header header\nfloat64[] bearings\nfloat64[] ages\n"
        "float64 range_min\nfloat64 range_max"
    ),
    "Neighbors": (
        "std_msgs/Header header\nstring[] robots\n"
        "float64[] distances\nfloat64[] bearings\nfloat64[] headings"
    ),
    "SharedPose": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\nfloat64 error\nfloat64 yaw_error"
    ),
    "Readings": "std_msgs/Header header\nstring[] names\nfloat64[] values",
    "DriverState": ("std_msgs/Header header\nbool is_up\nstring text\nstring hold\nbool gets_zero"),
    "Requested": "std_msgs/Header header\ngeometry_msgs/Twist twist\nint64 scan_seq",
    "Decision": (
        "std_msgs/Header header\nstring cause\nstring state\nstring reason\nstring mode\n"
        "geometry_msgs/Twist requested\ngeometry_msgs/Twist safe\nint64 scan_seq\n"
        "bool is_active\nbool is_recovering\nfloat64 speed_share\n"
        "float64 gap\nfloat64 scan_age\n"
        "float64[] bearings\nfloat64[] gaps\nfloat64[] caps"
    ),
    "Text": "std_msgs/Header header\nstring json",
    "Bytes": "std_msgs/Header header\nuint8[] data",
}
"""The definitions of `swarmd_msgs`. NaN: not measured. `Text`: a value as JSON.
`Bytes`: MessagePack that only a replay reads."""


@lru_cache(maxsize=1)
def store() -> Typestore:
    """The definitions of ROS 2 Jazzy and of `swarmd_msgs`."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN.items():
        types.register(get_types_from_msg(text, f"swarmd_msgs/msg/{name}"))
    return types


def definition(kind: str) -> bytes:
    """The definition of a message type, with those that it contains."""
    return store().generate_msgdef(kind, ros_version=2)[0].encode()


def serialize(message: Any) -> bytes:
    """The bytes of a message."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


def deserialize(kind: str, payload: bytes) -> Any:
    """The message of a type; CodecError if the bytes are malformed."""
    try:
        return store().deserialize_cdr(payload, kind)
    except (SerdeError, ValueError, IndexError) as error:
        raise CodecError(f"not a {kind}: {error}") from error


def new(kind: str, stamp: float = 0.0, frame: str = "", **fields: Any) -> Any:
    """A message with a header of a stamp in s; `swarmd_msgs` need no package in `kind`."""
    types = store().types
    seconds = math.floor(stamp)
    time = types["builtin_interfaces/msg/Time"](int(seconds), round((stamp - seconds) * 1e9))
    header = types["std_msgs/msg/Header"](time, frame)
    name = kind if "/" in kind else f"swarmd_msgs/msg/{kind}"
    return types[name](header=header, **fields)


def stamp_of(message: Any) -> float:
    """The stamp of a message's header in s."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def twist_message(twist: Twist) -> Any:
    """A geometry_msgs/Twist."""
    types = store().types
    vector = types["geometry_msgs/msg/Vector3"]
    return types["geometry_msgs/msg/Twist"](
        linear=vector(twist.linear, twist.lateral, 0.0), angular=vector(0.0, 0.0, twist.angular)
    )


def twist_of(message: Any) -> Twist:
    """The twist of a geometry_msgs/Twist."""
    return Twist(message.linear.x, message.angular.z, message.linear.y)


def scan_message(scan: Scan) -> Any:
    """A sensor_msgs/LaserScan. Its angles are rounded; `geometry_message` has the exact ones."""
    count = len(scan.ranges)
    ages = scan.ages if count > 1 else None
    first, last = (float(scan.bearings[0]), float(scan.bearings[-1])) if count else (0.0, 0.0)
    return new(
        LASER_SCAN,
        scan.stamp,
        "scan",
        angle_min=first,
        angle_max=last,
        angle_increment=float(scan.bearings[1]) - first if count > 1 else 0.0,
        time_increment=0.0 if ages is None else float(ages[0] - ages[1]),
        scan_time=0.0 if ages is None else float(ages.max()),
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=scan.ranges.astype(np.float32),
        intensities=np.zeros(0, np.float32),
    )


def geometry_message(scan: Scan) -> Any:
    """The exact directions and ages of a scan's rays; no ages where the sensor gives none."""
    ages = np.zeros(0) if scan.ages is None else scan.ages
    return new(
        "ScanGeometry",
        scan.stamp,
        "scan",
        bearings=scan.bearings,
        ages=ages,
        range_min=scan.range_min,
        range_max=scan.range_max,
    )


def scan_of(message: Any, seq: int, geometry: Any | None) -> Scan:
    """The scan of a LaserScan with its geometry; None: by the message's own rounded angles."""
    ranges, stamp = message.ranges.astype(np.float64), stamp_of(message)
    if geometry is not None:
        ages = np.array(geometry.ages) if len(geometry.ages) else None
        limits = geometry.range_min, geometry.range_max
        return Scan(seq, stamp, ranges, np.array(geometry.bearings), *limits, ages)
    bearings = message.angle_min + message.angle_increment * np.arange(len(ranges))
    return Scan(seq, stamp, ranges, bearings, message.range_min, message.range_max)


def odometry_message(odometry: Odometry) -> Any:
    """A nav_msgs/Odometry, with covariances of zero: unknown."""
    types, pose = store().types, odometry.pose
    placed = types["geometry_msgs/msg/PoseWithCovariance"](_pose_message(pose), np.zeros(36))
    moving = types["geometry_msgs/msg/TwistWithCovariance"](
        twist_message(odometry.twist), np.zeros(36)
    )
    return new(
        "nav_msgs/msg/Odometry",
        odometry.stamp,
        "odom",
        child_frame_id="base_link",
        pose=placed,
        twist=moving,
    )


def odometry_of(message: Any) -> Odometry:
    """The odometry of a nav_msgs/Odometry; its yaw within 1e-15 rad, and within one turn."""
    return Odometry(stamp_of(message), _pose_of(message.pose.pose), twist_of(message.twist.twist))


def neighbors_message(neighbors: tuple[Neighbor, ...], stamp: float) -> Any:
    """The robots within radio range."""
    return new(
        "Neighbors",
        stamp,
        robots=[one.id for one in neighbors],
        distances=_optional(one.distance for one in neighbors),
        bearings=_optional(one.bearing for one in neighbors),
        headings=_optional(one.heading for one in neighbors),
    )


def neighbors_of(message: Any) -> tuple[Neighbor, ...]:
    """The robots within radio range; their age is 0, counted from arrival."""
    columns = message.distances, message.bearings, message.headings
    rows = zip(*(column.tolist() for column in columns), strict=True)
    sensed = [tuple(None if math.isnan(value) else value for value in row) for row in rows]
    return tuple(
        Neighbor(robot, 0.0, *values) for robot, values in zip(message.robots, sensed, strict=True)
    )


def pose_message(shared: SharedPose) -> Any:
    """A pose in a shared frame."""
    return new(
        "SharedPose",
        shared.stamp,
        shared.frame,
        pose=_pose_message(shared.pose),
        error=shared.error,
        yaw_error=shared.yaw_error,
    )


def pose_of(message: Any) -> SharedPose:
    """The pose in a shared frame."""
    return SharedPose(
        stamp_of(message),
        _pose_of(message.pose),
        message.error,
        message.yaw_error,
        message.header.frame_id,
    )


def readings_message(values: Mapping[str, float], stamp: float) -> Any:
    """Scalar sensors by name."""
    return new(
        "Readings", stamp, names=list(values), values=np.array(list(values.values()), np.float64)
    )


def readings_of(message: Any) -> dict[str, float]:
    """Scalar sensors by name."""
    return dict(zip(message.names, message.values.tolist(), strict=True))


def requested_message(twist: Twist, scan_seq: int, stamp: float) -> Any:
    """The command that a pattern requested."""
    return new("Requested", stamp, "base_link", twist=twist_message(twist), scan_seq=scan_seq)


def decision_message(entry: DecisionEntry, stamp: float) -> Any:
    """A decision of protection with the obstacles that limit it."""
    one = entry.decision
    columns = zip(*((row.bearing, row.gap, row.cap) for row in one.rows), strict=True)
    bearings, gaps, caps = (np.array(column) for column in columns) if one.rows else [_EMPTY] * 3
    return new(
        "Decision",
        stamp,
        "base_link",
        cause=entry.cause,
        state=entry.state,
        reason=entry.reason,
        mode=one.mode,
        requested=twist_message(one.requested),
        safe=twist_message(one.safe),
        scan_seq=one.scan_seq,
        is_active=one.is_active,
        is_recovering=one.is_recovering,
        speed_share=one.speed_share,
        gap=math.nan if one.min_gap is None else one.min_gap,
        scan_age=math.nan if one.scan_age is None else one.scan_age,
        bearings=bearings,
        gaps=gaps,
        caps=caps,
    )


def log_message(text: str, robot: str, stamp: float) -> Any:
    """A line of the robot's log, as an rcl_interfaces/Log of level info."""
    seconds = math.floor(stamp)
    types = store().types
    time = types["builtin_interfaces/msg/Time"](int(seconds), round((stamp - seconds) * 1e9))
    return types["rcl_interfaces/msg/Log"](time, 20, robot, text, "", "", 0)


def _pose_message(pose: Pose) -> Any:
    types = store().types
    return types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](pose.x, pose.y, 0.0),
        types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, math.sin(0.5 * pose.yaw), math.cos(0.5 * pose.yaw)
        ),
    )


def _pose_of(message: Any) -> Pose:
    turn = message.orientation
    yaw = 2.0 * math.atan2(turn.z, turn.w)
    return Pose(message.position.x, message.position.y, math.remainder(yaw, 2.0 * math.pi))


def _optional(values: Iterable[float | None]) -> Array:
    return np.array([math.nan if value is None else value for value in values], np.float64)

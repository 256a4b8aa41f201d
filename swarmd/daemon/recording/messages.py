"""The ROS 2 messages of a recording: definitions, and conversion from and to swarmd's values.

A value is written as the ROS message for such values; values without a ROS message have definitions
in the package `swarmd_msgs`. All messages are in CDR, the encoding of ROS 2. The file contains all
definitions, so that a viewer needs no installed packages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, get_args

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from swarmd.core.errors import CodecError
from swarmd.core.events import DriverInput, SensorInput
from swarmd.core.values import Array, Neighbor, Odometry, Pose, Scan, SharedPose, Twist
from swarmd.daemon.recording.cdr import CdrWriter, Message
from swarmd.daemon.recording.frames import ClockEntry, DecisionEntry

_EMPTY = np.zeros(0)
_NO_INTENSITIES = np.zeros(0, np.float32)
_UNKNOWN = (0.0,) * 36
LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOCK_PAIR = "swarmd_msgs/msg/ClockPair"
TEXT = "swarmd_msgs/msg/Text"

OWN = {
    "ScanGeometry": (
        "std_msgs/Header header\nfloat64[] bearings\nfloat64[] ages\n"
        "float64 range_min\nfloat64 range_max"
    ),
    "Neighbors": (
        "std_msgs/Header header\nstring[] robots\n"
        "float64[] distances\nfloat64[] bearings\nfloat64[] headings\nuint8[] in_reach"
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
        "bool is_active\nbool is_recovering\nstring avoiding\nfloat64 speed_share\n"
        "float64 gap\nfloat64 scan_age\n"
        "float64[] bearings\nfloat64[] gaps\nfloat64[] caps"
    ),
    "ClockPair": (
        "std_msgs/Header header\nstring peer\nstring peer_clock\n"
        "float64 sent\nfloat64 answered\nfloat64 returned"
    ),
    "Text": "std_msgs/Header header\nstring json",
    "Bytes": "std_msgs/Header header\nuint8[] data",
    "Input": "std_msgs/Header header\nfloat64 now\nuint8[] data",
}
"""The definitions of `swarmd_msgs`. NaN: not measured. `Text`: a value as JSON.
`Bytes`, `Input`: MessagePack that only a replay reads. `now`: s on the robot's clock."""


_TYPES: Mapping[str, str] = {
    **{kind.__struct_config__.tag: TEXT for kind in get_args(SensorInput)},  # but for those below
    **dict.fromkeys(("status", "incident", "lost"), TEXT),
    "input": "swarmd_msgs/msg/Input",
    "memory": "swarmd_msgs/msg/Bytes",
    **dict.fromkeys(("scan", "ranges"), LASER_SCAN),
    **dict.fromkeys(("scan/geometry", "ranges/geometry"), "swarmd_msgs/msg/ScanGeometry"),
    "odometry": ODOMETRY,
    "neighbors": "swarmd_msgs/msg/Neighbors",
    "pose": "swarmd_msgs/msg/SharedPose",
    "readings": "swarmd_msgs/msg/Readings",
    "driver": "swarmd_msgs/msg/DriverState",
    "decision": "swarmd_msgs/msg/Decision",
    "event": "rcl_interfaces/msg/Log",
    "clock/pair": CLOCK_PAIR,
}
"""The types of the messages that are read again, by topic."""


@lru_cache(maxsize=1)
def store() -> Typestore:
    """The definitions of ROS 2 Jazzy and of `swarmd_msgs`."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN.items():
        types.register(get_types_from_msg(text, f"swarmd_msgs/msg/{name}"))
    return types


def is_known(kind: str) -> bool:
    """True for a message type with a definition here."""
    return kind in store().fielddefs


def definition(kind: str) -> bytes:
    """The definition of a message type, with those that it contains."""
    return store().generate_msgdef(kind, ros_version=2)[0].encode()


def message_on(topic: str, kind: str, payload: bytes) -> Any:
    """The message on a topic of a recording; CodecError if it is malformed or of another type."""
    wanted = _TYPES.get(topic.removeprefix("/"), "no such topic")
    if kind != wanted:
        raise CodecError(f"a message of type {kind[:80]!r}; expected {wanted}")
    return deserialize(kind, payload)


def deserialize(kind: str, payload: bytes) -> Any:
    """The message of a type; CodecError if the bytes are malformed."""
    try:
        return store().deserialize_cdr(payload, kind)
    except (SerdeError, ValueError, IndexError) as error:
        raise CodecError(f"not a {kind}: {error}") from error


def stamp_of(message: Any) -> float:
    """The stamp of a message's header in s."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def twist_of(message: Any) -> Twist:
    """The twist of a geometry_msgs/Twist."""
    return Twist(message.linear.x, message.angular.z, message.linear.y)


def scan_message(scan: Scan) -> Message:
    """A sensor_msgs/LaserScan. Its angles are rounded; `geometry_message` has the exact ones."""
    count = len(scan.ranges)
    ages = scan.ages if count > 1 else None
    first, last = (float(scan.bearings[0]), float(scan.bearings[-1])) if count else (0.0, 0.0)
    step = float(scan.bearings[1]) - first if count > 1 else 0.0
    time_step = 0.0 if ages is None else float(ages[0] - ages[1])
    duration = 0.0 if ages is None else float(ages.max())
    cdr = CdrWriter().header(scan.stamp, "scan")
    cdr.floats(first, last, step, time_step, duration, scan.range_min, scan.range_max)
    cdr.array(scan.ranges.astype("<f4")).array(_NO_INTENSITIES)
    return cdr.as_message(LASER_SCAN)


def geometry_message(scan: Scan) -> Message:
    """The exact directions and ages of a scan's rays; without ages if the scan has none."""
    ages = _EMPTY if scan.ages is None else scan.ages
    cdr = CdrWriter().header(scan.stamp, "scan").array(scan.bearings).array(ages)
    return cdr.doubles(scan.range_min, scan.range_max).as_message("ScanGeometry")


def scan_of(message: Any, seq: int, geometry: Any | None) -> Scan:
    """The scan of a LaserScan with its geometry; None: use the rounded angles of the message."""
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        ranges = message.ranges.astype(np.float64)
        stamp = stamp_of(message)
    if geometry is not None:
        ages = np.array(geometry.ages) if len(geometry.ages) else None
        limits = geometry.range_min, geometry.range_max
        return Scan(seq, stamp, ranges, np.array(geometry.bearings), *limits, ages)
    bearings = message.angle_min + message.angle_increment * np.arange(len(ranges))
    return Scan(seq, stamp, ranges, bearings, message.range_min, message.range_max)


def geometry_of(message: Any) -> Scan:
    """A scan with the directions and ages of this geometry, and no ranges."""
    ages = np.array(message.ages) if len(message.ages) else None
    limits = message.range_min, message.range_max
    return Scan(-1, 0.0, _EMPTY, np.array(message.bearings), *limits, ages)


def odometry_message(odometry: Odometry) -> Message:
    """A nav_msgs/Odometry, with covariances of zero: unknown."""
    cdr = CdrWriter().header(odometry.stamp, "odom").text("base_link")
    cdr.doubles(*_pose(odometry.pose), *_UNKNOWN, *_twist(odometry.twist), *_UNKNOWN)
    return cdr.as_message(ODOMETRY)


def odometry_of(message: Any) -> Odometry:
    """The odometry of a nav_msgs/Odometry; the yaw is exact to 1e-15 rad, modulo one turn."""
    return Odometry(stamp_of(message), _pose_of(message.pose.pose), twist_of(message.twist.twist))


def neighbors_message(neighbors: tuple[Neighbor, ...], stamp: float) -> Message:
    """The robots that are sensed or heard."""
    cdr = CdrWriter().header(stamp, "").texts([neighbor.id for neighbor in neighbors])
    cdr.array(_optional(neighbor.distance for neighbor in neighbors))
    cdr.array(_optional(neighbor.bearing for neighbor in neighbors))
    cdr.array(_optional(neighbor.heading for neighbor in neighbors))
    return cdr.array(bytes(neighbor.in_reach for neighbor in neighbors)).as_message("Neighbors")


def neighbors_of(message: Any) -> tuple[Neighbor, ...]:
    """The robots that are sensed or heard; their age is 0, counted from arrival."""
    columns = (
        column.tolist() for column in (message.distances, message.bearings, message.headings)
    )
    sensed = ([None if math.isnan(value) else value for value in column] for column in columns)
    rows = zip(message.robots, *sensed, message.in_reach, strict=True)
    return tuple(
        Neighbor(robot, 0.0, distance, bearing, heading, bool(near))
        for robot, distance, bearing, heading, near in rows
    )


def pose_message(shared: SharedPose) -> Message:
    """A pose in a shared frame."""
    cdr = CdrWriter().header(shared.stamp, shared.frame)
    cdr.doubles(*_pose(shared.pose), shared.error, shared.yaw_error)
    return cdr.as_message("SharedPose")


def pose_of(message: Any) -> SharedPose:
    """The pose in a shared frame."""
    return SharedPose(
        stamp_of(message),
        _pose_of(message.pose),
        message.error,
        message.yaw_error,
        message.header.frame_id,
    )


def readings_message(values: Mapping[str, float], stamp: float) -> Message:
    """Scalar sensors by name."""
    cdr = CdrWriter().header(stamp, "").texts(list(values))
    return cdr.array(np.array(list(values.values()), np.float64)).as_message("Readings")


def readings_of(message: Any) -> dict[str, float]:
    """Scalar sensors by name."""
    return dict(zip(message.names, message.values.tolist(), strict=True))


def requested_message(twist: Twist, scan_seq: int, stamp: float) -> Message:
    """The command that a pattern requested."""
    cdr = CdrWriter().header(stamp, "base_link").doubles(*_twist(twist)).int64(scan_seq)
    return cdr.as_message("Requested")


def driver_message(entry: DriverInput, stamp: float) -> Message:
    """The state of the base."""
    cdr = CdrWriter().header(stamp, "").uint8(entry.is_up).text(entry.text)
    return cdr.text(entry.hold or "").uint8(entry.gets_zero).as_message("DriverState")


def clock_message(entry: ClockEntry, stamp: float) -> Message:
    """One exchange with a peer, by which the offset of its clock is estimated."""
    cdr = CdrWriter().header(stamp, "").text(entry.peer).text(entry.clock)
    cdr.doubles(entry.sent, entry.answered, entry.returned)
    return cdr.as_message(CLOCK_PAIR)


def decision_message(entry: DecisionEntry, stamp: float) -> Message:
    """A decision of protection with the obstacles that limit it."""
    decision = entry.decision
    cdr = CdrWriter().header(stamp, "base_link").text(entry.cause).text(entry.state)
    cdr.text(entry.reason).text(decision.mode).doubles(
        *_twist(decision.requested), *_twist(decision.safe)
    )
    cdr.int64(decision.scan_seq).uint8(decision.is_active, decision.is_recovering)
    cdr.text("" if decision.avoided is None else decision.avoided.text)
    gap = math.nan if decision.min_gap is None else decision.min_gap
    cdr.doubles(
        decision.speed_share, gap, math.nan if decision.scan_age is None else decision.scan_age
    )
    columns = zip(*((row.bearing, row.gap, row.cap) for row in decision.rows), strict=True)
    for column in columns if decision.rows else ((), (), ()):
        cdr.array(np.array(column, np.float64))
    return cdr.as_message("Decision")


def text_message(json: str, stamp: float) -> Message:
    """A value as JSON."""
    return CdrWriter().header(stamp, "").text(json).as_message("Text")


def bytes_message(data: bytes, stamp: float) -> Message:
    """Bytes in MessagePack that only a replay reads."""
    return CdrWriter().header(stamp, "").array(data).as_message("Bytes")


def input_message(data: bytes, now: float, stamp: float) -> Message:
    """The bytes of an input that the robot got at `now` s on its clock.

    `now` is the float itself: the time of a message in ns is rounded, and one last bit of `now` may
    change a last bit of a command.
    """
    return CdrWriter().header(stamp, "").doubles(now).array(data).as_message("Input")


def log_message(text: str, robot: str, stamp: float) -> Message:
    """A line of the robot's log, as an rcl_interfaces/Log of level info."""
    cdr = CdrWriter().time(stamp).uint8(20).text(robot).text(text).text("").text("").uint32(0)
    return cdr.as_message("rcl_interfaces/msg/Log")


def _pose(pose: Pose) -> tuple[float, ...]:
    """The fields of a geometry_msgs/Pose."""
    half = 0.5 * pose.yaw
    return pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half)


def _twist(twist: Twist) -> tuple[float, ...]:
    """The fields of a geometry_msgs/Twist."""
    return twist.linear, twist.lateral, 0.0, 0.0, 0.0, twist.angular


def _pose_of(message: Any) -> Pose:
    turn = message.orientation
    yaw = 2.0 * math.atan2(turn.z, turn.w)
    return Pose(message.position.x, message.position.y, math.remainder(yaw, 2.0 * math.pi))


def _optional(values: Iterable[float | None]) -> Array:
    return np.array([math.nan if value is None else value for value in values], np.float64)

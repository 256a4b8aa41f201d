"""ROS 1 messages: serialised bytes to plain values and back, without ROS.

Little-endian, fields one after the other, strings and arrays after their length as uint32
(http://wiki.ros.org/msg, genmsg's rules). A type is known by the md5 sum of its definition, which
is that of ROS Noetic here. All decoders raise CodecError for bytes that are too short or too long.
What they give has ROS 2's names of fields, less what nobody uses, so that it is converted alike.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from swarmd.core.errors import CodecError
from swarmd.core.values import Twist

Floats = NDArray[np.float32]

_HEADER = struct.Struct("<4I")
_LENGTH = struct.Struct("<I")
_SCAN = struct.Struct("<7f")
_POSE = struct.Struct("<7d")
_TWIST = struct.Struct("<6d")
_COVARIANCE = 36 * 8
_IMU = struct.Struct("<37d")
_BATTERY = struct.Struct("<7f4B")
_RANGE = struct.Struct("<B4f")


@dataclass(frozen=True, slots=True)
class Kind:
    """A message type; `full_text` is its definition, which publishers announce."""

    name: str
    md5sum: str
    full_text: str = ""


LASER_SCAN = Kind("sensor_msgs/LaserScan", "90c7ef2dc6895d81024acba2ac42f369")
ODOMETRY = Kind("nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7")
IMU = Kind("sensor_msgs/Imu", "6a62c6daae103f4ff57a132d6f95cec2")
BATTERY = Kind("sensor_msgs/BatteryState", "4ddae7f048e32fda22cac764685e3974")
RANGE = Kind("sensor_msgs/Range", "c005c34273dc426c67a020a87bc24148")

_RULE = "=" * 80
_VECTOR = f"{_RULE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_TWIST_TEXT = "Vector3  linear\nVector3  angular\n"
TWIST = Kind("geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a", f"{_TWIST_TEXT}\n{_VECTOR}")
TWIST_STAMPED = Kind(
    "geometry_msgs/TwistStamped",
    "98d34b0043a2093cf9d9345ab6eef12e",
    "Header header\nTwist twist\n\n"
    f"{_RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n\n"
    f"{_RULE}\nMSG: geometry_msgs/Twist\n{_TWIST_TEXT}\n{_VECTOR}",
)


class Time(Struct, frozen=True):
    """A moment on the sender's clock."""

    sec: int
    nanosec: int


class Header(Struct, frozen=True):
    """A message's stamp and frame."""

    stamp: Time
    frame_id: str


class LaserScan(Struct, frozen=True, eq=False):
    """Angles in rad, times in s, ranges in m as the sensor gave them; `ranges` (n,) float32."""

    header: Header
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: Floats


class Vector(Struct, frozen=True):
    """Three numbers."""

    x: float
    y: float
    z: float


class Quaternion(Struct, frozen=True):
    """An orientation."""

    x: float
    y: float
    z: float
    w: float


class Pose(Struct, frozen=True):
    """Position in m and orientation."""

    position: Vector
    orientation: Quaternion


class Velocity(Struct, frozen=True):
    """m/s and rad/s."""

    linear: Vector
    angular: Vector


class PoseWithout(Struct, frozen=True):
    """A pose whose covariance was left out."""

    pose: Pose


class VelocityWithout(Struct, frozen=True):
    """A twist whose covariance was left out."""

    twist: Velocity


class Odometry(Struct, frozen=True):
    """The pose is in `header.frame_id`, the twist in `child_frame_id`."""

    header: Header
    child_frame_id: str
    pose: PoseWithout
    twist: VelocityWithout


class Imu(Struct, frozen=True):
    """Orientation, rad/s and m/s2; the first covariance of each is -1 for what is not measured."""

    header: Header
    orientation: Quaternion
    orientation_covariance: tuple[float, ...]
    angular_velocity: Vector
    linear_acceleration: Vector


class BatteryState(Struct, frozen=True):
    """V; `percentage` is NaN if it is not measured."""

    header: Header
    voltage: float
    percentage: float


class Range(Struct, frozen=True):
    """One distance `range` in m within a cone of `field_of_view` rad; its limits in m."""

    header: Header
    field_of_view: float
    min_range: float
    max_range: float
    range: float


def decode_laser_scan(data: bytes) -> LaserScan:
    """A LaserScan; its intensities are measured but not kept."""
    try:
        header, at = _header(data)
        numbers = _SCAN.unpack_from(data, at)
        at += _SCAN.size
        (count,) = _LENGTH.unpack_from(data, at)
        ranges = np.frombuffer(data, "<f4", count, at + 4)
        at += 4 + 4 * count
        (more,) = _LENGTH.unpack_from(data, at)
    except (struct.error, ValueError) as error:
        raise _fault(LASER_SCAN, error) from None
    _end(LASER_SCAN, data, at + 4 + 4 * more)
    first, last, step, between, whole, least, most = numbers
    return LaserScan(header, first, last, step, between, whole, least, most, ranges)


def decode_odometry(data: bytes) -> Odometry:
    """An Odometry, without its covariances."""
    try:
        header, at = _header(data)
        child, at = _text(data, at)
        pose = _POSE.unpack_from(data, at)
        at += _POSE.size + _COVARIANCE
        twist = _TWIST.unpack_from(data, at)
    except (struct.error, ValueError) as error:
        raise _fault(ODOMETRY, error) from None
    _end(ODOMETRY, data, at + _TWIST.size + _COVARIANCE)
    place = Pose(Vector(*pose[:3]), Quaternion(*pose[3:]))
    velocity = Velocity(Vector(*twist[:3]), Vector(*twist[3:]))
    return Odometry(header, child, PoseWithout(place), VelocityWithout(velocity))


def decode_imu(data: bytes) -> Imu:
    """An Imu, with the covariance of its orientation alone."""
    try:
        header, at = _header(data)
        numbers = _IMU.unpack_from(data, at)
    except (struct.error, ValueError) as error:
        raise _fault(IMU, error) from None
    _end(IMU, data, at + _IMU.size)
    turned, turning, pushed = numbers[:4], numbers[13:16], numbers[25:28]
    return Imu(header, Quaternion(*turned), numbers[4:13], Vector(*turning), Vector(*pushed))


def decode_battery(data: bytes) -> BatteryState:
    """A BatteryState: voltage and percentage."""
    try:
        header, at = _header(data)
        voltage, _, _, _, _, _, percentage, *_ = _BATTERY.unpack_from(data, at)
        at += _BATTERY.size
        for _ in range(2):  # cell voltages and temperatures
            (count,) = _LENGTH.unpack_from(data, at)
            at += 4 + 4 * count
        for _ in range(2):  # location and serial number
            _, at = _text(data, at)
    except (struct.error, ValueError) as error:
        raise _fault(BATTERY, error) from None
    _end(BATTERY, data, at)
    return BatteryState(header, voltage, percentage)


def decode_range(data: bytes) -> Range:
    """A Range; its kind of radiation is not kept."""
    try:
        header, at = _header(data)
        _, *numbers = _RANGE.unpack_from(data, at)
    except (struct.error, ValueError) as error:
        raise _fault(RANGE, error) from None
    _end(RANGE, data, at + _RANGE.size)
    view, least, most, distance = numbers
    return Range(header, view, least, most, distance)


def encode_twist(twist: Twist) -> bytes:
    """A geometry_msgs/Twist."""
    return _TWIST.pack(twist.linear, twist.lateral, 0.0, 0.0, 0.0, twist.angular)


def encode_twist_stamped(twist: Twist, seq: int, stamp_ns: int, frame: str) -> bytes:
    """A geometry_msgs/TwistStamped; `stamp_ns` since 1970."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    name = frame.encode()
    return _HEADER.pack(seq & 0xFFFFFFFF, seconds, rest, len(name)) + name + encode_twist(twist)


def _header(data: bytes) -> tuple[Header, int]:
    _, seconds, nanoseconds, length = _HEADER.unpack_from(data)
    end = _HEADER.size + length
    return Header(Time(seconds, nanoseconds), _string(data, _HEADER.size, end)), end


def _text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(data, at)
    return _string(data, at + 4, at + 4 + length), at + 4 + length


def _string(data: bytes, begin: int, end: int) -> str:
    if end > len(data):
        raise ValueError(f"a text of {end - begin} bytes where {len(data) - begin} are left")
    return data[begin:end].decode(errors="replace")


def _end(kind: Kind, data: bytes, at: int) -> None:
    if at != len(data):
        raise CodecError(f"{kind.name}: {len(data)} bytes, its lengths say {at}")


def _fault(kind: Kind, error: Exception) -> CodecError:
    return CodecError(f"{kind.name}: cannot be read: {error}")

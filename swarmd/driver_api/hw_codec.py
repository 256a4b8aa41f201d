"""The wire between a simulated robot and its daemon: its inputs, messages and command.

A simulated robot is any process that listens as `RobotServer` of `network/carriers/robot_link.py`.
The daemon sends the frames `cmd_vel`, `grip` and `sent`, the robot those of INPUTS and `received`.
Arrays travel as little-endian float32; regular bearings and ages as (first, step). `range_min` and
`range_max` come from the platform file, not from the message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from swarmd.core import events
from swarmd.core.bounds import Angle, Coordinate, Metres, Name, Speed, Stamp, Word
from swarmd.core.codec import MAX_MESSAGE, MAX_SENSOR_PAYLOAD, Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.events import SensorInput
from swarmd.core.messages import ScanWire
from swarmd.core.values import (
    MAX_DETECTIONS,
    MAX_TOLD_DISTANCE,
    Array,
    Detection,
    Neighbor,
    Odometry,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    SharedPose,
    Twist,
)

Distance = Annotated[float, Meta(ge=0.0, le=MAX_TOLD_DISTANCE)]
"""Metres to another robot."""
Channel = Annotated[str, Meta(min_length=3, max_length=127)]
MAX_RAYS = 20_000
MAX_MESSAGES = 100
"""Messages in one packet, of at most MAX_MESSAGE bytes each."""
INPUTS = ("scan", "ranges", "odometry", "neighbors", "pose", "readings", "detections")
"""The tags of the inputs that a simulated robot has."""


class OdometryWire(Struct, frozen=True, array_like=True):
    """Pose in the odometry frame and measured twist."""

    stamp: Stamp
    x: Coordinate
    y: Coordinate
    yaw: Metres
    linear: Speed
    angular: Speed
    lateral: Speed = 0.0


class NeighborWire(Struct, frozen=True, array_like=True):
    """One robot within radio range; None: not sensed."""

    id: Name
    distance: Distance | None = None
    bearing: Angle | None = None
    heading: Angle | None = None


class NeighborsWire(Struct, frozen=True, array_like=True):
    """All robots within radio range."""

    neighbors: tuple[NeighborWire, ...]


class PoseWire(Struct, frozen=True, array_like=True):
    """The robot's pose in a frame that robots share; `error` in m, `yaw_error` in rad."""

    stamp: Stamp
    x: Coordinate
    y: Coordinate
    yaw: Metres
    error: Metres
    yaw_error: Angle
    frame: Name


class ReadingsWire(Struct, frozen=True, array_like=True):
    """Scalar sensors by name."""

    values: dict[Word, Metres]


class DetectionsWire(Struct, frozen=True, array_like=True):
    """All recognised objects."""

    detections: Annotated[tuple[Detection, ...], Meta(max_length=MAX_DETECTIONS)]


class MessageWire(Struct, frozen=True, array_like=True):
    """A pattern's message on a channel; `robot` is its sender. `payload` is an encoded value."""

    robot: Name
    channel: Channel
    payload: Annotated[bytes, Meta(max_length=MAX_MESSAGE)]


class MessagesWire(Struct, frozen=True, array_like=True):
    """Messages that a robot's radio receives at one time, in their order."""

    messages: Annotated[tuple[MessageWire, ...], Meta(max_length=MAX_MESSAGES)]


class CommandWire(Struct, frozen=True, array_like=True):
    """The safe command, the scan of its decision and the scan of its request (-1: none)."""

    linear: Speed
    angular: Speed
    lateral: Speed
    scan_seq: Annotated[int, Meta(ge=-1, le=2**53)]
    requested_scan_seq: Annotated[int, Meta(ge=-1, le=2**53)]


class GripWire(Struct, frozen=True, array_like=True):
    """The command of the gripper."""

    is_closed: bool


_scan = Decoder(ScanWire, MAX_SENSOR_PAYLOAD)
_odometry = Decoder(OdometryWire)
_neighbors = Decoder(NeighborsWire)
_pose = Decoder(PoseWire)
_readings = Decoder(ReadingsWire)
_detections = Decoder(DetectionsWire)
_command = Decoder(CommandWire)
_grip = Decoder(GripWire)
_message = Decoder(MessageWire)
_messages = Decoder(MessagesWire, MAX_SENSOR_PAYLOAD)


def encode_scan(scan: Scan) -> bytes:
    """The bytes of a scan."""
    ranges = scan.ranges.astype("<f4").tobytes()
    ages = None if scan.ages is None else _short(scan.ages)
    return encode(ScanWire(scan.seq, scan.stamp, ranges, _short(scan.bearings), ages))


def decode_scan(payload: bytes, spec: ScanSpec) -> Scan:
    """A scan as the sensor gave it, not yet conditioned: even its lengths may disagree."""
    wire = _scan(payload)
    ranges = _floats(wire.ranges)
    bearings = _of_rays(wire.bearings, len(ranges))
    ages = None if wire.ages is None else _of_rays(wire.ages, len(ranges))
    return Scan(wire.seq, wire.stamp, ranges, bearings, spec.range_min, spec.range_max, ages)


def encode_odometry(odometry: Odometry) -> bytes:
    """The bytes of an odometry value."""
    pose, twist = odometry.pose, odometry.twist
    return encode(
        OdometryWire(
            odometry.stamp, pose.x, pose.y, pose.yaw, twist.linear, twist.angular, twist.lateral
        )
    )


def decode_odometry(payload: bytes) -> Odometry:
    """Pose and twist as measured."""
    wire = _odometry(payload)
    return Odometry(
        wire.stamp, Pose(wire.x, wire.y, wire.yaw), Twist(wire.linear, wire.angular, wire.lateral)
    )


def encode_neighbors(neighbors: tuple[Neighbor, ...]) -> bytes:
    """The bytes of the list of robots within radio range."""
    return encode(
        NeighborsWire(
            tuple(NeighborWire(n.id, n.distance, n.bearing, n.heading) for n in neighbors)
        )
    )


def decode_neighbors(payload: bytes) -> tuple[Neighbor, ...]:
    """The robots within radio range; their age is 0, counted from arrival."""
    wire = _neighbors(payload)
    return tuple(Neighbor(n.id, 0.0, n.distance, n.bearing, n.heading) for n in wire.neighbors)


def encode_pose(shared: SharedPose) -> bytes:
    """The bytes of a pose in a shared frame."""
    p = shared.pose
    fields = p.x, p.y, p.yaw, shared.error, shared.yaw_error, shared.frame
    return encode(PoseWire(shared.stamp, *fields))


def decode_pose(payload: bytes) -> SharedPose:
    """A pose in a shared frame; CodecError if it is not valid."""
    wire = _pose(payload)
    pose = Pose(wire.x, wire.y, wire.yaw)
    shared = SharedPose(wire.stamp, pose, wire.error, wire.yaw_error, wire.frame)
    if not shared.is_valid:
        raise CodecError("a pose in a shared frame that is too far or too inaccurate")
    return shared


def encode_readings(values: Mapping[str, float]) -> bytes:
    """The bytes of scalar readings."""
    return encode(ReadingsWire(dict(values)))


def decode_readings(payload: bytes) -> dict[str, float]:
    """Scalar readings by name."""
    return _readings(payload).values


def encode_detections(detections: tuple[Detection, ...]) -> bytes:
    """The bytes of all recognised objects."""
    return encode(DetectionsWire(detections))


def decode_detections(payload: bytes) -> tuple[Detection, ...]:
    """All recognised objects; CodecError if one is not valid."""
    found = _detections(payload).detections
    if not all(one.is_valid for one in found):
        raise CodecError("a detection beyond its bounds")
    return found


def encode_command(twist: Twist, scan_seq: int, requested_scan_seq: int) -> bytes:
    """The bytes of a safe command."""
    return encode(
        CommandWire(twist.linear, twist.angular, twist.lateral, scan_seq, requested_scan_seq)
    )


def decode_command(payload: bytes) -> CommandWire:
    """A safe command and the scans behind it."""
    return _command(payload)


def encode_grip(is_closed: bool) -> bytes:
    """The bytes of a gripper's command."""
    return encode(GripWire(is_closed))


def decode_grip(payload: bytes) -> bool:
    """Whether the gripper closes."""
    return _grip(payload).is_closed


def encode_message(robot: str, channel: str, payload: bytes) -> bytes:
    """The bytes of a message of robot `robot` whose encoded value is `payload`."""
    return encode(MessageWire(robot, channel, payload))


def decode_message(payload: bytes) -> MessageWire:
    """A message with its sender and channel; its value is still encoded."""
    return _message(payload)


def encode_messages(messages: Sequence[MessageWire]) -> bytes:
    """The bytes of at most MAX_MESSAGES messages."""
    return encode(MessagesWire(tuple(messages)))


def decode_messages(payload: bytes) -> tuple[MessageWire, ...]:
    """Messages in their order; their values are still encoded."""
    return _messages(payload).messages


def decode_input(kind: str, payload: bytes, platform: Platform) -> SensorInput:
    """The input of one of INPUTS; CodecError if it is malformed or exceeds a bound."""
    if kind == "scan":
        return events.ScanInput(decode_scan(payload, platform.scan))
    if kind == "ranges":
        if platform.ranges is None:
            raise CodecError("a scan of a ring that the platform does not have")
        return events.RangesInput(decode_scan(payload, platform.ranges))
    if kind == "odometry":
        return events.OdometryInput(decode_odometry(payload))
    if kind == "pose":
        return events.PoseInput(decode_pose(payload))
    if kind == "detections":
        return events.DetectionsInput(decode_detections(payload))
    if kind == "neighbors":
        return events.NeighborsInput(decode_neighbors(payload))
    return events.ReadingsInput(decode_readings(payload))


def _short(values: Array) -> tuple[float, float] | bytes:
    """The bearings or ages of rays as (first, step) if regular, else as bytes."""
    step = float(values[1] - values[0]) if len(values) > 1 else 0.0
    first = float(values[0]) if len(values) else 0.0
    off = np.abs(values - (first + step * np.arange(len(values))))
    if off.max(initial=0.0) <= 1e-9:  # false for NaN
        return first, step
    return values.astype("<f4").tobytes()


@lru_cache(maxsize=16)
def _of_rays(wire: tuple[float, float] | bytes, count: int) -> Array:
    """The bearings or ages of rays; one array for equal scans, computed once."""
    if isinstance(wire, bytes):
        values = _floats(wire)
    else:
        values = wire[0] + wire[1] * np.arange(count, dtype=np.float64)
    values.flags.writeable = False
    return values


def _floats(data: bytes) -> Array:
    if len(data) % 4 or len(data) > 4 * MAX_RAYS:
        raise CodecError(f"an array of {len(data)} bytes; expected at most {MAX_RAYS} float32")
    return np.frombuffer(data, dtype="<f4").astype(np.float64)

"""The wire between a simulated robot and its daemon: its inputs, messages and command.

A simulated robot is any process that listens as `RobotServer` of `link/carriers/robot_link.py`.
The daemon sends the frames `cmd_vel`, `grip` and `sent` (a message of its pattern, for the robot's
radio). The robot sends the frames of KINDS, which are its inputs, and `received` (messages that its
radio heard). While only scans and odometry have come, the daemon reads the first frame of another
kind with its next tick. So a simulator of robots that sense hazards sends `hazards` from the start,
empty.

Scans and odometry are frequent and have encodings of their own; any other input is encoded as in a
recording. The arrays of a scan are little-endian float32; evenly spaced bearings or ages are sent
as their first value and step. `range_min` and `range_max` come from the platform file, not from the
message.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Annotated, Any, get_args

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple

from swarmd.core import events
from swarmd.core.bounds import Coordinate, Metres, Name, Speed, Stamp
from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSOR_PAYLOAD, Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.events import SensorInput
from swarmd.core.messages import ScanWire
from swarmd.core.values import (
    Array,
    Odometry,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    Twist,
)

Channel = Annotated[str, Meta(min_length=3, max_length=127)]
MAX_RAYS = 20_000
MAX_MESSAGES = 100
"""Messages in one packet, of at most MAX_MESSAGE bytes each."""
KINDS = frozenset(str(kind.__struct_config__.tag) for kind in get_args(SensorInput))
"""The kinds of sensor input; each names the frames that carry it."""


class OdometryWire(Struct, frozen=True, array_like=True):
    """Pose in the odometry frame and measured twist."""

    stamp: Stamp
    x: Coordinate
    y: Coordinate
    yaw: Metres
    linear: Speed
    angular: Speed
    lateral: Speed = 0.0


class MessageWire(Struct, frozen=True, array_like=True):
    """A pattern's message on a channel; `robot` is its sender. `payload` is an encoded value."""

    robot: Name
    channel: Channel
    payload: Annotated[bytes, Meta(max_length=MAX_MESSAGE)]


class MessagesWire(Struct, frozen=True, array_like=True):
    """Messages that a robot's radio receives at one time, in their order."""

    messages: Annotated[tuple[MessageWire, ...], Meta(max_length=MAX_MESSAGES)]


class CommandWire(Struct, frozen=True, array_like=True):
    """The safe command, the scan of its decision, and the scan of the request (-1 without)."""

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
_grip = Decoder(GripWire)
_messages = Decoder(MessagesWire, MAX_SENSOR_PAYLOAD)
decode_command = Decoder(CommandWire)
"""A safe command and the scans behind it."""
decode_message = Decoder(MessageWire)
"""A message with its sender and channel; its value is still encoded."""


def encode_scan(scan: Scan) -> bytes:
    """The bytes of a scan."""
    ranges = scan.ranges.astype("<f4").tobytes()
    ages = None if scan.ages is None else _short(scan.ages)
    return encode(ScanWire(scan.seq, scan.stamp, ranges, _short(scan.bearings), ages))


def decode_scan(payload: bytes, spec: ScanSpec) -> Scan:
    """A raw scan, not yet conditioned: even the lengths of its arrays may disagree."""
    wire = _scan(payload)
    ranges = _floats(wire.ranges)
    bearings = _of_rays(wire.bearings, len(ranges))
    ages = None if wire.ages is None else _of_rays(wire.ages, len(ranges))
    return Scan(wire.seq, wire.stamp, ranges, bearings, spec.range_min, spec.range_max, ages)


def encode_odometry(odometry: Odometry) -> bytes:
    """The bytes of an odometry value."""
    pose = odometry.pose
    twist = odometry.twist
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


def encode_command(twist: Twist, scan_seq: int, requested_scan_seq: int) -> bytes:
    """The bytes of a safe command."""
    return encode(
        CommandWire(twist.linear, twist.angular, twist.lateral, scan_seq, requested_scan_seq)
    )


def encode_grip(is_closed: bool) -> bytes:
    """The bytes of a gripper's command."""
    return encode(GripWire(is_closed))


def decode_grip(payload: bytes) -> bool:
    """Whether the gripper closes."""
    return _grip(payload).is_closed


def encode_message(robot: str, channel: str, payload: bytes) -> bytes:
    """The bytes of a message of robot `robot` whose encoded value is `payload`."""
    return encode(MessageWire(robot, channel, payload))


def encode_messages(messages: Sequence[MessageWire]) -> bytes:
    """The bytes of at most MAX_MESSAGES messages."""
    return encode(MessagesWire(tuple(messages)))


def decode_messages(payload: bytes) -> tuple[MessageWire, ...]:
    """Messages in their order; their values are still encoded."""
    return _messages(payload).messages


def encode_input(input: SensorInput) -> bytes:
    """The bytes of an input; the kind of the input is the name of the frame."""
    if isinstance(input, events.ScanInput | events.RangesInput):
        return encode_scan(input.scan)
    if isinstance(input, events.OdometryInput):
        return encode_odometry(input.odometry)
    return events.encode_input(input)


def decode_input(kind: str, payload: bytes, platform: Platform) -> SensorInput:
    """The input of one of KINDS; CodecError if it is malformed or exceeds a bound."""
    if kind == "scan":
        return events.ScanInput(decode_scan(payload, platform.scan))
    if kind == "ranges":
        if platform.ranges is None:
            raise CodecError("a scan of a ring that the platform does not have")
        return events.RangesInput(decode_scan(payload, platform.ranges))
    if kind == "odometry":
        return events.OdometryInput(decode_odometry(payload))
    if len(payload) > MAX_CONTROL:
        raise CodecError(f"{len(payload)} bytes; expected at most {MAX_CONTROL}")
    input = events.decode_input(payload)
    if not isinstance(input, SensorInput) or events.tag_of(input) != kind:
        raise CodecError(f"an input {events.tag_of(input)}; expected {kind}")
    (value,) = astuple(input)
    if not all(getattr(part, "is_valid", True) for part in _parts(value)):
        raise CodecError(f"an input {kind} beyond its bounds")
    return input


def _parts(value: Any) -> Iterable[Any]:
    return value if isinstance(value, tuple) else (value,)


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
    """The bearings or ages of rays as an array, cached for equal scans."""
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

"""The bytes of ROS 1: against ROS's own serialisation, and against what is none."""

from __future__ import annotations

import contextlib
import json
import math
import struct
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarmd.core.errors import CodecError
from swarmd.core.values import Twist
from swarmd.drivers.ros1 import wire
from tests.support.roscore import PYTHON, why_no_ros1

ORACLE = Path(__file__).with_name("ros1_oracle.py")
MANY = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

Ask = Callable[..., dict[str, Any]]

double = st.floats(allow_nan=False)
single = st.floats(width=32, allow_nan=False)
numbers = st.integers(0, 2**32 - 1)
names = st.text(max_size=20).filter(lambda text: "\0" not in text)
header = st.fixed_dictionaries(
    {
        "seq": numbers,
        "stamp": st.tuples(numbers, st.integers(0, 999_999_999)).map(list),
        "frame_id": names,
    }
)


def of(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(dict(fields))


vector = of(x=double, y=double, z=double)
quaternion = of(x=double, y=double, z=double, w=double)


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    lacks = why_no_ros1()
    if lacks:
        pytest.skip(lacks)
    process = subprocess.Popen(
        [PYTHON, str(ORACLE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def asked(**order: Any) -> dict[str, Any]:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(order) + "\n")
        process.stdin.flush()
        found: dict[str, Any] = json.loads(process.stdout.readline())
        return found

    try:
        yield asked
    finally:
        process.kill()
        process.communicate()


def encoded(ask: Ask, kind: wire.Kind, fields: dict[str, Any]) -> bytes:
    found = ask(type=kind.name, fields=fields)
    assert found["md5sum"] == kind.md5sum
    return bytes.fromhex(found["bytes"])


def head(fields: dict[str, Any]) -> wire.Header:
    given = fields["header"]
    return wire.Header(wire.Time(*given["stamp"]), given["frame_id"])


def three(fields: dict[str, float]) -> wire.Vector:
    return wire.Vector(fields["x"], fields["y"], fields["z"])


def four(fields: dict[str, float]) -> wire.Quaternion:
    return wire.Quaternion(fields["x"], fields["y"], fields["z"], fields["w"])


@MANY
@given(
    fields=of(
        header=header,
        angle_min=single,
        angle_max=single,
        angle_increment=single,
        time_increment=single,
        scan_time=single,
        range_min=single,
        range_max=single,
        ranges=st.lists(single, max_size=60),
        intensities=st.lists(single, max_size=60),
    )
)
def test_a_laser_scan_is_read_as_ros_wrote_it(ask: Ask, fields: dict[str, Any]) -> None:
    found = wire.decode_laser_scan(encoded(ask, wire.LASER_SCAN, fields))
    assert found.header == head(fields)
    for name in (
        "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min",
        "range_max",
    ):  # fmt: skip
        assert getattr(found, name) == fields[name]
    assert found.ranges.tolist() == fields["ranges"]


@MANY
@given(
    fields=of(
        header=header,
        child_frame_id=names,
        pose=of(pose=of(position=vector, orientation=quaternion)),
        twist=of(twist=of(linear=vector, angular=vector)),
    )
)
def test_an_odometry_is_read_as_ros_wrote_it(ask: Ask, fields: dict[str, Any]) -> None:
    found = wire.decode_odometry(encoded(ask, wire.ODOMETRY, fields))
    pose, twist = fields["pose"]["pose"], fields["twist"]["twist"]
    assert (found.header, found.child_frame_id) == (head(fields), fields["child_frame_id"])
    assert found.pose.pose.position == three(pose["position"])
    assert found.pose.pose.orientation == four(pose["orientation"])
    assert found.twist.twist.linear == three(twist["linear"])
    assert found.twist.twist.angular == three(twist["angular"])


@MANY
@given(
    fields=of(
        header=header,
        orientation=quaternion,
        orientation_covariance=st.lists(double, min_size=9, max_size=9),
        angular_velocity=vector,
        linear_acceleration=vector,
    )
)
def test_an_imu_is_read_as_ros_wrote_it(ask: Ask, fields: dict[str, Any]) -> None:
    found = wire.decode_imu(encoded(ask, wire.IMU, fields))
    assert (found.header, found.orientation) == (head(fields), four(fields["orientation"]))
    assert list(found.orientation_covariance) == fields["orientation_covariance"]
    assert found.angular_velocity == three(fields["angular_velocity"])
    assert found.linear_acceleration == three(fields["linear_acceleration"])


@MANY
@given(
    fields=of(
        header=header,
        voltage=single,
        percentage=single,
        cell_voltage=st.lists(single, max_size=6),
        cell_temperature=st.lists(single, max_size=6),
        location=names,
        serial_number=names,
    )
)
def test_a_battery_is_read_as_ros_wrote_it(ask: Ask, fields: dict[str, Any]) -> None:
    found = wire.decode_battery(encoded(ask, wire.BATTERY, fields))
    assert found == wire.BatteryState(head(fields), fields["voltage"], fields["percentage"])


@MANY
@given(
    fields=of(header=header, field_of_view=single, min_range=single, max_range=single, range=single)
)
def test_a_range_is_read_as_ros_wrote_it(ask: Ask, fields: dict[str, Any]) -> None:
    found = wire.decode_range(encoded(ask, wire.RANGE, fields))
    wanted = (fields["field_of_view"], fields["min_range"], fields["max_range"], fields["range"])
    assert found == wire.Range(head(fields), *wanted)


@MANY
@given(linear=double, angular=double, lateral=double, seq=numbers, stamp=numbers, frame=names)
def test_ros_reads_commands_as_they_were_written(
    ask: Ask, linear: float, angular: float, lateral: float, seq: int, stamp: int, frame: str
) -> None:
    twist = Twist(linear, angular, lateral)
    fields = {
        "linear": {"x": linear, "y": lateral, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": angular},
    }
    data = wire.encode_twist(twist)
    assert data == encoded(ask, wire.TWIST, fields)
    assert ask(type=wire.TWIST.name, bytes=data.hex())["fields"] == fields
    stamped = {"header": {"seq": seq, "stamp": [stamp, 7], "frame_id": frame}, "twist": fields}
    data = wire.encode_twist_stamped(twist, seq, stamp * 1_000_000_000 + 7, frame)
    assert data == encoded(ask, wire.TWIST_STAMPED, stamped)
    assert ask(type=wire.TWIST_STAMPED.name, bytes=data.hex())["fields"] == stamped


@pytest.mark.parametrize("kind", [wire.TWIST, wire.TWIST_STAMPED])
def test_the_announced_definitions_have_their_sums(ask: Ask, kind: wire.Kind) -> None:
    assert ask(type=kind.name, text=kind.full_text)["md5sum"] == kind.md5sum


SCAN = struct.pack("<4I", 1, 2, 3, 4) + b"base" + struct.pack("<7f", *range(7))
SCAN += struct.pack("<I3f", 3, math.nan, math.inf, -math.inf) + struct.pack("<I", 0)
VALID: dict[Callable[[bytes], object], bytes] = {
    wire.decode_laser_scan: SCAN,
    wire.decode_odometry: bytes(16 + 4 + 8 * (7 + 36 + 6 + 36)),
    wire.decode_imu: bytes(16 + 8 * 37),
    wire.decode_battery: bytes(16 + 28 + 4 + 16),
    wire.decode_range: bytes(16 + 17),
}


@pytest.mark.parametrize("decode", VALID)
def test_what_is_cut_short_or_goes_on_is_no_message(decode: Callable[[bytes], object]) -> None:
    data = VALID[decode]
    decode(data)
    for size in range(len(data)):
        with pytest.raises(CodecError):
            decode(data[:size])
    with pytest.raises(CodecError, match="its lengths say"):
        decode(data + b"\0")


@pytest.mark.parametrize("decode", VALID)
@given(data=st.binary(max_size=1000))
def test_any_other_bytes_are_none_either(decode: Callable[[bytes], object], data: bytes) -> None:
    with contextlib.suppress(CodecError):  # and nothing else
        decode(data)


def test_lengths_beyond_all_memory_are_no_message() -> None:
    data = SCAN[:48] + struct.pack("<I", 0xFFFFFFFF) + bytes(100)
    with pytest.raises(CodecError, match="sensor_msgs/LaserScan"):
        wire.decode_laser_scan(data)


def test_what_a_sensor_does_not_know_is_kept() -> None:
    found = wire.decode_laser_scan(SCAN)
    np.testing.assert_array_equal(found.ranges, np.array([np.nan, np.inf, -np.inf], np.float32))


def test_bytes_are_little_endian_and_fields_in_their_order() -> None:
    """Also where no ROS is there to ask."""
    head = b"\x01\0\0\0\x02\0\0\0\x03\0\0\0\x02\0\0\0ab"
    data = head + struct.pack("<7f", 1, 2, 3, 4, 5, 6, 7) + struct.pack("<I2f", 2, 8, 9) + bytes(4)
    scan = wire.decode_laser_scan(data)
    assert scan.header == wire.Header(wire.Time(2, 3), "ab")
    angles = (scan.angle_min, scan.angle_max, scan.angle_increment)
    assert (*angles, scan.range_min, scan.range_max) == (1, 2, 3, 6, 7)
    assert scan.ranges.tolist() == [8, 9]
    pose, twist = struct.pack("<7d", *range(7)), struct.pack("<6d", *range(6))
    data = head + b"\x01\0\0\0c" + pose + bytes(288) + twist + bytes(288)
    odometry = wire.decode_odometry(data)
    assert odometry.pose.pose == wire.Pose(wire.Vector(0, 1, 2), wire.Quaternion(3, 4, 5, 6))
    assert odometry.twist.twist == wire.Velocity(wire.Vector(0, 1, 2), wire.Vector(3, 4, 5))
    imu = wire.decode_imu(head + struct.pack("<37d", *range(37)))
    assert (imu.orientation, imu.orientation_covariance[0]) == (wire.Quaternion(0, 1, 2, 3), 4)
    battery = wire.decode_battery(head + struct.pack("<7f", *range(7)) + bytes(20))
    assert (battery.voltage, battery.percentage) == (0, 6)
    near = wire.decode_range(head + struct.pack("<B4f", 1, 2, 3, 4, 5))
    assert near == wire.Range(wire.Header(wire.Time(2, 3), "ab"), 2, 3, 4, 5)
    command = struct.pack("<6d", 0.5, 0.125, 0, 0, 0, -0.25)
    assert wire.encode_twist(Twist(0.5, -0.25, 0.125)) == command
    stamped = wire.encode_twist_stamped(Twist(0.5, -0.25, 0.125), 1, 2_000_000_003, "ab")
    assert stamped == head + command

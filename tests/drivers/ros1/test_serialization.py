"""The bytes of ROS 1, against ROS's own serialisation and against malformed bytes."""

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
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros1.serialization import (
    decode,
    definition,
    encode_twist,
    encode_twist_stamped,
    type_name,
)
from tests.support.roscore import PYTHON, why_no_ros1

ORACLE = Path(__file__).with_name("oracle.py")
MANY = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

Ask = Callable[..., dict[str, Any]]

double = st.floats(allow_nan=False)
single = st.floats(width=32, allow_nan=False)
numbers = st.integers(0, 2**32 - 1)
names = st.text(max_size=20).filter(lambda text: "\0" not in text)


def of(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(dict(fields))


stamp = st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999)).map(list)
header = of(seq=numbers, stamp=stamp, frame_id=names)
vector = of(x=double, y=double, z=double)
quaternion = of(x=double, y=double, z=double, w=double)

MESSAGES: dict[type, st.SearchStrategy[dict[str, Any]]] = {
    ros.LaserScan: of(
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
    ),
    ros.Odometry: of(
        header=header,
        child_frame_id=names,
        pose=of(pose=of(position=vector, orientation=quaternion)),
        twist=of(twist=of(linear=vector, angular=vector)),
    ),
    ros.Imu: of(
        header=header,
        orientation=quaternion,
        orientation_covariance=st.lists(double, min_size=9, max_size=9),
        angular_velocity=vector,
        linear_acceleration=vector,
    ),
    ros.BatteryState: of(
        header=header,
        voltage=single,
        percentage=single,
        cell_voltage=st.lists(single, max_size=6),
        location=names,
        serial_number=names,
    ),
    ros.Range: of(
        header=header, field_of_view=single, min_range=single, max_range=single, range=single
    ),
}


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


def encoded(ask: Ask, kind: type, fields: dict[str, Any]) -> bytes:
    found = ask(type=type_name(kind), fields=fields)
    assert found["md5sum"] == definition(kind)[1]
    return bytes.fromhex(found["bytes"])


def differences(message: Any, fields: dict[str, Any]) -> list[str]:
    """The names of the fields that a decoded message has otherwise."""
    found = []
    for name, value in fields.items():
        own = getattr(message, name)
        if name == "stamp":
            own = [own.sec, own.nanosec]
        if isinstance(value, dict):
            found += differences(own, value)
        elif (own.tolist() if isinstance(own, np.ndarray) else own) != value:
            found.append(name)
    return found


@pytest.mark.parametrize("kind", MESSAGES)
def test_a_message_is_read_as_ros_wrote_it(ask: Ask, kind: type) -> None:
    @MANY
    @given(MESSAGES[kind])
    def check(fields: dict[str, Any]) -> None:
        assert not differences(decode(kind, encoded(ask, kind, fields)), fields)

    check()


@MANY
@given(linear=double, angular=double, lateral=double, seq=numbers, at=numbers, frame=names)
def test_ros_reads_commands_as_they_were_written(
    ask: Ask, linear: float, angular: float, lateral: float, seq: int, at: int, frame: str
) -> None:
    twist, at = Twist(linear, angular, lateral), at // 2
    fields = {
        "linear": {"x": linear, "y": lateral, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": angular},
    }
    data = encode_twist(twist)
    assert data == encoded(ask, ros.Twist, fields)
    assert ask(type=type_name(ros.Twist), bytes=data.hex())["fields"] == fields
    stamped = {"header": {"seq": seq, "stamp": [at, 7], "frame_id": frame}, "twist": fields}
    data = encode_twist_stamped(twist, seq, at * 1_000_000_000 + 7, frame)
    assert data == encoded(ask, ros.TwistStamped, stamped)
    assert ask(type=type_name(ros.TwistStamped), bytes=data.hex())["fields"] == stamped


@pytest.mark.parametrize("kind", [ros.Twist, ros.TwistStamped])
def test_the_announced_definitions_have_their_md5_sums(ask: Ask, kind: type) -> None:
    text, md5sum = definition(kind)
    assert ask(type=type_name(kind), text=text)["md5sum"] == md5sum


HEAD = struct.pack("<4I", 1, 2, 3, 2) + b"ab"
SCAN = HEAD + struct.pack("<7f", *range(1, 8))
SCAN += struct.pack("<I3f", 3, math.nan, math.inf, -math.inf) + struct.pack("<I", 0)
POSE, TWIST = struct.pack("<7d", *range(7)), struct.pack("<6d", *range(6))
VALID: dict[type, bytes] = {
    ros.LaserScan: SCAN,
    ros.Odometry: HEAD + b"\x01\0\0\0c" + POSE + bytes(288) + TWIST + bytes(288),
    ros.Imu: HEAD + struct.pack("<37d", *range(37)),
    ros.BatteryState: HEAD + struct.pack("<7f", *range(7)) + bytes(20),
    ros.Range: HEAD + struct.pack("<B4f", 1, 2, 3, 4, 5),
}


@pytest.mark.parametrize("kind", VALID)
def test_truncated_and_overlong_bytes_are_refused(kind: type) -> None:
    data = VALID[kind]
    decode(kind, data)
    for malformed in (*(data[:size] for size in range(len(data))), data + b"\0"):
        with pytest.raises(CodecError):
            decode(kind, malformed)


@pytest.mark.parametrize("kind", VALID)
@given(data=st.binary(max_size=1000))
def test_random_bytes_raise_codec_errors_only(kind: type, data: bytes) -> None:
    with contextlib.suppress(CodecError):
        decode(kind, data)


@pytest.mark.parametrize("text", [b"\xff\xfe", b"a\0"])
def test_a_frame_that_is_no_text_raises_codec_errors_only(text: bytes) -> None:
    with contextlib.suppress(CodecError):
        decode(ros.LaserScan, SCAN[:16] + text + SCAN[18:])


def test_lengths_beyond_all_memory_are_refused() -> None:
    with pytest.raises(CodecError):
        decode(ros.LaserScan, SCAN[:46] + struct.pack("<I", 0xFFFFFFFF) + bytes(100))


def test_bytes_are_little_endian_and_fields_in_their_order() -> None:
    """Also where no ROS is installed to ask."""
    scan = decode(ros.LaserScan, SCAN)
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (2, 3)
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (1, 3, 7)
    np.testing.assert_array_equal(scan.ranges, np.array([np.nan, np.inf, -np.inf], np.float32))
    command = struct.pack("<6d", 0.5, 0.125, 0, 0, 0, -0.25)
    assert encode_twist(Twist(0.5, -0.25, 0.125)) == command
    assert encode_twist_stamped(Twist(0.5, -0.25, 0.125), 1, 2_000_000_003, "ab") == HEAD + command

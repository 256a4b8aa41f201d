"""The bytes of ROS 1 and the md5 sums of its types; with ROS itself: `test_driver.py`."""

from __future__ import annotations

import contextlib
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.errors import CodecError
from swarmd.core.values import Twist
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros1.serialization import decode, definition, encode_twist, encode_twist_stamped

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
    scan = decode(ros.LaserScan, SCAN)
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (2, 3)
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (1, 3, 7)
    np.testing.assert_array_equal(scan.ranges, np.array([np.nan, np.inf, -np.inf], np.float32))
    command = struct.pack("<6d", 0.5, 0.125, 0, 0, 0, -0.25)
    assert encode_twist(Twist(0.5, -0.25, 0.125)) == command
    assert encode_twist_stamped(Twist(0.5, -0.25, 0.125), 1, 2_000_000_003, "ab") == HEAD + command


@pytest.mark.parametrize(
    ("kind", "md5sum"),
    [
        (ros.LaserScan, "90c7ef2dc6895d81024acba2ac42f369"),
        (ros.Odometry, "cd5e73d190d741a2f92e81eda573aca7"),
        (ros.Imu, "6a62c6daae103f4ff57a132d6f95cec2"),
        (ros.BatteryState, "4ddae7f048e32fda22cac764685e3974"),
        (ros.Range, "c005c34273dc426c67a020a87bc24148"),
        (ros.Twist, "9f195f881246fdfa2798d1d3eebca84a"),
        (ros.TwistStamped, "98d34b0043a2093cf9d9345ab6eef12e"),
    ],
)
def test_md5_sums_are_those_of_ros_noetic(kind: type, md5sum: str) -> None:
    assert definition(kind)[1] == md5sum

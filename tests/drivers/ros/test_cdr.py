"""The codec against a second library's, both ways, and against bytes that are no message."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.errors import CodecError
from swarmd.core.values import Twist
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros.from_ros import twist_message
from tests.drivers.ros2.robots import HASHES
from tests.support import dds_types
from tests.support import second_codec as second

doubles = st.floats(width=64)
singles = st.floats(width=32)
rays = st.lists(singles, max_size=400)
texts = st.text(st.characters(min_codepoint=1, max_codepoint=0x10FFF, exclude_categories=["Cs"]))
times = st.builds(second.Time, st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
headers = st.builds(second.Header, times, texts)
vectors = st.builds(second.Vector3, doubles, doubles, doubles)
twists = st.builds(second.Twist, vectors, vectors)
covariances = st.lists(doubles, min_size=36, max_size=36)
poses = st.builds(
    second.Pose, vectors, st.builds(second.Quaternion, doubles, doubles, doubles, doubles)
)
scans = st.builds(second.LaserScan, headers, *[singles] * 7, rays, rays)
stamped = st.builds(second.TwistStamped, headers, twists)
odometries = st.builds(
    second.Odometry,
    headers,
    texts,
    st.builds(second.PoseWithCovariance, poses, covariances),
    st.builds(second.TwistWithCovariance, twists, covariances),
)
cases = [
    pytest.param(messages.LaserScan, second.LaserScan, scans, id="LaserScan"),
    pytest.param(messages.Twist, second.Twist, twists, id="Twist"),
    pytest.param(messages.TwistStamped, second.TwistStamped, stamped, id="TwistStamped"),
    pytest.param(messages.Odometry, second.Odometry, odometries, id="Odometry"),
]


def flat(message: Any) -> list[Any]:
    """All values of a message of either library, in order; NaN as a word, since it equals none."""
    if is_dataclass(message):
        # rosbags has its constants and type names among the fields
        names = [f.name for f in fields(message) if f.name.islower() and f.name[0] != "_"]
        return [v for name in names for v in flat(getattr(message, name))]
    if isinstance(message, list | np.ndarray):
        return [len(message), *(v for item in message for v in flat(item))]
    if isinstance(message, float | np.floating) and math.isnan(message):
        return ["nan"]
    return [message]


@pytest.mark.parametrize(("ours", "theirs", "values"), cases)
def test_bytes_are_those_of_the_second_library_both_ways(
    ours: type, theirs: Any, values: st.SearchStrategy[Any]
) -> None:
    @settings(max_examples=150, deadline=None)
    @given(values)
    def check(value: Any) -> None:
        written = value.serialize()
        read: object = cdr.decode(ours, written)
        assert flat(read) == flat(value)
        again = cdr.encode(read)
        assert again == written
        assert flat(theirs.deserialize(again)) == flat(value)

    check()


@settings(max_examples=50, deadline=None)
@given(scans)
def test_big_endian_is_read_too(value: second.LaserScan) -> None:
    written = value.serialize(endianness=second.BIG)
    assert flat(cdr.decode(messages.LaserScan, written)) == flat(value)


@pytest.mark.parametrize(
    "kind", [second.Imu, second.BatteryState, second.Range], ids=lambda kind: kind.__name__
)
def test_other_messages_are_the_second_librarys_too(kind: Any) -> None:
    value = kind(header=second.stamped(1.5, "sensor"))
    read = cdr.decode(getattr(messages, kind.__name__), value.serialize())
    assert flat(read) == flat(value)
    assert cdr.encode(read) == value.serialize()


def test_a_range_without_variance_is_that_of_older_distributions() -> None:
    older = second.OlderRange(second.stamped(2.0), 1, 0.1, 0.02, 0.3, 0.25)
    read = cdr.decode(messages.Range, older.serialize())
    assert read.range == pytest.approx(0.25)
    assert read.variance == 0.0


@pytest.mark.parametrize(("ours", "theirs", "values"), cases)
def test_no_truncated_message_is_read(
    ours: type, theirs: Any, values: st.SearchStrategy[Any]
) -> None:
    @settings(max_examples=100, deadline=None)
    @given(values, st.floats(0.0, 1.0))
    def check(value: Any, share: float) -> None:
        written = value.serialize()
        with pytest.raises(CodecError):
            cdr.decode(ours, written[: int(share * (len(written) - 1))])

    check()


@pytest.mark.parametrize(("ours", "theirs", "values"), cases)
def test_garbage_raises_nothing_but_the_one_error(
    ours: type, theirs: Any, values: st.SearchStrategy[Any]
) -> None:
    @settings(max_examples=200, deadline=None)
    @given(st.binary(max_size=600), st.booleans())
    def check(data: bytes, has_header: bool) -> None:
        with suppress(CodecError):
            cdr.decode(ours, b"\x00\x01\x00\x00" + data if has_header else data)

    check()


def test_what_is_too_long_is_not_read() -> None:
    with pytest.raises(CodecError, match="at most"):
        cdr.decode(messages.LaserScan, bytes(cdr.MAX_PAYLOAD + 1))


@pytest.mark.parametrize("name", HASHES)
def test_type_hashes_are_one_for_all_distributions(name: str) -> None:
    kind = getattr(messages, name)
    assert cdr.type_hash(kind) == HASHES[name]
    assert cdr.known_hashes(kind) == {HASHES[name]}


def test_a_range_has_two_hashes() -> None:
    assert len(cdr.known_hashes(messages.Range)) == 2
    assert cdr.type_hash(messages.Range) in cdr.known_hashes(messages.Range)


def test_bytes_are_those_of_cyclonedds_too() -> None:
    scan = dds_types.LaserScan(
        header=dds_types.Header(dds_types.Time(7, 5), "base_scan"),
        angle_min=-1.5,
        angle_increment=0.25,
        ranges=[0.0, math.inf, 1.5],
        intensities=[1.0, 2.0, 3.0],
    )
    written = scan.serialize()
    read = cdr.decode(messages.LaserScan, written)
    assert read.ranges.tolist() == scan.ranges
    assert cdr.encode(read) == written
    twist = dds_types.Twist(dds_types.Vector3(0.1, 0.0, 0.0), dds_types.Vector3(0.0, 0.0, -0.2))
    assert cdr.encode(twist_message(Twist(0.1, -0.2))) == twist.serialize()

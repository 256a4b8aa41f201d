"""The codec against a second library, in both directions, and against invalid bytes."""

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
from swarmd.drivers.ros import cdr, messages
from tests.drivers.ros2.robots import HASHES
from tests.support import ros2_types as dds
from tests.support.examples import examples

doubles = st.floats(width=64)
singles = st.floats(width=32)
rays = st.lists(singles, max_size=400)
texts = st.text(st.characters(min_codepoint=1, max_codepoint=0x10FFF, exclude_categories=["Cs"]))
times = st.builds(dds.Time, st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
headers = st.builds(dds.Header, times, texts)
vectors = st.builds(dds.Vector3, doubles, doubles, doubles)
twists = st.builds(dds.Twist, vectors, vectors)
covariances = st.lists(doubles, min_size=36, max_size=36)
poses = st.builds(dds.Pose, vectors, st.builds(dds.Quaternion, doubles, doubles, doubles, doubles))
scans = st.builds(dds.LaserScan, headers, *[singles] * 7, rays, rays)
stamped = st.builds(dds.TwistStamped, headers, twists)
odometries = st.builds(
    dds.Odometry,
    headers,
    texts,
    st.builds(dds.PoseWithCovariance, poses, covariances),
    st.builds(dds.TwistWithCovariance, twists, covariances),
)
cases = [
    pytest.param(messages.LaserScan, dds.LaserScan, scans, id="LaserScan"),
    pytest.param(messages.Twist, dds.Twist, twists, id="Twist"),
    pytest.param(messages.TwistStamped, dds.TwistStamped, stamped, id="TwistStamped"),
    pytest.param(messages.Odometry, dds.Odometry, odometries, id="Odometry"),
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
    @settings(max_examples=examples(150), deadline=None)
    @given(values)
    def check(value: Any) -> None:
        written = value.serialize()
        read: object = cdr.decode(ours, written)
        assert flat(read) == flat(value)
        again = cdr.encode(read)
        assert again == written
        assert flat(theirs.deserialize(again)) == flat(value)

    check()


@pytest.mark.parametrize(
    "kind", [dds.Imu, dds.BatteryState, dds.Range], ids=lambda kind: kind.__name__
)
def test_other_messages_are_the_second_librarys_too(kind: Any) -> None:
    value = kind(header=dds.stamped(1.5, "sensor"))
    read = cdr.decode(getattr(messages, kind.__name__), value.serialize())
    assert flat(read) == flat(value)
    assert cdr.encode(read) == value.serialize()


def test_a_range_without_variance_is_that_of_older_distributions() -> None:
    older = dds.OlderRange(dds.stamped(2.0), 1, 0.1, 0.02, 0.3, 0.25)
    read = cdr.decode(messages.Range, older.serialize())
    assert read.range == pytest.approx(0.25)


@pytest.mark.parametrize(("ours", "theirs", "values"), cases)
def test_no_truncated_message_is_read(
    ours: type, theirs: Any, values: st.SearchStrategy[Any]
) -> None:
    @settings(max_examples=examples(100), deadline=None)
    @given(values, st.floats(0.0, 1.0))
    def check(value: Any, share: float) -> None:
        written = value.serialize()
        with pytest.raises(CodecError):
            cdr.decode(ours, written[: int(share * (len(written) - 1))])

    check()


@pytest.mark.parametrize(("ours", "theirs", "values"), cases)
def test_garbage_raises_codec_errors_only(
    ours: type, theirs: Any, values: st.SearchStrategy[Any]
) -> None:
    @settings(max_examples=examples(200), deadline=None)
    @given(st.binary(max_size=600), st.booleans())
    def check(data: bytes, has_header: bool) -> None:
        with suppress(CodecError):
            cdr.decode(ours, b"\x00\x01\x00\x00" + data if has_header else data)

    check()


def test_an_overlong_message_is_not_read() -> None:
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

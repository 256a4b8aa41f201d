from __future__ import annotations

import math

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import Struct

from swarmd.core.codec import MAX_DEPTH, MAX_MESSAGE, Decoder, decode_value, encode, encode_value
from swarmd.core.errors import CodecError
from swarmd.core.messages import DecisionSummary, Epoch, LimitingObstacle
from swarmd.core.verbs import RequestHeader, RunRequest

OPEN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # of a busy machine
@given(OPEN)
def test_open_values_arrive_as_they_were_sent(value: object) -> None:
    try:
        payload = encode_value(value)
    except CodecError:
        return
    assert repr(decode_value(payload)) == repr(value)


@pytest.mark.parametrize("depth", [MAX_DEPTH + 1, 1000, 1021, 1022])
def test_what_nests_too_deep_is_unreadable(depth: int) -> None:
    with pytest.raises(CodecError):
        decode_value(b"\x01" + b"\x91" * depth + b"\xc0")


def test_what_nests_as_deep_as_allowed_is_read() -> None:
    value, depth = decode_value(b"\x01" + b"\x91" * MAX_DEPTH + b"\xc0"), 0
    while value is not None:
        value, depth = value[0], depth + 1
    assert depth == MAX_DEPTH


@pytest.mark.parametrize(
    "value", [msgpack.ExtType(5, b""), [msgpack.Timestamp(1)], {"a": msgpack.Timestamp(1)}]
)
def test_extension_types_are_unreadable(value: object) -> None:
    with pytest.raises(CodecError):
        decode_value(b"\x01" + msgpack.packb(value))


@pytest.mark.parametrize("value", [object(), "x" * MAX_MESSAGE, {1, 2}, 2**70])
def test_an_unsendable_value_is_an_error_and_leaves_nothing_behind(value: object) -> None:
    with pytest.raises(CodecError):
        encode_value([1, value])
    assert encode_value(3) == b"\x01\x03"


@pytest.mark.parametrize(
    "payload", [b"", b"\x02\xc0", b"\x01", b"\x01\xc1", b"\x01" + b"a" * 99999]
)
def test_other_versions_truncated_and_oversized_bytes_are_unreadable(payload: bytes) -> None:
    with pytest.raises(CodecError):
        Decoder(RunRequest)(payload)


@pytest.mark.parametrize(
    "summary",
    [
        *(DecisionSummary(safe_linear=speed) for speed in (math.nan, math.inf, 1e9)),
        *(
            DecisionSummary(rows=(row,))
            for row in (
                LimitingObstacle(9.0, 0.1, 0.1),
                LimitingObstacle(0.0, math.inf, 0.1),
                LimitingObstacle(0.0, 0.1, 1e9),
                LimitingObstacle(0.0, 0.1, 0.1, age=-1.0),
                LimitingObstacle(0.0, 0.1, 0.1, age_cost=1e9),
            )
        ),
    ],
)
def test_bounds_refuse_impossible_speeds_and_obstacles(summary: DecisionSummary) -> None:
    with pytest.raises(CodecError):
        Decoder(DecisionSummary)(encode(summary))


class OlderSummary(Struct):
    """What a peer of another version might say."""

    mode: str = "potential_field"
    is_active: bool = True
    min_gap: float = 0.3
    smell: str = "new here"


def test_a_summary_comes_through_as_it_was_and_one_of_an_older_peer_too() -> None:
    summary = DecisionSummary(
        rows=(LimitingObstacle(-0.5, 0.21, 0.0), LimitingObstacle(3.0, 0.4, 0.1, 0.3, 0.05)),
        is_recovering=True,
    )
    assert Decoder(DecisionSummary)(encode(summary)) == summary
    read = Decoder(DecisionSummary)(encode(OlderSummary()))
    assert (read.is_active, read.rows, read.is_recovering) == (True, (), False)


@given(st.binary(max_size=200))
def test_garbage_raises_nothing_but_codec_errors(garbage: bytes) -> None:
    for read in (Decoder(Epoch), Decoder(RunRequest), Decoder(RequestHeader), decode_value):
        for payload in (garbage, b"\x01" + garbage):
            try:
                read(payload)
            except CodecError:
                continue

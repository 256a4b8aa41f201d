"""Frames of the pattern host arrive whole; what the host must not send is refused."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import (
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    SentEvent,
    Step,
    Stepped,
)
from swarmd.core.values import (
    Inputs,
    Message,
    Neighbor,
    Odometry,
    Outputs,
    Pose,
    Scan,
    TouchZone,
    Twist,
    Value,
)
from swarmd.pattern_host.wire import (
    decode_command,
    decode_event,
    encode_command,
    encode_event,
)
from swarmd.settings.settings import load_platform
from tests.support.range_ring import ring_scan

PLATFORM = load_platform("jackal")
SPEC = PLATFORM.scan
AGES = np.linspace(0.2, 0.0, len(SPEC.bearings))
SCAN = Scan(7, 1.4, np.full(len(SPEC.bearings), np.inf), SPEC.bearings, 0.8, 5.0, AGES, 0.03)


def test_a_load_arrives_whole() -> None:
    load = Load(
        3,
        "drive",
        (("platform", {"speed": 0.1}),),
        "tb3-01",
        PLATFORM,
        42,
        until=("done",),
        origins={"drive": ("a.b:C", False)},
    )
    got = decode_command(encode_command(load))
    assert isinstance(got, Load)
    for name in Load.__struct_fields__:
        if name != "platform":
            assert getattr(got, name) == getattr(load, name)
    for name in ("name", "limits", "provides", "protection", "patterns", "body"):
        assert getattr(got.platform, name) == getattr(PLATFORM, name)
    assert np.array_equal(got.platform.footprint, PLATFORM.footprint)
    assert np.array_equal(got.platform.scan.bearings, SPEC.bearings)
    assert got.platform.scan.offset == SPEC.offset
    assert got.platform.scan.stale_after == SPEC.stale_after


RING = ring_scan(3, 1.5, {0.0: 0.25, 30.0: -math.inf})


def test_inputs_arrive_bit_by_bit() -> None:
    inputs = Inputs(
        now=5.0,
        dt=0.1,
        scan=SCAN,
        is_new_scan=True,
        odometry=Odometry(4.9, Pose(1.0, 2.0, 3.0), Twist(0.1, 0.2)),
        neighbors=(Neighbor("tb3-02", 0.5, 1.0, None, None),),
        messages=(Message("tb3-02", "opinion", {"k": [1, None, b"x"]}, 0.1),),
        readings={"light": 3.0},
        ranges=RING,
    )
    got = decode_command(encode_command(Step(2, inputs)))
    assert isinstance(got, Step)
    scan = got.inputs.scan
    assert scan is not None
    assert (scan.seq, scan.stamp, scan.range_min, scan.range_max) == (7, 1.4, 0.8, 5.0)
    assert scan.ages is not None
    assert scan.newest_age == SCAN.newest_age
    arrays = (scan.ranges, SCAN.ranges), (scan.bearings, SCAN.bearings), (scan.ages, AGES)
    for mine, sent in arrays:
        assert np.array_equal(mine, sent)
        assert mine.dtype == np.float64
        assert not mine.flags.writeable  # as where patterns run inline
    ring = got.inputs.ranges
    assert ring is not None
    assert ring.ranges.tolist() == RING.ranges.tolist()
    assert ring.bearings.tolist() == RING.bearings.tolist()
    for name in ("now", "dt", "is_new_scan", "odometry", "neighbors", "messages", "readings"):
        assert getattr(got.inputs, name) == getattr(inputs, name)


@pytest.mark.parametrize(
    "event",
    [
        Loaded(1, 10.0, frozenset({"a"}), {"speed": (0.1, "robot"), "law": ("paper", "pattern")}),
        Loaded(1, 10.0, frozenset(), {}, TouchZone(0.5, 0.3, 0.1), 1.5, "fast", 0.5),
        LoadRefused(2, "no such pattern"),
        Stepped(3, Outputs(Twist(0.1, -0.2), {"a": 1}, {"state": "go"}, "done"), 9, 2),
        Stepped(3, Outputs(), -1),
        ParamsSet(4, "r1", "", {"speed": (None, "request")}),
        PatternFailed(5, "ZeroDivisionError"),
    ],
)
def test_events_arrive(event: SentEvent) -> None:
    got = decode_event(encode_event(event))
    assert type(got) is type(event)
    assert msgspec.structs.astuple(got) == msgspec.structs.astuple(event)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
@pytest.mark.parametrize(
    "event_of",
    [
        lambda bad: Stepped(3, Outputs(Twist(bad)), 1),
        lambda bad: Stepped(3, Outputs(Twist(lateral=-bad)), 1),
        lambda bad: Loaded(1, 10.0, frozenset(), {}, TouchZone(bad, 0.3, 0.1)),
        lambda bad: Loaded(1, bad, frozenset(), {}),
        lambda bad: Loaded(1, 10.0, frozenset(), {}, took=bad),
        lambda bad: Loaded(1, 10.0, frozenset(), {}, scan_delay=bad),
    ],
)
def test_a_number_out_of_bounds_is_refused(
    event_of: Callable[[float], SentEvent], bad: float
) -> None:
    with pytest.raises(CodecError):
        decode_event(encode_event(event_of(bad)))


@pytest.mark.parametrize(
    "event", [Stepped(3, Outputs(), 1 << 63), Stepped(3, Outputs(), 1, 1 << 63)]
)
def test_a_count_that_no_scan_has_is_refused(event: Stepped) -> None:
    with pytest.raises(CodecError):
        decode_event(encode_event(event))


@pytest.mark.parametrize(
    "outputs",
    [
        Outputs(report={"seen": [1]}),  # type: ignore[dict-item]  # the host is not trusted
        Outputs(done=3),  # type: ignore[arg-type]  # the host is not trusted
        Outputs(messages={3: 1}),  # type: ignore[dict-item]  # the host is not trusted
    ],
)
def test_outputs_of_a_wrong_type_are_refused(outputs: Outputs) -> None:
    with pytest.raises(CodecError):
        decode_event(encode_event(Stepped(1, outputs, 1)))


@given(st.binary(max_size=300))
def test_garbage_from_the_host_raises_only_codec_errors(frame: bytes) -> None:
    try:
        decode_event(frame)
    except CodecError:
        return


@pytest.mark.parametrize("value", [object(), np.zeros(3), "x" * 300_000, 1 << 70])
def test_outputs_that_cannot_be_sent_are_refused(value: Value) -> None:
    with pytest.raises(CodecError, match="Stepped"):
        encode_event(Stepped(1, Outputs(messages={"a": value}), 1))

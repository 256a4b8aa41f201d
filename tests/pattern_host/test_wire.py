from __future__ import annotations

import math

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
    SetParams,
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
)
from swarmd.pattern_host.wire import decode_command, decode_event, encode_command, encode_event
from swarmd.settings.settings import load_platform

PLATFORM = load_platform("jackal")
SPEC = PLATFORM.scan
SCAN = Scan(7, 1.4, np.full(len(SPEC.bearings), np.inf), SPEC.bearings, 0.8, 5.0)


def test_a_load_arrives_whole() -> None:
    load = Load(3, "drive", (("platform", {"speed": 0.1}),), "tb3-01", PLATFORM, 42)
    got, origins = decode_command(encode_command(load, {"drive": ("a.b:C", False)}))
    assert isinstance(got, Load)
    assert (got.generation, got.pattern, got.layers, got.robot, got.seed) == (
        load.generation,
        load.pattern,
        load.layers,
        load.robot,
        load.seed,
    )
    assert origins == {"drive": ("a.b:C", False)}
    assert got.platform.limits == PLATFORM.limits
    assert got.platform.provides == PLATFORM.provides
    assert got.platform.protection == PLATFORM.protection
    assert np.array_equal(got.platform.footprint, PLATFORM.footprint)
    assert np.array_equal(got.platform.scan.bearings, SPEC.bearings)
    assert got.platform.scan.offset == SPEC.offset
    assert got.platform.scan.stale_after == SPEC.stale_after


def test_inputs_arrive_bit_by_bit() -> None:
    inputs = Inputs(
        now=5.0,
        dt=0.1,
        scan=SCAN,
        is_new_scan=True,
        odometry=Odometry(4.9, Pose(1.0, 2.0, 3.0), Twist(0.1, 0.2)),
        neighbors=(Neighbor("tb3-02", 0.5, 1.0, None, None),),
        messages=(Message("tb3-02", "opinion", {"k": [1, None]}, 0.1),),
        readings={"light": 3.0},
    )
    got, _ = decode_command(encode_command(Step(2, inputs), {}))
    assert isinstance(got, Step)
    assert got.inputs.scan is not None
    assert np.array_equal(got.inputs.scan.ranges, SCAN.ranges)
    assert np.array_equal(got.inputs.scan.bearings, SCAN.bearings)
    assert got.inputs.odometry == inputs.odometry
    assert got.inputs.neighbors == inputs.neighbors
    assert got.inputs.scan is not None
    assert not got.inputs.scan.ranges.flags.writeable  # as where patterns run inline
    assert got.inputs.messages == inputs.messages
    assert got.inputs.readings == inputs.readings


def test_set_params_arrives() -> None:
    got, _ = decode_command(encode_command(SetParams(2, "r1", {"speed": "0.1"}), {}))
    assert isinstance(got, SetParams)
    assert (got.request, got.values) == ("r1", {"speed": "0.1"})


@pytest.mark.parametrize(
    "event",
    [
        Loaded(1, 10.0, frozenset({"a"}), {"speed": (0.1, "robot"), "law": ("paper", "pattern")}),
        Loaded(1, 10.0, frozenset(), {}, TouchZone(0.5, 0.3, 0.1), 1.5),
        LoadRefused(2, "no such pattern"),
        Stepped(3, Outputs(Twist(0.1, -0.2), {"a": 1}, {"state": "go"}, "done"), 9, 2),
        Stepped(3, Outputs(), -1),
        ParamsSet(4, "r1", "", {"speed": (None, "runtime")}),
        PatternFailed(5, "ZeroDivisionError"),
    ],
)
def test_events_arrive(event: Loaded | LoadRefused | Stepped | ParamsSet | PatternFailed) -> None:
    got = decode_event(encode_event(event))
    assert type(got) is type(event)
    for name in type(event).__annotations__:
        assert getattr(got, name) == getattr(event, name)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_a_wish_out_of_all_bounds_is_unreadable(bad: float) -> None:
    frame = encode_event(Stepped(3, Outputs(Twist(bad)), 1))
    with pytest.raises(CodecError):
        decode_event(frame)


@given(st.binary(max_size=300))
def test_garbage_from_the_host_raises_nothing_but_codec_errors(frame: bytes) -> None:
    try:
        decode_event(frame)
    except CodecError:
        return


def test_outputs_that_cannot_be_told_or_are_too_big_are_refused() -> None:
    with pytest.raises(CodecError, match="MessagePack"):
        encode_event(Stepped(1, Outputs(messages={"a": object()}), 1))  # type: ignore[dict-item]
    with pytest.raises(CodecError, match="at most"):
        encode_event(Stepped(1, Outputs(messages={"a": "x" * 300_000}), 1))

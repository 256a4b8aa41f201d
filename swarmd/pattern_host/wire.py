"""The bytes between the guardian and its pattern host: one MessagePack record per frame.

The guardian trusts nothing that comes back: events are decoded into bounded structs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import msgpack
import msgspec
import numpy as np
from msgspec import Meta, Struct

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import (
    HostEvent,
    Layers,
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    SetParams,
    Step,
    Stepped,
)
from swarmd.core.messages import Scalar
from swarmd.core.values import (
    Array,
    Inputs,
    Limits,
    Message,
    Neighbor,
    Odometry,
    Outputs,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    TouchZone,
    Twist,
)

MAX_FRAME = 200_000  # a record above about 212 kB does not fit into the socket's buffer
Speed = Annotated[float, Meta(ge=-1e6, le=1e6)]
Origins = Mapping[str, tuple[str, bool]]  # pattern name -> (module:Class or path, is it a file)


def encode_command(command: Load | Step | SetParams, origins: Origins) -> bytes:
    """The frame of a command; a Load carries where each pattern is found. CodecError if too big."""
    if isinstance(command, Load):
        body: list[Any] = ["load", command.generation, command.pattern, list(command.layers)]
        body += [command.robot, _from_platform(command.platform), command.seed]
        body += [{name: list(origin) for name, origin in origins.items()}, list(command.until)]
    elif isinstance(command, Step):
        body = ["step", command.generation, _from_inputs(command.inputs)]
    else:
        body = ["set", command.generation, command.request, dict(command.values)]
    try:
        frame: bytes = msgpack.packb(body)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise CodecError(f"a {body[0]} frame cannot be made: {error}") from error
    if len(frame) > MAX_FRAME:
        raise CodecError(f"a {body[0]} frame has {len(frame)} bytes; at most {MAX_FRAME} fit")
    return frame


def decode_command(frame: bytes) -> tuple[Load | Step | SetParams, Origins]:
    """The guardian's command, and with a Load where each pattern is found."""
    kind, generation, *rest = msgpack.unpackb(frame, strict_map_key=False)
    if kind == "load":
        pattern, layers, robot, platform, seed, origins, until = rest
        named: Layers = tuple((source, values) for source, values in layers)
        of = _to_platform(platform)
        load = Load(generation, pattern, named, robot, of, seed, until=tuple(until))
        return load, {name: (value, is_file) for name, (value, is_file) in origins.items()}
    if kind == "step":
        return Step(generation, _to_inputs(rest[0])), {}
    return SetParams(generation, rest[0], rest[1]), {}


class _ReadyWire(Struct, frozen=True, array_like=True, tag="ready"):
    generation: int
    rate: Annotated[float, Meta(ge=0.1, le=1000.0)]
    channels: list[str]
    params: dict[str, tuple[Scalar | None, str]]
    touches: tuple[Speed, Speed, Speed] | None
    took: Annotated[float, Meta(ge=0.0, le=1e6)]


class _RefusedWire(Struct, frozen=True, array_like=True, tag="refused"):
    generation: int
    text: str


class _SteppedWire(Struct, frozen=True, array_like=True, tag="stepped"):
    generation: int
    twist: tuple[Speed, Speed, Speed] | None
    messages: dict[str, Any]
    report: dict[str, Any]
    done: str | None
    scan_seq: int
    dropped: int


class _ParamsWire(Struct, frozen=True, array_like=True, tag="params"):
    generation: int
    request: str
    text: str
    params: dict[str, tuple[Scalar | None, str]]


class _FailedWire(Struct, frozen=True, array_like=True, tag="failed"):
    generation: int
    text: str


_Wire = _ReadyWire | _RefusedWire | _SteppedWire | _ParamsWire | _FailedWire
_events: msgspec.msgpack.Decoder[_Wire] = msgspec.msgpack.Decoder(_Wire)


def encode_event(event: HostEvent) -> bytes:
    """The frame of an event; CodecError if it cannot be told or is too big."""
    generation = event.generation
    if isinstance(event, Loaded):
        params = {name: list(pair) for name, pair in event.params.items()}
        zone = event.touches
        touches = None if zone is None else [zone.bearing, zone.half_width, zone.speed]
        body: list[Any] = ["ready", generation, event.rate, sorted(event.channels), params]
        body += [touches, event.took]
    elif isinstance(event, Stepped):
        outputs = event.outputs
        twist = outputs.twist
        requested = None if twist is None else [twist.linear, twist.angular, twist.lateral]
        body = ["stepped", generation, requested, dict(outputs.messages), dict(outputs.report)]
        body += [outputs.done, event.scan_seq, event.dropped]
    elif isinstance(event, ParamsSet):
        params = {name: list(pair) for name, pair in event.params.items()}
        body = ["params", generation, event.request, event.text, params]
    else:
        kind = "refused" if isinstance(event, LoadRefused) else "failed"
        body = [kind, generation, event.text]
    try:
        frame: bytes = msgpack.packb(body)
    except (TypeError, ValueError, OverflowError) as error:
        raise CodecError(f"outputs must be made of MessagePack's types: {error}") from error
    if len(frame) > MAX_FRAME:
        raise CodecError(f"outputs of {len(frame)} bytes; at most {MAX_FRAME} fit")
    return frame


def decode_event(frame: bytes) -> HostEvent:
    """The host's event; CodecError if it is none, or holds a number out of all bounds."""
    try:
        wire = _events.decode(frame)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise CodecError(f"the pattern host said something unreadable: {error}") from error
    if isinstance(wire, _ReadyWire):
        touches = None if wire.touches is None else TouchZone(*wire.touches)
        channels = frozenset(wire.channels)
        return Loaded(wire.generation, wire.rate, channels, wire.params, touches, wire.took)
    if isinstance(wire, _SteppedWire):
        twist = None if wire.twist is None else Twist(*wire.twist)
        report = {k: v for k, v in wire.report.items() if isinstance(v, bool | int | float | str)}
        outputs = Outputs(twist, wire.messages, report, wire.done)
        return Stepped(wire.generation, outputs, wire.scan_seq, wire.dropped)
    if isinstance(wire, _ParamsWire):
        return ParamsSet(wire.generation, wire.request, wire.text, wire.params)
    if isinstance(wire, _RefusedWire):
        return LoadRefused(wire.generation, wire.text)
    return PatternFailed(wire.generation, wire.text)


def _from_inputs(inputs: Inputs) -> list[Any]:
    scan, odometry = inputs.scan, inputs.odometry
    return [
        inputs.now,
        inputs.dt,
        None
        if scan is None
        else [
            scan.seq,
            scan.stamp,
            scan.ranges.tobytes(),
            scan.bearings.tobytes(),
            scan.range_min,
            scan.range_max,
        ],
        inputs.is_new_scan,
        None if odometry is None else _from_odometry(odometry),
        [[n.id, n.age, n.distance, n.bearing, n.heading] for n in inputs.neighbors],
        [[m.sender, m.channel, m.value, m.age] for m in inputs.messages],
        dict(inputs.readings),
    ]


def _to_inputs(body: list[Any]) -> Inputs:
    now, dt, scan, is_new_scan, odometry, neighbors, messages, readings = body
    return Inputs(
        now=now,
        dt=dt,
        scan=None if scan is None else _to_scan(scan),
        is_new_scan=is_new_scan,
        odometry=None if odometry is None else _to_odometry(odometry),
        neighbors=tuple(Neighbor(*neighbor) for neighbor in neighbors),
        messages=tuple(Message(*message) for message in messages),
        readings=readings,
    )


def _to_scan(body: list[Any]) -> Scan:
    seq, stamp, ranges, bearings, range_min, range_max = body
    return Scan(seq, stamp, _array(ranges), _array(bearings), range_min, range_max)


def _array(data: bytes) -> Array:
    array = np.frombuffer(data, dtype=np.float64).copy()
    array.flags.writeable = False  # as it is where patterns run inline
    return array


def _from_odometry(odometry: Odometry) -> list[float]:
    pose, twist = odometry.pose, odometry.twist
    measured = [twist.linear, twist.angular, twist.lateral]
    return [odometry.stamp, pose.x, pose.y, pose.yaw, *measured]


def _to_odometry(body: list[float]) -> Odometry:
    stamp, x, y, yaw, linear, angular, lateral = body
    return Odometry(stamp, Pose(x, y, yaw), Twist(linear, angular, lateral))


def _from_platform(platform: Platform) -> dict[str, Any]:
    spec, limits = platform.scan, platform.limits
    scan = [spec.bearings.tobytes(), spec.rate, spec.range_min, spec.range_max]
    scan += [list(spec.offset), spec.max_gap, spec.zero, spec.is_noisy, spec.near, spec.latency]
    return {
        "name": platform.name,
        "limits": [limits.linear, limits.angular, limits.lateral],
        "footprint": platform.footprint.tolist(),
        "scan": scan,
        "provides": sorted(platform.provides),
        "protection": dict(platform.protection),
        "patterns": {name: dict(values) for name, values in platform.patterns.items()},
        "body": dict(platform.body),
    }


def _to_platform(body: dict[str, Any]) -> Platform:
    bearings, rate, range_min, range_max, offset, *rest = body["scan"]
    spec = ScanSpec(_array(bearings), rate, range_min, range_max, tuple(offset), *rest)
    return Platform(
        name=body["name"],
        limits=Limits(*body["limits"]),
        footprint=np.array(body["footprint"], dtype=np.float64),
        scan=spec,
        provides=frozenset(body["provides"]),
        protection=body["protection"],
        patterns=body["patterns"],
        body=body["body"],
    )

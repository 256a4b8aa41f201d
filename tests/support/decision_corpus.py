"""Decisions of mode `barrier` as a file: what one robot was given, scan by scan and request."""

from __future__ import annotations

import lzma
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.values import Odometry, Platform, Scan, Twist
from swarmd.robot.protection.decision import DecisionContext, ModeDecision, ToldObstacle
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.modes import Mode
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import under_barrier

FILE = Path(__file__).parent.parent / "robot/protection" / "decisions.json.xz"
_NOTHING, _TOO_CLOSE = -1, -2  # a range in mm


class Event(Struct, array_like=True):
    """A decision on `requested`, or a scan: `ranges` in mm.

    `twist` and `is_active`: what was decided when the file was written. `bearings` in
    tenths of mrad and `ages` in ms are those of a scan that was moved to the time of its newest
    ray; empty: the platform's, all of one instant.
    """

    context: DecisionContext
    ranges: list[int] = []
    requested: Twist | None = None
    command: Twist | None = None
    twist: Twist | None = None
    is_active: bool = False
    bearings: list[int] = []
    ages: list[int] = []
    newest_age: float | None = None


class Stream(Struct, array_like=True):
    """The events of one robot, with its kind and its settings of mode `barrier`."""

    scene: str
    kind: str
    settings: dict[str, Any]
    events: list[Event]


def platform_of(stream: Stream) -> Platform:
    """The platform of the robot."""
    return under_barrier(load_platform(stream.kind), **stream.settings)


def decided(stream: Stream, barrier: Mode) -> Iterator[tuple[Event, ModeDecision]]:
    """The decisions of a mode that is given the events."""
    platform = platform_of(stream)
    geometry = ScanGeometry(platform.scan)
    for seq, event in enumerate(stream.events):
        if event.requested is None:
            barrier.observe(_scan(platform, event, seq), geometry, event.context)
        else:
            command = event.command or Twist()
            yield event, barrier.decide(event.requested, event.context, command=command, touch=None)


def scan_event(scan: Scan, furthest: float, context: DecisionContext) -> Event:
    """The event of a scan; ranges beyond `furthest` m are left out."""
    ranges = [
        _TOO_CLOSE if one == -math.inf else _NOTHING if one > furthest else round(1000.0 * one)
        for one in scan.ranges.tolist()
    ]
    event = Event(rounded(context), ranges, newest_age=scan.newest_age)
    if scan.ages is not None:
        event.bearings = np.rint(10_000.0 * scan.bearings).astype(int).tolist()
        event.ages = np.rint(1000.0 * scan.ages).astype(int).tolist()
    return event


def rounded(context: DecisionContext) -> DecisionContext:
    """The context with six decimals."""
    odometry = context.odometry
    some = [context.now, context.scan_age, context.odometry_age]
    now, scan_age, odometry_age = (None if one is None else round(one, 6) for one in some)
    if odometry is not None:
        pose, twist = msgspec.to_builtins((odometry.pose, odometry.twist))
        numbers = (round(odometry.stamp, 6), [_six(n) for n in pose], [_six(n) for n in twist])
        odometry = msgspec.convert(numbers, Odometry)
    told = tuple(
        ToldObstacle(*(_six(n) for n in (one.x, one.y, one.radius, one.age)))
        for one in context.told
    )
    delay = _six(context.scan_delay)
    return DecisionContext(now or 0.0, scan_age, odometry, odometry_age, delay, told)


def short(twist: Twist) -> Twist:
    """The twist with six decimals."""
    return Twist(_six(twist.linear), _six(twist.angular), _six(twist.lateral))


def read() -> list[Stream]:
    """The streams of the file."""
    return msgspec.json.decode(lzma.decompress(FILE.read_bytes()), type=list[Stream])


def write(streams: Sequence[Stream]) -> None:
    """Write the file."""
    FILE.write_bytes(lzma.compress(msgspec.json.encode(streams), preset=9))


def _six(number: float) -> float:
    return round(number, 6)


def _scan(platform: Platform, event: Event, seq: int) -> Scan:
    there = np.array(event.ranges, np.float64) / 1000.0
    there[there == _NOTHING / 1000.0] = np.inf
    there[there == _TOO_CLOSE / 1000.0] = -np.inf
    if not event.bearings:
        return scan_from(platform, there, platform.scan.bearings, seq=seq)
    scan = scan_from(platform, there, np.array(event.bearings, np.float64) / 10_000.0, seq=seq)
    ages = np.array(event.ages, np.float64) / 1000.0
    return replace(scan, ages=ages, newest_age=event.newest_age)

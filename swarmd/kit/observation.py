"""Observations and actions of a learned policy: their declaration, and their numbers.

A policy is trained in the environment of `sim/learning` and runs on robots as `PolicyPattern`. Both
call the functions of this file, so a policy gets the same observations on a robot as in training.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Inputs, Limits, Platform, Twist, has_places
from swarmd.kit.robot_detection import robots_near
from swarmd.robot.sensing.rays import Ray, sectors

MAX_SIZE = 4096
"""Numbers of one observation."""

Observation = NDArray[np.float32]
Sectors = Annotated[int, Meta(ge=1, le=360)]
Distance = Annotated[float, Meta(gt=0.0, le=1000.0)]


class _Part(Struct, frozen=True, tag_field="part", forbid_unknown_fields=True):
    """A part of an observation."""


class ScanPart(_Part, frozen=True, tag="scan"):
    """The nearness of obstacles in each of `sectors` equal sectors of the scan, as numbers.

    Nearness falls from 1 at the sensor to -1 at `range` m; -1 also beyond `range`, and without a
    return. Sector 0 is centred ahead; the further sectors follow counter-clockwise.
    """

    sectors: Sectors = 12
    range: Distance = 3.5


class RobotsPart(_Part, frozen=True, tag="robots"):
    """The nearness, from 1 at the sensor to -1 at `range`, of objects as narrow as a robot.

    A number for each of `sectors` equal sectors of the scan; sector 0 is centred ahead. A pillar
    counts as a robot, and a robot that stands at a wall does not (kit/robot_detection.py).
    """

    sectors: Sectors = 12
    range: Distance = 3.5


class NeighborsPart(_Part, frozen=True, tag="neighbors"):
    """The neighbours by range and bearing: their number, then the nearest `count` of them.

    The number of neighbours is scaled from [0, `count`] to [-1, 1]. Three numbers follow for each
    neighbour: nearness (see ScanPart), cosine and sine of the bearing; -1, 0, 0 for a missing
    neighbour.
    """

    count: Annotated[int, Meta(ge=1, le=64)] = 3
    range: Distance = 3.5


class ReadingPart(_Part, frozen=True, tag="reading"):
    """The reading `name`, scaled from [`low`, `high`] to [-1, 1]; 0 without a reading."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*\Z", max_length=63)]
    low: float = 0.0
    high: float = 1.0


class TwistPart(_Part, frozen=True, tag="twist"):
    """The measured linear and angular speed (with `lateral` also the lateral), over its limit."""

    lateral: bool = False


Part = ScanPart | RobotsPart | NeighborsPart | ReadingPart | TwistPart


class PolicySpec(Struct, frozen=True, forbid_unknown_fields=True):
    """The declaration of a policy: the `parts` of its observation, in order, and its actions.

    An action has two numbers in [-1, 1]: linear speed and angular speed. With `lateral` the lateral
    speed is a third number. A policy decides every `period` s.
    """

    parts: Annotated[tuple[Part, ...], Meta(min_length=1, max_length=64)]
    lateral: bool = False
    period: Annotated[float, Meta(ge=0.1, le=10.0)] = 0.1

    def __post_init__(self) -> None:
        """ValueError for an observation that is too large, or a reading without a range."""
        if self.size > MAX_SIZE:
            raise ValueError(
                f"the observation has {self.size} numbers; expected {MAX_SIZE} or less"
            )
        for part in self.parts:
            if isinstance(part, ReadingPart) and not -math.inf < part.low < part.high < math.inf:
                raise ValueError(
                    f"reading {part.name} is from {part.low:g} to {part.high:g}; low must be lower"
                )

    @property
    def size(self) -> int:
        """The numbers of an observation."""
        return sum(map(_size, self.parts))

    @property
    def actions(self) -> int:
        """The numbers of an action."""
        return 3 if self.lateral else 2

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number of an observation, such as `scan.0`."""
        return tuple(name for part in self.parts for name in _names(part))

    @property
    def needs(self) -> frozenset[str]:
        """What the robot must provide, in the words of `Pattern.needs`."""
        return frozenset(word for part in self.parts for word in _needs(part))


def default_spec(platform: Platform) -> PolicySpec:
    """The default declaration: all parts that the platform's own sensors provide."""
    reach = min(platform.scan.range_max, 3.5)
    parts: list[Part] = []
    if "scan" in platform.provides:
        parts += [ScanPart(range=reach), RobotsPart(range=reach)]
    if has_places(platform):
        parts.append(NeighborsPart())
    is_lateral = platform.limits.lateral > 0.0
    parts.append(TwistPart(lateral=is_lateral))
    return PolicySpec(tuple(parts), lateral=is_lateral)


def encode_spec(spec: PolicySpec) -> bytes:
    """The declaration as JSON."""
    return msgspec.json.encode(spec)


def decode_spec(data: bytes) -> PolicySpec:
    """The declaration in JSON; ConfigError names what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=PolicySpec)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"declaration of a policy: {error}") from error


def check_spec(spec: PolicySpec) -> None:
    """ConfigError for a declaration that cannot be read back from a file, such as a period of 0."""
    try:
        data = encode_spec(spec)
    except TypeError as error:
        raise ConfigError(f"declaration of a policy: {error}; expected plain numbers") from error
    decode_spec(data)


def observe(spec: PolicySpec, inputs: Inputs, platform: Platform) -> Observation:
    """The observation (size,) of `spec` from the inputs of a pattern, each number in [-1, 1]."""
    values = [value for part in spec.parts for value in _values(part, inputs, platform)]
    clipped: Observation = np.clip(np.array(values, dtype=np.float32), -1.0, 1.0)
    return clipped


def requested_twist(spec: PolicySpec, action: Array, scale: Limits) -> Twist:
    """The twist that an action (actions,) requests; 1 is `scale`, and more than 1 counts as 1."""
    linear, angular, *lateral = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0).tolist()
    return Twist(
        linear * scale.linear,
        angular * scale.angular,
        lateral[0] * scale.lateral if spec.lateral else 0.0,
    )


def _size(part: Part) -> int:
    if isinstance(part, ScanPart | RobotsPart):
        return part.sectors
    if isinstance(part, NeighborsPart):
        return 1 + 3 * part.count
    return 1 if isinstance(part, ReadingPart) else 2 + part.lateral


def _names(part: Part) -> Iterator[str]:
    kind = str(part.__struct_config__.tag)
    if isinstance(part, ReadingPart):
        yield f"reading.{part.name}"
    elif isinstance(part, TwistPart):
        yield from (f"twist.{word}" for word in ("linear", "angular", "lateral")[: _size(part)])
    elif isinstance(part, NeighborsPart):
        yield "neighbors.count"
        for place in range(part.count):
            yield from (f"neighbors.{place}.{word}" for word in ("nearness", "cos", "sin"))
    else:
        yield from (f"{kind}.{sector}" for sector in range(part.sectors))


def _needs(part: Part) -> tuple[str, ...]:
    if isinstance(part, ScanPart | RobotsPart):
        return ("scan",)
    if isinstance(part, NeighborsPart):
        return ("neighbors.bearing", "neighbors.distance")
    return (f"reading:{part.name}",) if isinstance(part, ReadingPart) else ("odometry",)


def _values(part: Part, inputs: Inputs, platform: Platform) -> list[float]:
    if isinstance(part, ScanPart):
        near = sectors(inputs.scan, part.sectors)
        nearness: list[float] = (1.0 - 2.0 * np.minimum(near, part.range) / part.range).tolist()
        return nearness
    if isinstance(part, RobotsPart):
        return _by_sector(robots_near(inputs.scan, platform, within=part.range), part)
    if isinstance(part, NeighborsPart):
        return _neighbors(part, inputs)
    if isinstance(part, ReadingPart):
        reading = inputs.readings.get(part.name, math.nan)
        share = (reading - part.low) / (part.high - part.low)
        return [0.0 if math.isnan(share) else 2.0 * share - 1.0]
    odometry = inputs.odometry
    limits = platform.limits
    twist = Twist() if odometry is None else odometry.twist
    pairs = [(twist.linear, limits.linear), (twist.angular, limits.angular)]
    if part.lateral:
        pairs.append((twist.lateral, limits.lateral))
    return [value / limit if limit > 0.0 else 0.0 for value, limit in pairs]


def _by_sector(rays: list[Ray], part: RobotsPart) -> list[float]:
    values = [-1.0] * part.sectors
    for distance, bearing in reversed(rays):  # the nearest comes last, and remains
        sector = round(bearing * part.sectors / (2.0 * math.pi)) % part.sectors
        values[sector] = _nearness(distance, part.range)
    return values


def _neighbors(part: NeighborsPart, inputs: Inputs) -> list[float]:
    sensed = sorted(
        (neighbor.distance, neighbor.bearing)
        for neighbor in inputs.neighbors
        if neighbor.distance is not None
        and neighbor.bearing is not None
        and neighbor.distance <= part.range
    )
    values = [2.0 * min(len(sensed), part.count) / part.count - 1.0]
    for distance, bearing in sensed[: part.count]:
        values += [_nearness(distance, part.range), math.cos(bearing), math.sin(bearing)]
    return values + [-1.0, 0.0, 0.0] * (part.count - len(sensed[: part.count]))


def _nearness(distance: float, reach: float) -> float:
    return 1.0 - 2.0 * min(distance, reach) / reach

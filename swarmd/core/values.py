"""What flows through one robot: plain values, SI units and radians.

Frames follow REP 103 and 105: x forward, y left, yaw counter-clockwise. Constructors do not
validate; decoding and configuration do. What is made anew many times a second is a msgspec Struct:
that takes a tenth of the time of a frozen dataclass (change one with `msgspec.structs.replace`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Scalar: TypeAlias = bool | int | float | str
# A value of a parameter or message: MessagePack's own types.
if TYPE_CHECKING:
    Value: TypeAlias = "bool | int | float | str | bytes | list[Value] | dict[str, Value] | None"
else:
    Value = Any  # msgspec decodes no union of str and bytes


class Twist(Struct, frozen=True, array_like=True):
    """A velocity in the base frame: linear and lateral in m/s, angular in rad/s."""

    linear: float = 0.0
    angular: float = 0.0
    lateral: float = 0.0

    @property
    def is_zero(self) -> bool:
        """True if nothing is to move."""
        return self.linear == 0.0 and self.angular == 0.0 and self.lateral == 0.0

    @property
    def is_finite(self) -> bool:
        """True if no component is NaN or infinite."""
        return (
            math.isfinite(self.linear)
            and math.isfinite(self.angular)
            and math.isfinite(self.lateral)
        )


ZERO = Twist()


class TouchZone(Struct, frozen=True, array_like=True):
    """Where and how fast a robot may close on what it touches, for patterns that push or dock.

    The directions in which its outline may press, `bearing` +- `half_width` in rad, of the shortest
    way from the outline to what is there; `speed` in m/s, the fastest that it may move that way.
    """

    bearing: float
    half_width: float
    speed: float


class Pose(Struct, frozen=True, array_like=True):
    """Position in m and yaw in rad, in the frame the owner of the value names."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def is_finite(self) -> bool:
        """True if neither position nor yaw is NaN or infinite."""
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.yaw)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Rays of one sweep in the base frame's directions, measured from the sensor.

    `ranges` and `bearings` are (n,) float64 arrays of the same length; n may vary from scan to
    scan. A range is in m: +inf nothing seen, -inf too close to measure, NaN unknown. `bearings`
    are in rad, 0 ahead, counter-clockwise positive. `stamp` is the sensor's own clock in s: only
    its progress means something.
    """

    seq: int
    stamp: float
    ranges: Array
    bearings: Array
    range_min: float
    range_max: float


class Odometry(Struct, frozen=True, array_like=True):
    """Pose in the odometry frame and measured twist in the base frame."""

    stamp: float
    pose: Pose
    twist: Twist


class Neighbor(Struct, frozen=True, array_like=True):
    """A robot that is near, as far as it is sensed.

    `age` is the time in s since it was heard, to within 0.5 s; `distance` in m, `bearing` and
    `heading` in rad, relative to this robot; None means not sensed.
    """

    id: str
    age: float
    distance: float | None = None
    bearing: float | None = None
    heading: float | None = None


class Message(Struct, frozen=True, array_like=True):
    """What a neighbour's pattern said; `sender` comes from the key, never from the payload."""

    sender: str
    channel: str
    value: Value
    age: float


@dataclass(frozen=True, slots=True)
class Limits:
    """What the base can do: m/s, rad/s, m/s (0 for bases without lateral motion)."""

    linear: float
    angular: float
    lateral: float = 0.0

    def clip(self, twist: Twist) -> Twist:
        """The twist with each component held within its limit; the only place that does so."""
        linear, angular, lateral = self.linear, self.angular, self.lateral
        if (
            -linear <= twist.linear <= linear
            and -angular <= twist.angular <= angular
            and -lateral <= twist.lateral <= lateral
        ):
            return twist
        return Twist(
            min(max(twist.linear, -linear), linear),
            min(max(twist.angular, -angular), angular),
            min(max(twist.lateral, -lateral), lateral),
        )


@dataclass(frozen=True, slots=True)
class ScanSpec:
    """What the platform's range sensor is like.

    `bearings` (n,) rad are the nominal directions, `rate` in Hz, ranges in m, `offset` the
    sensor's (x, y) in the base frame in m, `max_gap` rad the widest unknown sector that may be
    bridged, `zero` what a range of exactly 0 means: no_return, too_close, unknown or lds (the
    rule for the LDS family in `scans.py`), `is_noisy` whether identical scans betray a frozen
    sensor, `stale_after` in s. `near` says whether the sensor tells of what is nearer than
    `range_min`, or gives the same as for nothing. `latency` is the mean age of its rays in s when
    a sweep arrives.
    """

    bearings: Array
    rate: float
    range_min: float
    range_max: float
    offset: tuple[float, float] = (0.0, 0.0)
    max_gap: float = math.radians(12.0)
    zero: str = "no_return"
    is_noisy: bool = True
    near: Literal["reported", "lost"] = "reported"
    latency: float = 0.0

    @property
    def stale_after(self) -> float:
        """Seconds after which a scan is too old: 3.5 nominal periods within 0.35 to 1.0 s."""
        return min(max(3.5 / self.rate, 0.35), 1.0)

    @property
    def slowest_period(self) -> float:
        """Seconds between scans beyond which `rate` is not this sensor's."""
        return min(2.0 / self.rate, self.stale_after)


@dataclass(frozen=True, slots=True, eq=False)
class Platform:
    """One kind of robot, from its file in config/platforms.

    `footprint` is a (k, 2) convex polygon, counter-clockwise, in the base frame in m.
    `protection` holds the settings of the arbiter: `mode`, the values of the potential field's
    preset in force, and those of `barrier` and `stop_zone` under these names (None: not given);
    `patterns` parameters by pattern name; `drivers` options by driver name; `body` what the
    simulated world needs (mass, heights, wheel base, lidar target radius ...).
    """

    name: str
    limits: Limits
    footprint: Array
    scan: ScanSpec
    provides: frozenset[str]
    protection: Mapping[str, Any]
    patterns: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    drivers: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    body: Mapping[str, float] = field(default_factory=dict)


class Inputs(Struct, frozen=True, eq=False, array_like=True):
    """All that a pattern gets for one step.

    `now` in s on the robot's monotonic clock, `dt` the time since its last step (0 at the
    first). `scan` is the latest conditioned scan (None before the first), `is_new_scan` true
    once a scan. `messages` are those heard since the last step.
    """

    now: float
    dt: float
    scan: Scan | None = None
    is_new_scan: bool = False
    odometry: Odometry | None = None
    neighbors: tuple[Neighbor, ...] = ()
    messages: tuple[Message, ...] = ()
    readings: Mapping[str, float] = {}


class Outputs(Struct, frozen=True, array_like=True):
    """What a pattern gives back from one step.

    `twist` None: no wish, the robot stands. `messages` by channel. `report` shows up in
    members, describe and traces (state, opinion ...). `done` is the reason it has finished.
    """

    twist: Twist | None = None
    messages: Mapping[str, Value] = {}
    report: Mapping[str, Scalar] = {}
    done: str | None = None

"""Plain values that pass through one robot, in SI units and radians.

Frames follow REP 103 and 105: x forward, y left, yaw counter-clockwise. Constructors do not
validate; decoding and configuration do. Values made many times a second are msgspec structs: making
one takes a tenth of the time of a frozen dataclass (change one with `msgspec.structs.replace`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from swarmd.core.bounds import MAX_COORDINATE
from swarmd.core.errors import unknown

Array: TypeAlias = NDArray[np.float64]
Scalar: TypeAlias = bool | int | float | str
# A value of a parameter or message: MessagePack's own types.
if TYPE_CHECKING:
    Value: TypeAlias = "bool | int | float | str | bytes | list[Value] | dict[str, Value] | None"
else:
    Value = Any  # msgspec decodes no union of str and bytes


class Twist(Struct, frozen=True, array_like=True, gc=False):
    """A velocity in the base frame; a component that is not given is 0.

    - `linear`: m/s ahead; a negative value drives backward.
    - `angular`: rad/s counter-clockwise: a positive value turns left.
    - `lateral`: m/s to the left, for a base that moves sideways; other bases have the limit 0.
    """

    linear: float = 0.0
    angular: float = 0.0
    lateral: float = 0.0

    @property
    def is_zero(self) -> bool:
        """True if all components are zero."""
        return self.linear == 0.0 and self.angular == 0.0 and self.lateral == 0.0

    @property
    def is_finite(self) -> bool:
        """True if no component is NaN or infinite."""
        # 0 times NaN or infinity is NaN; three calls of math.isfinite take twice as long.
        return self.linear * 0.0 + self.angular * 0.0 + self.lateral * 0.0 == 0.0


ZERO = Twist()


class TouchZone(Struct, frozen=True, array_like=True):
    """Directions and speed in which a robot may close on an obstacle, to push or to dock.

    The direction of an obstacle is that of the shortest line from the outline to the obstacle. The
    outline may touch an obstacle in a direction within `bearing` +- `half_width` in rad. `speed` in
    m/s is the limit of the speed towards such an obstacle.
    """

    bearing: float
    half_width: float
    speed: float


class Pose(Struct, frozen=True, array_like=True, gc=False):
    """Position in m and yaw in rad, in the frame that the owner of the value names."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def is_finite(self) -> bool:
        """True if neither position nor yaw is NaN or infinite."""
        return self.x * 0.0 + self.y * 0.0 + self.yaw * 0.0 == 0.0


class Scan(Struct, frozen=True, eq=False, dict=True):
    """Rays of one revolution, in directions of the base frame, measured from the sensor.

    - `seq`: the number of the scan, which rises.
    - `stamp`: s at which the oldest ray was measured, on the sensor's own clock.
    - `ranges`: (n,) float64 in m: +inf no return, -inf too close to measure, NaN unknown. n may
      vary from scan to scan.
    - `bearings`: (n,) float64 in rad, 0 ahead, counter-clockwise positive.
    - `range_min`: the least range in m that the sensor measures, by the platform's file.
    - `range_max`: the greatest range in m that the sensor measures, by the platform's file.
    - `ages`: (n,) s by which each ray is older than the newest ray. None in a raw scan: unknown.
      None in a conditioned scan: all rays have the same time.
    - `newest_age`: age in s of the newest ray of a conditioned scan on arrival, by the platform's
      `latency`; None for a raw scan.
    - `filled`: (n,) 1 for each ray of a conditioned scan that this scan did not measure, and whose
      range comes from an earlier scan or from the rays beside it, else 0. None: no such ray.
    - `borrowed`: how many rays, the first ones, are those of the scan before. They fill a sector
      that this scan did not measure, since the robot turned against the sensor. They are not among
      the rays of `filled`.

    While the order of the rays is unknown, the ages are bounds: `newest_age` is the mean age of the
    rays, and each of `ages` is half of the duration of the scan. No ray is older than their sum.

    `__dict__` lends what `robot/sensing/scan_layout.py` derives from the rays. It is no field: no
    copy, message or memory of a robot contains it.
    """

    seq: int
    stamp: float
    ranges: Array
    bearings: Array
    range_min: float
    range_max: float
    ages: Array | None = None
    newest_age: float | None = None
    filled: Array | None = None
    borrowed: int = 0


MAX_STEP = 0.5
MAX_SPEED = 10.0
"""m and m/s, rad and rad/s: two readings of odometry farther apart have no common frame."""


MAX_EXTRAPOLATION = 0.15
"""Seconds for which the last measured twist is extrapolated: three odometry periods."""

HISTORY = 40
"""Readings of odometry that are kept."""

HISTORY_SPACING = 0.025
"""Seconds between two kept readings, at least, so that HISTORY of them reach back for a second.

Readings at up to 40 Hz are all kept. Interpolation over 0.05 s misses 0.001 rad at 3 rad/s2.
"""


class Odometry(Struct, frozen=True, array_like=True, gc=False):
    """Pose in the odometry frame and measured twist in the base frame."""

    stamp: float
    pose: Pose
    twist: Twist

    @property
    def is_valid(self) -> bool:
        """True if all numbers are finite, and pose and twist within MAX_COORDINATE."""
        pose = self.pose
        twist = self.twist
        most = MAX_COORDINATE
        return (
            self.stamp * 0.0 == 0.0
            and -most <= pose.x <= most
            and -most <= pose.y <= most
            and -most <= pose.yaw <= most
            and -most <= twist.linear <= most
            and -most <= twist.angular <= most
            and -most <= twist.lateral <= most
        )

    @property
    def fault(self) -> str:
        """The first number that makes the reading invalid, with its value; empty if it is valid."""
        pose = self.pose
        twist = self.twist
        most = MAX_COORDINATE
        if not math.isfinite(self.stamp):
            return f"its stamp is {self.stamp:g}"
        for what, value, unit in (
            ("pose x", pose.x, "m"),
            ("pose y", pose.y, "m"),
            ("yaw", pose.yaw, "rad"),
            ("speed ahead", twist.linear, "m/s"),
            ("turn rate", twist.angular, "rad/s"),
            ("speed to the left", twist.lateral, "m/s"),
        ):
            if not -most <= value <= most:  # false for NaN
                return f"its {what} is {value:.4g} {unit}; expected at most {most:g} in size"
        return ""


class SharedPose(Struct, frozen=True, array_like=True):
    """The pose of a robot's axle in a frame that robots share.

    `frame`: the name of the frame, in 1 to 63 printable characters; frames of equal name are the
    same frame. `stamp` in s on the clock of the localisation. `error` in m and `yaw_error` in rad
    bound the errors of the pose.
    """

    stamp: float
    pose: Pose
    error: float
    yaw_error: float
    frame: str

    @property
    def is_valid(self) -> bool:
        """True if pose and errors are finite and within bounds, and the name is valid."""
        return (
            self.pose.is_finite
            and abs(self.stamp) < math.inf
            and max(abs(self.pose.x), abs(self.pose.y)) <= MAX_SHARED_COORDINATE
            and 0.0 <= self.error <= MAX_SHARED_ERROR
            and 0.0 <= self.yaw_error <= math.pi
            and 0 < len(self.frame) < 64
            and self.frame.isprintable()
        )


MAX_SHARED_COORDINATE = 1e6
"""Metres from the origin of a shared frame."""
MAX_SHARED_ERROR = 10.0
"""Metres; a pose that is worse tells nothing."""
MAX_TOLD_DISTANCE = 10_000.0
"""Metres to a peer, beyond the radio of any swarm: a place that is farther away is an error."""


class PeerPlace(Struct, frozen=True, array_like=True):
    """The place that the peer `robot` reports: `x`, `y` in m in the shared frame `frame`.

    `error` in m bounds the error of the place. `age`: s from its measurement to its arrival.
    `heading`: rad, of the peer in that frame; None from an older version.
    """

    robot: str
    frame: str
    x: float
    y: float
    error: float
    age: float
    heading: float | None = None


class Neighbor(Struct, frozen=True, array_like=True, gc=False):
    """A robot nearby that is heard or sensed.

    - `age`: s since the robot was last heard or sensed, to within 0.5 s; of a place in a shared
      frame, the age of the older of both poses; of a place by kin, s since a scan showed it.
    - `distance` in m, `bearing`, `heading` in rad: relative to the own robot, measured, computed
      from poses in a shared frame, or by kin (`swarmd/robot/kin/`); None: not known.
    - `in_reach`: the robot is within the range or link quality of the settings
      (`NeighborSettings`). Patterns get only neighbors in reach. Protection uses every sensed
      robot.
    - `error`: m, a bound of the error of a place in a shared frame; by kin two standard deviations;
      None: measured, or not known.
    """

    id: str
    age: float
    distance: float | None = None
    bearing: float | None = None
    heading: float | None = None
    in_reach: bool = True
    error: float | None = None

    @property
    def is_valid(self) -> bool:
        """True if the id is within its bounds, and the numbers are finite and within bounds."""
        angles = (self.bearing or 0.0) + (self.heading or 0.0)
        return (
            0 < len(self.id) <= MAX_WORD
            and 0.0 <= self.age < math.inf
            and 0.0 <= (self.distance or 0.0) <= MAX_TOLD_DISTANCE
            and 0.0 <= (self.error or 0.0) < math.inf
            and abs(angles) < math.inf
        )


ROBOT = "robot"
"""The kind of a detection of a robot, whose id is that of the robot."""


class Detection(Struct, frozen=True, array_like=True, gc=False):
    """An object that the robot recognises, such as a tag, or a blob in a camera image.

    `kind`: the class, such as `box`. `id`: the name of this object; empty without a name.
    `bearing` in rad and `distance` in m are from the axle; None: the distance is not measured.
    """

    kind: str
    bearing: float
    distance: float | None = None
    id: str = ""

    @property
    def is_valid(self) -> bool:
        """True if the numbers are finite and the words within their bounds."""
        distance = 0.0 if self.distance is None else self.distance
        has_words = 0 < len(self.kind) <= MAX_WORD and len(self.id) <= MAX_WORD
        return has_words and abs(self.bearing) < math.inf and 0.0 <= distance < math.inf


MAX_DETECTIONS = 256
MAX_WORD = 63
"""Detections in one input, and characters of a kind or id."""


OPINION = "opinion"
"""The channel of voting patterns, whose values are opinions."""
ROUND_VOTE = "round_vote"
"""The channel that replaces OPINION with `windows: rounds`: [round, opinion, previous opinion]."""


class Message(Struct, frozen=True, array_like=True):
    """A message of a neighbour's pattern; `sender` comes from the key, never from the payload."""

    sender: str
    channel: str
    value: Value
    age: float


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """The limits of the base, m/s and rad/s, to which commands are clipped.

    A limit above the true limit of the base is dangerous: protection may then avoid an obstacle by
    a command that the base cannot follow. `lateral`: 0 for a base that cannot move sideways.
    """

    linear: Annotated[float, Meta(gt=0.0, le=20.0)]
    angular: Annotated[float, Meta(gt=0.0, le=50.0)]
    lateral: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.0

    def clip(self, twist: Twist) -> Twist:
        """The twist with each component clipped to its limit; no other code does so."""
        linear = self.linear
        angular = self.angular
        lateral = self.lateral
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


def slowed(twist: Twist, speed: float) -> Twist:
    """The twist, with all speeds reduced by one share if its base is faster than `speed` m/s.

    `slowed(Twist(0.2, 0.4), 0.1) == Twist(0.1, 0.2)`: the curve stays.
    """
    asked = math.sqrt(twist.linear * twist.linear + twist.lateral * twist.lateral)
    if not asked > speed:  # also a twist that is not finite
        return twist
    share = speed / asked
    return Twist(twist.linear * share, twist.angular * share, twist.lateral * share)


@dataclass(frozen=True, slots=True)
class Sweep:
    """The sweep of a rotating sensor, which measures one ray after another.

    The sweep begins at the bearing `start` in rad, and one revolution takes `duration` s.
    `direction`: 1.0 counter-clockwise, -1.0 clockwise.
    """

    start: float
    direction: float
    duration: float


@dataclass(frozen=True, slots=True)
class ScanSpec:
    """The platform's range sensor.

    - `bearings`: (n,) nominal directions in rad.
    - `cone`: the full width of a beam in rad; a range is that of the nearest object in the beam.
    - `rate`: in Hz. `range_min`, `range_max`: in m.
    - `offset`: (x, y) of the sensor in the base frame in m.
    - `max_gap`: the widest sector in rad without known rays. A wider sector makes a scan invalid,
      which holds the robot.
    - `zero`: the meaning of a range of exactly 0: no_return, too_close, unknown, or lds (the rule
      of the LDS family in `robot/sensing/ray_memory.py`).
    - `is_noisy`: the sensor has noise, so that two identical scans reveal a frozen sensor.
    - `near`: a return nearer than `range_min` is `reported`, or `lost` as if nothing were there.
    - `latency`: mean age of the rays in s when a scan arrives.
    - `sweep`: the order in which a rotating sensor measures the rays of a turn. None if all rays
      are measured at the same time, or if the order is not known (`is_sweep_unknown`).
    - `is_sweep_unknown`: the order of the rays is not known. Of the ages that the driver gives the
      rays, the robot then uses only the duration of a scan, and whether all rays are measured at
      the same time.
    - `mask`: sectors in which the sensor sees its own robot, each from a bearing counter-clockwise
      to another one, in rad. Their rays are unknown.
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
    sweep: Sweep | None = None
    is_sweep_unknown: bool = False
    cone: float = 0.0
    mask: tuple[tuple[float, float], ...] = ()

    def masked(self, bearings: Array) -> NDArray[np.bool_]:
        """(n,) True for each of the bearings (n,) in rad that lies in a sector of `mask`."""
        rounding = 1e-9  # rad: a ray at the edge of a sector lies in the sector
        is_masked = np.zeros(len(bearings), np.bool_)
        for first, last in self.mask:
            width = last - first
            # A full turn, such as from -180 to 180 or from 360 to 0 deg, is no width of 0.
            is_full = width != 0.0 and abs(math.remainder(width, math.tau)) <= rounding
            width = math.tau if is_full or width > math.tau else width % math.tau
            is_masked |= (bearings - first + rounding) % math.tau <= width + 2.0 * rounding
        return is_masked

    def mask_fault(self) -> str:
        """Why `mask` leaves too few rays; empty without a fault.

        The sectors without rays must be no wider than `max_gap` bridges, and half of the rays must
        be left.
        """
        rays = self.bearings
        left = rays[~self.masked(rays)]
        widest = math.degrees(max(self.max_gap, _widest_between(rays)))
        gap = math.degrees(_widest_between(left))
        if gap <= widest + 1e-6 and 2 * len(left) >= len(rays):
            return ""
        return (
            f"leaves {len(left)} of {len(rays)} rays, and {gap:.1f} deg without a ray; expected at"
            f" least half of the rays, and at most {widest:.1f} deg"
        )

    @property
    def stale_after(self) -> float:
        """Age in s beyond which a scan is stale: 3.5 nominal periods within 0.35 to 1.0 s."""
        return min(max(3.5 / self.rate, 0.35), 1.0)

    @property
    def max_scan_delay(self) -> float:
        """The longest delay of scans in s beyond `latency` with which protection works.

        A longer delay holds the robot. Protection is computed for scans that are at most
        `stale_after` s old. The next scan comes after up to one and a half periods; until then the
        present scan ages. The rest of `stale_after`, but at least 0.05 s, is left for the delay.
        """
        return max(self.stale_after - 1.5 / self.rate, 0.05)

    @property
    def slowest_period(self) -> float:
        """The time in s between scans above which the sensor misses its nominal `rate`."""
        return min(2.0 / self.rate, self.stale_after)


def _widest_between(bearings: Array) -> float:
    """The widest angle in rad between neighbouring rays; a full turn for fewer than two."""
    rising = np.sort(bearings % math.tau)
    return float(np.diff(rising, append=rising[:1] + math.tau).max(initial=0.0)) or math.tau


class Heights(Struct, frozen=True, forbid_unknown_fields=True):
    """Heights above the floor in m, by which a robot knows whether its lidar sees another robot.

    - `scan_plane`: height of the rays. With a wrong value a robot that is not seen counts as seen,
      and may be hit.
    - `lowest`, `highest`: a horizontal ray between these heights hits an opaque part of this robot
      from every side (wheels do not count). If the stated heights lie too far apart, other robots
      expect to see this robot where they cannot, and may hit it.
    """

    scan_plane: Annotated[float, Meta(ge=0.0, le=10.0)]
    lowest: Annotated[float, Meta(ge=0.0, le=10.0)]
    highest: Annotated[float, Meta(ge=0.0, le=10.0)]


@dataclass(frozen=True, slots=True, eq=False)
class Platform:
    """One kind of robot, from its file in config/platforms.

    - `footprint`: (k, 2) convex polygon, counter-clockwise, in the base frame in m.
    - `protection`: its settings. `mode`: the protection mode. `avoidance`: `orca` or
      `none`. `barrier`, `stop_zone`: mappings with the settings of these modes; None: not given.
      `preset`: the name of the settings of mode `potential_field`. All further keys, such as
      `threshold`, are these settings.
    - `patterns`: parameters by pattern name. `drivers`: options by driver name.
    - `heights`: None if unknown.
    - `body`: values for the simulated robot (mass, wheel base ...).
    - `ranges`: a ring of further range sensors, for obstacles that `scan` misses; None without a
      ring.
    - `sensors`: by quantity, such as `ground`: the places of its sensors, (k, 3) x, y in m and
      bearing in rad in the base frame (NaN: all directions). For `detections` (k, 5): also the
      field of view in rad and the range in m.
    - `words`: by driver, what each word of an operator, such as `stop`, means to the robot.
    """

    name: str
    limits: Limits
    footprint: Array
    scan: ScanSpec
    provides: frozenset[str]
    protection: Mapping[str, Any]
    patterns: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    drivers: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    heights: Heights | None = None
    body: Mapping[str, float] = field(default_factory=dict)
    ranges: ScanSpec | None = None
    sensors: Mapping[str, Array] = field(default_factory=dict)
    words: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def is_drone(self) -> bool:
        """True for a platform that reports its height: it flies."""
        return f"{_READING}height" in self.provides


PLACES_BY_SIGHT = frozenset({"neighbors.distance", "neighbors.bearing"})
"""What patterns get of each peer that the robot detects."""
PLACES_BY_POSE = PLACES_BY_SIGHT | {"neighbors.heading"}
"""What patterns get of each peer whose pose, as the own one, is known in one shared frame."""

KIN = "kin"
"""What a platform provides that learns the places of its peers by their motion
(`swarmd/robot/kin/`)."""

POSE_OPTIONS = ("shared_pose", "pose_frame")
"""Options by which drivers give the pose in a shared frame; each driver has one of them or none."""

OPTION_INPUTS = ("detections",)
"""Inputs of patterns that a driver gives if it has an option of that name.

Each is the kind of an input of core/events.py, a field of `Inputs`, and an attribute of
`InputAges` (robot/input_ages.py), None without a fresh value.
"""
_INPUTS = (
    "scan",
    "ranges",
    "odometry",
    *OPTION_INPUTS,
    "pose",
    "neighbors",
    "neighbors.distance",
    "neighbors.bearing",
    "neighbors.heading",
    KIN,
    "gripper",
)
_READING = "reading:"


def input_fault(word: str) -> str:
    """Why no robot can provide the input `word` to a pattern; empty if a robot can."""
    is_reading = word.startswith(_READING) and word.removeprefix(_READING).isidentifier()
    known = word in _INPUTS or is_reading
    return "" if known else unknown("input", word, (*_INPUTS, f"{_READING}<name>"))


def has_places(platform: Platform) -> bool:
    """True if the robot has distance and bearing of its peers; not if by kin, which names some."""
    provides = platform.provides
    return provides >= PLACES_BY_SIGHT and (KIN not in provides or "pose" in provides)


def lacks_text(needs: frozenset[str], platform: Platform) -> str:
    """What `platform` lacks of `needs`, and both ways to the places of peers; empty if nothing."""
    missing = sorted(needs - platform.provides)
    ways = (
        f"; a pose in a shared frame (driver option {' or '.join(POSE_OPTIONS)},"
        " in a scenario radio.places: shared)"
        " gives it, or hardware that measures it (radio.range_and_bearing: true)"
        if PLACES_BY_POSE.intersection(missing)
        else ""
    )
    lack = f"needs {', '.join(missing)}, which {platform.name} does not provide{ways}"
    return lack if missing else ""


def sensor_names(name: str, count: int) -> tuple[str, ...]:
    """The readings of `count` sensors of one quantity: their mean, then each by its number."""
    return name, *(f"{name}_{number}" for number in range(1, count + 1))


class Inputs(Struct, frozen=True, eq=False, array_like=True):
    """Inputs of one step of a pattern.

    - `now`: s on the robot's monotonic clock.
    - `dt`: s since the last step; 0 at the first step.
    - `scan`: the latest conditioned scan; None before the first.
    - `is_new_scan`: True once for each scan.
    - `odometry`: the latest measured pose and twist; None before the first.
    - `neighbors`: the robots in reach, with distance and bearing if they are sensed.
    - `messages`: received since the last step from the same pattern on other robots.
    - `readings`: the latest value of each further sensor by its name, such as `temperature`.
    - `ranges`: the latest conditioned scan of the platform's ring of range sensors, measured from
      the ring's own offset; None without a ring, or before the first scan.
    - `detections`: the objects that the robot recognises now; None without such a sensor, or
      without a fresh value.
    - `pose`: of the robot's axle in the shared frame; None without a fresh pose.
    """

    now: float
    dt: float
    scan: Scan | None = None
    is_new_scan: bool = False
    odometry: Odometry | None = None
    neighbors: tuple[Neighbor, ...] = ()
    messages: tuple[Message, ...] = ()
    readings: Mapping[str, float] = {}
    ranges: Scan | None = None
    detections: tuple[Detection, ...] | None = None
    pose: Pose | None = None


class Outputs(Struct, frozen=True, array_like=True):
    """Outputs of one step of a pattern.

    - `twist`: the requested command; None: the robot stands still.
    - `messages`: to the same pattern on other robots, by channel.
    - `report`: named values (state, opinion ...) that members, describe and traces show.
    - `done`: the reason why the pattern has finished; None while it goes on.
    - `grip`: True closes the gripper, False opens it, None leaves it unchanged, as does the end of
      a run. A pattern that uses the gripper lists `gripper` in its `needs`.
    """

    twist: Twist | None = None
    messages: Mapping[str, Value] = {}
    report: Mapping[str, Scalar] = {}
    done: str | None = None
    grip: bool | None = None

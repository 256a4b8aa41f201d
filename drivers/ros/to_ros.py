"""Converts the core's values to the ROS messages of simulated robots; the inverse of `from_ros`.

Ranges pass as the sensor gave them, including zeros, infinities and NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    DetectionsInput,
    OdometryInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
    SensorInput,
)
from swarmd.core.values import Array, Detection, Odometry, Platform, Pose, Scan, ScanSpec
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.from_ros import twist_message
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.topic_detections import TAGS, TopicDetections
from swarmd.drivers.ros.topic_inputs import TopicEntry

_MAX_UNEVENNESS = 1e-4  # rad from a bearing to its place among evenly spread ones
_MAX_MISMATCH = math.radians(0.5)
_MIN_RANGE = 0.001
_NO_INTENSITIES = np.empty(0, dtype=np.float32)
_UNKNOWN = np.zeros(36)
_POINT = "apriltag_msgs/Point"
_FAMILY = "tag36h11"
_MAX_DIGITS = 9  # of an int32
_CORNERS = (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)  # of a tag, in its sides


class InputEncoder(Protocol):
    """The messages of one kind of input, or of one entry of it."""

    is_reliable: bool  # the quality of service of the publishers
    depth: int

    @property
    def topics(self) -> Sequence[tuple[str, type]]:
        """Each topic with its message class."""

    def encode(self, value: Any, stamp: float, /) -> Sequence[object | None]:
        """A message for each of `topics`, in their order; None for a topic without a value.

        `value`: the content of the input. `stamp`: s, of the last odometry; the stamp of the
        messages if the value has no stamp of its own.
        """


class LaserScanEncoder:
    """Scans as a LaserScan: angle_min of the first ray, and one increment."""

    is_reliable = False
    depth = 5

    def __init__(self, options: RosOptions, platform: Platform) -> None:
        """ConfigError if the platform's rays are not evenly spread."""
        self._spec = platform.scan
        self.topics = ((options.topic(options.scan_topic), ros.LaserScan),)
        first, step = _evenly(platform)
        side = -1.0 if options.scan_upside_down else 1.0
        self._first = side * (first - math.radians(options.scan_yaw_deg))
        self._step = side * step

    def encode(self, scan: Scan, stamp: float = 0.0) -> tuple[object, ...]:
        """The message, for the one topic."""
        count = len(scan.ranges)
        spec = self._spec
        message = ros.LaserScan(
            header=header(scan.stamp, "base_scan"),
            angle_min=self._first,
            angle_max=self._first + self._step * max(count - 1, 0),
            angle_increment=self._step,
            time_increment=_time_increment(scan),
            scan_time=1.0 / spec.rate,
            range_min=spec.range_min,
            range_max=spec.range_max,
            ranges=scan.ranges.astype(np.float32),
            intensities=_NO_INTENSITIES,
        )
        return (message,)


class RangeRingEncoder:
    """Scans of a few rays as one Range a ray, each with a topic of its own."""

    is_reliable = False
    depth = 5

    def __init__(self, options: RosOptions, platform: Platform) -> None:
        """ConfigError if a sensor of `ranges` points where the platform has no ray."""
        ring = options.ring()
        self._spec = platform.ranges or platform.scan
        self.topics = tuple((options.topic(name), ros.Range) for name, _, _ in ring)
        self._rays = tuple(
            (_ray_at(platform, name, bearing), distance) for name, bearing, distance in ring
        )

    def encode(self, scan: Scan, stamp: float = 0.0) -> tuple[object, ...]:
        """A message for each topic, in their order."""
        return tuple(self._range(scan, ray, distance) for ray, distance in self._rays)

    def _range(self, scan: Scan, ray: int, distance: float) -> ros.Range:
        value = float(scan.ranges[ray])
        if 0.0 < value < math.inf:
            value = max(value - distance, _MIN_RANGE)
        return ros.Range(
            header=header(scan.stamp, "base_scan"),
            radiation_type=ros.Range.INFRARED,
            field_of_view=0.0,
            min_range=max(self._spec.range_min - distance, 0.0),
            max_range=self._spec.range_max - distance,
            range=value,
            variance=0.0,
        )


class OdometryEncoder:
    """Odometry on its topic."""

    is_reliable = True
    depth = 10

    def __init__(self, options: RosOptions) -> None:
        self.topics = ((options.topic(options.odometry), ros.Odometry),)

    def encode(self, odometry: Odometry, stamp: float) -> tuple[object, ...]:
        """The message, for the one topic."""
        return (odometry_message(odometry),)


class ReadingEncoder:
    """A reading as a Float64, by the name of an entry of `readings`."""

    is_reliable = False
    depth = 1

    def __init__(self, entry: TopicEntry) -> None:
        self._name = entry.name
        self.topics = ((entry.topic, entry.message_type),)

    def encode(self, readings: Mapping[str, float], stamp: float) -> tuple[object | None]:
        """The message, None if there is no such reading."""
        return (ros.Float64(readings[self._name]) if self._name in readings else None,)


class TagEncoder:
    """Encodes objects as the AprilTags that a camera would see.

    The option `kinds` maps the number or the family of a tag to a kind of objects. An object has a
    tag if the option maps a tag to the object's kind. If the option names the family of the tag,
    the tag's number is the number at the end of the object's name, such as 2 of `tb4-02`.
    """

    is_reliable = True
    depth = 1

    def __init__(self, options: RosOptions, entry: TopicDetections) -> None:
        self.option = entry.option
        self.topics = ((entry.topic, entry.message_type),)
        self._entry = entry
        types = options.message_types
        self._tag = types.kind(f"{TAGS}Detection")
        self._point = types.kind(_POINT)
        self._keys = {kind: key for key, kind in reversed(entry.options.kinds.items())}

    def encode(self, found: Sequence[Detection] | None, stamp: float) -> tuple[object]:
        """The message, with the tags that have a place in the image."""
        tags = [tag for seen in found or () for tag in self._tags(seen)]
        return (self._entry.message_type(header=header(stamp, "camera"), detections=tags),)

    def _tags(self, seen: Detection) -> Iterator[object]:
        key = self._keys.get(seen.kind)
        place = self._entry.pixels(seen)
        if key is None or place is None:
            return
        across, side = place
        yield self._tag(
            family=_FAMILY if key.isdecimal() else key,
            id=_number(key if key.isdecimal() else seen.id),
            hamming=0,
            goodness=0.0,
            decision_margin=100.0,
            centre=self._at(across, 0.0),
            corners=[self._at(across + x * side, y * side) for x, y in _CORNERS],
            homography=np.zeros(9),
        )

    def taken_for(self, kind: str, name: str) -> str:
        """The kind that a driver reads from the tag of an object with this `kind` and `name`.

        It differs from `kind` if option `kinds` gives the tag's number another kind.
        """
        key = self._keys.get(kind)
        if key is None or key.isdecimal():
            return kind
        return self._entry.options.kinds.get(str(_number(name)), kind)

    def _at(self, x: float, y: float) -> Any:
        return self._point(x=x, y=y)


def _number(name: str) -> int:
    """The number at the end of a name, 0 without."""
    digits = name[len(name.rstrip("0123456789")) :]
    return int(digits[-_MAX_DIGITS:] or 0)


def encoders(
    options: RosOptions, platform: Platform
) -> dict[type[SensorInput], tuple[InputEncoder, ...]]:
    """The encoders for a robot's options, by kind of input; other kinds are not published."""
    has_ring = platform.ranges is not None
    is_laser = has_ring or not options.ranges
    return {
        ScanInput: ((LaserScanEncoder if is_laser else RangeRingEncoder)(options, platform),),
        RangesInput: (RangeRingEncoder(options, platform),) if has_ring else (),
        OdometryInput: (OdometryEncoder(options),),
        ReadingsInput: tuple(map(ReadingEncoder, options.topic_entries["readings"].values())),
        DetectionsInput: tag_encoders(options),
    }


def tag_encoders(options: RosOptions) -> tuple[TagEncoder, ...]:
    """An encoder for each entry of the option `detections` whose messages are tags."""
    entries = options.topic_entries["detections"].values()
    detections = (entry for entry in entries if isinstance(entry, TopicDetections))
    return tuple(
        TagEncoder(options, entry) for entry in detections if entry.options.type.startswith(TAGS)
    )


def _time_increment(scan: Scan) -> float:
    """s between two rays in the order of the message; 0 if the rays are not in order of time."""
    if scan.ages is None or len(scan.ages) < 2 or (np.diff(scan.ages) > 0.0).any():
        return 0.0
    return float(scan.ages[0] - scan.ages[-1]) / (len(scan.ages) - 1)


def odometry_message(odometry: Odometry, child: str = "base_footprint") -> ros.Odometry:
    """Pose in frame `odom` and twist in that of the base."""
    pose = odometry.pose
    twist = odometry.twist
    return ros.Odometry(
        header=header(odometry.stamp, "odom"),
        child_frame_id=child,
        pose=ros.PoseWithCovariance(pose=pose_message(pose), covariance=_UNKNOWN),
        twist=ros.TwistWithCovariance(twist=twist_message(twist), covariance=_UNKNOWN),
    )


def header(stamp: float, frame: str) -> ros.Header:
    """The header with a stamp in s."""
    seconds, rest = divmod(round(stamp * 1e9), 10**9)
    return ros.Header(stamp=ros.Time(sec=seconds, nanosec=rest), frame_id=frame)


def pose_message(pose: Pose) -> ros.Pose:
    """A pose on the floor."""
    return ros.Pose(
        position=ros.Point(x=pose.x, y=pose.y, z=0.0),
        orientation=ros.Quaternion(
            x=0.0, y=0.0, z=math.sin(0.5 * pose.yaw), w=math.cos(0.5 * pose.yaw)
        ),
    )


def _evenly(platform: Platform) -> tuple[float, float]:
    """The first bearing and the step, in rad."""
    bearings = np.unwrap(platform.scan.bearings)
    first = float(bearings[0])
    count = len(bearings)
    step = (float(bearings[-1]) - first) / (count - 1) if count > 1 else 0.0
    off: Array = np.abs(bearings - (first + step * np.arange(count)))
    if off.max() > _MAX_UNEVENNESS:
        raise ConfigError(
            f"platform {platform.name}: the rays of its scan are not evenly spread, as those of a"
            " LaserScan are; expected `ranges` among the driver's options, a topic for each ray"
        )
    return first, step


def _ray_at(platform: Platform, name: str, bearing: float) -> int:
    spec: ScanSpec = platform.ranges or platform.scan
    apart = [abs(wrap(float(ray) - bearing)) for ray in spec.bearings]
    ray = int(np.argmin(apart))
    if apart[ray] > _MAX_MISMATCH:
        raise ConfigError(
            f"platform {platform.name}: ranges.{name} points to {math.degrees(bearing):g} degrees,"
            " where it has no ray; expected one of its bearings_deg"
        )
    return ray

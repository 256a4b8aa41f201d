"""What a pattern gets, as messages for the nodes of its robot, and their commands as a Twist."""

from __future__ import annotations

import array
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.angles import wrap
from swarmd.core.values import Array, Inputs, Neighbor, Platform, Pose, Scan, Twist
from swarmd.ros2_nodes.graph import Graph, Published
from swarmd.ros2_nodes.launch_file import ScanTopic, Topics, no_return, scan_topic
from swarmd.ros2_nodes.ros_time import S_TO_NS

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
POSES = "geometry_msgs/msg/PoseArray"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
ODOM_FRAME = "odom"
BASE_FRAME = "base_footprint"
BASE_LINK = "base_link"
TF_STATIC = "/tf_static"
SHARED_FRAME = "map"
BATTERY = "sensor_msgs/msg/BatteryState"
_READING_FIELDS = (
    *("data", "temperature", "range", "illuminance", "relative_humidity", "fluid_pressure"),
)
"""The field of a message that takes a reading: the first of these that it has."""
_EVEN = 1e-4
"""rad by which the directions of an even scan may differ from their places."""
_MOST_TURNED = math.pi / 4.0
"""rad by which de-skew turns the median ray at most: half a scan of 0.2 s at 7 rad/s."""
_RING = 2.5
"""A scan whose widest gap is less than this times the median gap is a whole turn."""


class Command(NamedTuple):
    """A command of a node, and s on the graph's time at which it was published."""

    twist: Twist
    at: float


class RobotTopics:
    """Publishes the inputs of a robot on its topics, and keeps the last command.

    `resolve` gives the full name of a topic. A name with or without a slash means the topic of the
    robot: nodes publish on `cmd_vel` or `/cmd_vel`.
    """

    def __init__(
        self, topics: Topics, graph: Graph, platform: Platform, resolve: Callable[[str], str]
    ) -> None:
        self._topics = topics
        self._graph = graph
        self._platform = platform
        self._resolve = resolve
        self._scan = scan_topic(topics)
        self._commands = self._names(topics.command)
        self._with_static = 0  # subscriptions that have the transforms that stay
        self.command: Command | None = None

    def needs(self) -> frozenset[str]:
        """The inputs to whose topics a node subscribes."""
        topics = self._topics
        found = set()
        scan_name = "" if topics.scan == "" else self._scan.topic
        for need, name, types in (
            ("scan", scan_name, (LASER_SCAN,)),
            ("odometry", topics.odometry, (ODOMETRY,)),
            ("odometry", topics.tf, (TF,)),
            ("pose", topics.pose, (POSE,)),
            ("neighbors.distance", topics.neighbors, (POSES,)),
            ("neighbors.bearing", topics.neighbors, (POSES,)),
            *((f"reading:{reading}", name, ()) for reading, name in topics.readings.items()),
        ):
            for topic in self._names(name):
                kinds = [one.msg_type.TYPE for one in self._graph.subscriptions_of(topic)]
                if any(not types or kind in types for kind in kinds):
                    found.add(need)
        return frozenset(found)

    def take(self, published: Published) -> None:
        """Keep a command. TypeError for another type on the topic of commands."""
        if published.topic not in self._commands:
            return
        message: Any = published.message
        if message.TYPE == TWIST_STAMPED:
            message = message.twist
        elif message.TYPE != TWIST:
            raise TypeError(f"{published.topic} carries {message.TYPE}; expected a Twist")
        twist = Twist(message.linear.x, message.angular.z, message.linear.y)
        self.command = Command(twist, published.at)

    def current(self, now: float) -> Twist | None:
        """The last command; None before the first, and zero when it is older than `hold`."""
        if self.command is None:
            return None
        hold = self._topics.hold
        return Twist() if hold and now - self.command.at > hold else self.command.twist

    def publish(self, inputs: Inputs) -> None:
        """Publish what is new in the inputs of a step."""
        topics = self._topics
        if topics.tf:
            self._publish_static()
        if inputs.odometry is not None:
            self._publish_odometry(inputs)
        if topics.pose and inputs.pose is not None:
            message = self._made(POSE, SHARED_FRAME)
            _set_pose(message.pose, inputs.pose)
            self._give(topics.pose, message)
        if topics.neighbors:
            self._give(topics.neighbors, self._poses(inputs.neighbors))
        for name, topic in topics.readings.items():
            if name in inputs.readings:
                self._publish_reading(topic, inputs.readings[name])
        if inputs.is_new_scan and inputs.scan is not None and topics.scan != "":
            self._give(self._scan.topic, self._laser_scan(inputs.scan))

    def _publish_odometry(self, inputs: Inputs) -> None:
        measured = inputs.odometry
        assert measured is not None
        if self._is_wanted(self._topics.odometry):
            message = self._made(ODOMETRY, ODOM_FRAME)
            message.child_frame_id = BASE_FRAME
            _set_pose(message.pose.pose, measured.pose)
            twist = message.twist.twist
            twist.linear.x = float(measured.twist.linear)
            twist.linear.y = float(measured.twist.lateral)
            twist.angular.z = float(measured.twist.angular)
            self._give(self._topics.odometry, message)
        if self._is_wanted(self._topics.tf):
            there = measured.pose
            transforms = [self._transform(ODOM_FRAME, BASE_FRAME, there)]
            if self._topics.pose and inputs.pose is not None:
                transforms.append(
                    self._transform(SHARED_FRAME, ODOM_FRAME, _frame_of(inputs.pose, there))
                )
            self._give(self._topics.tf, self._graph.types.kind(TF)(transforms=transforms))

    def _publish_static(self) -> None:
        """Publish the frames of the robot's parts to the subscriptions that came since."""
        count = len(self._graph.subscriptions_of(TF_STATIC))
        if count > self._with_static:
            x, y = self._platform.scan.offset
            transforms = [self._transform(BASE_FRAME, BASE_LINK, Pose())]
            if self._scan.frame not in ("", BASE_FRAME, BASE_LINK):
                transforms.append(self._transform(BASE_LINK, self._scan.frame, Pose(x, y)))
            self._graph.deliver(TF_STATIC, self._graph.types.kind(TF)(transforms=transforms))
        self._with_static = count

    def _transform(self, frame: str, child: str, pose: Pose) -> Any:
        transform = self._made("geometry_msgs/msg/TransformStamped", frame)
        transform.child_frame_id = child
        transform.transform.translation.x = float(pose.x)
        transform.transform.translation.y = float(pose.y)
        _set_yaw(transform.transform.rotation, pose.yaw)
        return transform

    def _publish_reading(self, topic: str, value: float) -> None:
        for name in self._names(topic):
            for subscription in self._graph.subscriptions_of(name):
                kind = subscription.msg_type
                field = next((one for one in _READING_FIELDS if one in kind.FIELDS), None)
                if kind.TYPE == BATTERY:
                    self._graph.deliver(name, self._battery(value))
                    break
                if field is None:
                    raise TypeError(
                        f"{topic}: {kind.TYPE} has no field for a reading; use std_msgs/Float64"
                    )
                message: Any = kind()
                if "header" in kind.FIELDS:
                    self._stamp(message.header, self._graph.now, BASE_FRAME)
                setattr(message, field, float(value))
                self._graph.deliver(name, message)
                break

    def _battery(self, charge: float) -> Any:
        """The state of a battery of which the charge alone, 0 to 1, is known."""
        message = self._made(BATTERY, BASE_FRAME)
        for name in ("voltage", "temperature", "current", "charge", "capacity", "design_capacity"):
            setattr(message, name, math.nan)  # as its definition has it: NaN is not measured
        message.percentage = float(charge)
        message.present = True
        return message

    def _poses(self, neighbors: tuple[Neighbor, ...]) -> Any:
        message = self._made(POSES, BASE_FRAME)
        for neighbor in sorted(neighbors, key=lambda one: one.id):
            if neighbor.distance is None or neighbor.bearing is None:
                continue
            x = neighbor.distance * math.cos(neighbor.bearing)
            y = neighbor.distance * math.sin(neighbor.bearing)
            pose = self._graph.types.kind("geometry_msgs/msg/Pose")()
            _set_pose(pose, Pose(x, y, neighbor.heading or 0.0))
            message.poses.append(pose)
        return message

    def _laser_scan(self, scan: Scan) -> Any:
        """The scan as a driver of ROS publishes it: rays in rising order, from `angle_min` on."""
        message: Any = self._graph.types.kind(LASER_SCAN)()
        ages = None if scan.ages is None else scan.ages[scan.borrowed :]
        oldest = 0.0 if ages is None else float(ages.max(initial=0.0))
        age = (scan.newest_age or 0.0) + oldest
        self._stamp(message.header, max(0.0, self._graph.now - age), self._scan.frame)
        layout = scan_layout(scan, self._scan, self._platform.scan.bearings)
        message.angle_min = layout.first
        message.angle_increment = layout.step
        message.angle_max = layout.first + layout.step * (len(layout.ranges) - 1)
        message.scan_time = 1.0 / self._platform.scan.rate
        message.range_min = float(scan.range_min)
        message.range_max = float(scan.range_max)
        message.ranges = array.array("f", layout.ranges.tolist())
        return message

    def _made(self, kind: str, frame: str) -> Any:
        message: Any = self._graph.types.kind(kind)()
        self._stamp(message.header, self._graph.now, frame)
        return message

    def _stamp(self, header: Any, seconds: float, frame: str) -> None:
        nanoseconds = round(seconds * S_TO_NS)
        header.stamp.sec = nanoseconds // S_TO_NS
        header.stamp.nanosec = nanoseconds % S_TO_NS
        header.frame_id = frame

    def _give(self, topic: str, message: Any) -> None:
        for name in self._names(topic):
            self._graph.deliver(name, message)

    def _is_wanted(self, topic: str) -> bool:
        return any(self._graph.subscriptions_of(name) for name in self._names(topic))

    def _names(self, topic: str) -> list[str]:
        """The full names that mean a topic of this robot: below the namespace, and without it."""
        if not topic:
            return []
        bare = f"/{topic.lstrip('/')}"
        return (
            [bare] if topic.startswith("/") else list(dict.fromkeys((self._resolve(topic), bare)))
        )


class ScanLayout(NamedTuple):
    """A scan in even directions: rad of the first ray, rad between two rays, and (n,) m."""

    first: float
    step: float
    ranges: Array


def scan_layout(scan: Scan, topic: ScanTopic, nominal: Array) -> ScanLayout:
    """The ranges in rising order of their directions, evenly spaced.

    A whole turn begins at the first direction of the platform, `nominal` (m,) in rad, or at
    `angle_min_deg`; a sector begins at its right end. A scan that de-skew has corrected for the
    motion of the robot has the directions that the sensor gave its rays, as a driver of ROS
    publishes them: each ray then stands in it once. Where the directions of the sensor are not
    even, each place has the range of the ray that is nearest to it in direction.
    """
    bearings, measured = _as_measured(scan, nominal)
    count = len(bearings)
    if count < 2:
        return ScanLayout(float(bearings.sum()), 0.0, _with_no_return(measured, topic))
    full = 2.0 * math.pi
    given = topic.angle_min_deg
    first = float(nominal[0]) if given is None else math.radians(given)
    turned = np.mod(bearings - first + _EVEN, full) - _EVEN
    order = np.argsort(turned, kind="stable")
    at = turned[order]
    gaps = np.append(np.diff(at), at[0] + full - at[-1])
    widest = int(gaps.argmax())
    is_whole_turn = gaps[widest] < _RING * float(np.median(gaps))
    if is_whole_turn:
        step = full / count
    else:  # a sector, whose first ray is the one behind the widest gap
        order = np.roll(order, -widest - 1)
        first = float(wrap(bearings[order[0]]))
        at = np.mod(bearings[order] - first + _EVEN, full) - _EVEN
        step = float(at[-1]) / (count - 1)
    ranges = measured[order]
    places = step * np.arange(count)
    if np.abs(at - places).max() > _EVEN:
        if is_whole_turn:  # the last ray may be the nearest to the first place, and the other way
            at = np.concatenate(([at[-1] - full], at, [at[0] + full]))
            ranges = np.concatenate(([ranges[-1]], ranges, [ranges[0]]))
        middles = 0.5 * (at[1:] + at[:-1])
        ranges = ranges[np.searchsorted(middles, places)]
    return ScanLayout(first, step, _with_no_return(ranges, topic))


def _as_measured(scan: Scan, nominal: Array) -> tuple[Array, Array]:
    """Bearings (n,) in rad and ranges (n,) in m of the scan, before de-skew turned its rays.

    De-skew puts rays of the scan before first, and keeps the order of the others. So the ray at an
    index has the direction of `nominal` (m,) there, if the rays are those of the platform: as many,
    the newest one, which is not moved, in its place, and most others not far from theirs. A scan
    with other rays is returned as it is.
    """
    bearings = scan.bearings[scan.borrowed :]
    if scan.ages is None or len(bearings) != len(nominal) or len(nominal) < 2:
        return scan.bearings, scan.ranges
    turned = np.abs(np.mod(bearings - nominal + math.pi, 2.0 * math.pi) - math.pi)
    newest = int(scan.ages[scan.borrowed :].argmin())
    if turned[newest] > _EVEN or float(np.median(turned)) > _MOST_TURNED:
        return scan.bearings, scan.ranges
    return nominal, scan.ranges[scan.borrowed :]


def _with_no_return(ranges: Array, topic: ScanTopic) -> Array:
    free = no_return(topic)
    return ranges if free == math.inf else np.where(np.isposinf(ranges), free, ranges)


def _frame_of(outer: Pose, inner: Pose) -> Pose:
    """Where the frame is in which a robot is at `inner`, while it is at `outer` in another one."""
    yaw = wrap(outer.yaw - inner.yaw)
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    x = outer.x - cos * inner.x + sin * inner.y
    return Pose(x, outer.y - sin * inner.x - cos * inner.y, float(yaw))


def _set_pose(message: Any, pose: Pose) -> None:
    message.position.x = float(pose.x)
    message.position.y = float(pose.y)
    _set_yaw(message.orientation, pose.yaw)


def _set_yaw(quaternion: Any, yaw: float) -> None:
    quaternion.z = math.sin(yaw / 2.0)
    quaternion.w = math.cos(yaw / 2.0)

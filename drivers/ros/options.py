"""The options of the ROS drivers, read and checked."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from rosbags.typesys import Stores

from swarmd.core.bounds import Id
from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform, Value
from swarmd.drivers.ros import command_type, messages
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.service_options import ServiceOptions
from swarmd.drivers.ros.topic_detections import DetectionOptions
from swarmd.drivers.ros.topic_entries import ENTRY_KINDS
from swarmd.drivers.ros.topic_hazards import HazardOptions
from swarmd.drivers.ros.topic_inputs import TopicEntry
from swarmd.drivers.ros.topic_readings import ReadingOptions
from swarmd.link.settings import parse_endpoint
from swarmd.settings.layered import Layered

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
DEFAULT_MASTER = "http://127.0.0.1:11311"
MAX_BEARING = 360.0
MAX_OFFSET = 10.0
"""Bounds of a range sensor's place in `ranges`: degrees, and m from the scan's origin."""

MAX_VOLTS = 1000.0

_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")
# ROS 2 also has no part that begins with a digit, and no two underscores in a row
# (https://design.ros2.org/articles/topic_and_service_names.html).
_ROS2_NAME = re.compile(r"(?!.*__)/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_MASTER = re.compile(r"http://[^/:]+:\d+/?")
_ROBOT = "{robot}"

Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]
Name = Annotated[str, Meta(min_length=1, max_length=200)]


class TopicOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """The names and types of a robot's topics, and how its sensors are mounted.

    - `namespace`: precedes every topic that does not begin with a slash; `{robot}` in it is the
      robot's id, with `_` for `-`.
    - `scan`, `odometry`, `cmd_vel`: the topics of the scan, of the odometry and of the commands.
      Without `scan` it is `scan`.
    - `imu`, `battery`: subscribed to only if named. They give the readings `yaw` in rad, `battery`
      (0 to 1) and `battery_voltage`.
    - `battery_volts`: the volts of an empty and of a full pack, from which `battery` follows.
      Without it, `battery` is the percentage of the message.
    - `battery_percentage`: the unit of that percentage. Without it and `battery_volts` there is no
      `battery`.
    - `ranges`: makes one scan of several `sensor_msgs/Range`, beside `scan` if the platform has a
      section `ranges`, otherwise in place of it. A mapping from each topic to the sensor's bearing
      in degrees, or to its bearing and its distance in m from the offset of the section.
    - `scan_yaw_deg`: the direction of the lidar's zero, from the base's front to the left.
    - `scan_upside_down`: the lidar hangs upside down, so that it turns the other way.
    - `shared_pose`: a topic with the pose of the base's axle in a frame that all robots share.
    - `shared_pose_type`: `pose` is PoseStamped, `pose_with_covariance` is
      PoseWithCovarianceStamped, as of AMCL, which odometry carries on.
    - `shared_pose_error`, `shared_pose_error_deg`: bounds of the errors in m and degrees; three
      standard deviations of the message's covariance count instead if they are greater.
    - `cmd_vel_type`: the type of the commands; `auto`: the type to which the base subscribes.
    - `cmd_vel_frame`: the frame of stamped commands.
    - `cmd_vel_listeners`: nodes that subscribe to the commands and are no base, by name or pattern,
      such as `ekf_*`. DDS readers without a node are `dds_reader*`, with the name of their process.
    - `other_commands`: further topics on which the base takes commands of other nodes.
    - `other_actions`: actions of other nodes that move the base.
    - `readings`: numbers in messages of any topics, by name.
    - `hazards`: numbers in messages that mean a hazard, by name.
    - `detections`: topics with the objects that the robot recognises, by name.
    - `stop_operator`: the operator of a stop on `swarmd/stop` or `swarmd/estop`. Without it only a
      swarm without keys accepts these stops, unless the option `services` has an operator.
    - `message_path`: folders with the packages of a vendor's message types, as `.msg` files.
    """

    distro = Stores.ROS2_JAZZY
    """The definitions of the message types."""

    namespace: str = ""
    scan: Name | None = None
    odometry: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name | None = None
    battery: Name | None = None
    battery_volts: tuple[float, float] | None = None
    battery_percentage: Literal["share", "percent"] | None = None
    shared_pose: Name | None = None
    shared_pose_type: Literal["pose", "pose_with_covariance"] = "pose"
    shared_pose_error: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.05
    shared_pose_error_deg: Annotated[float, Meta(ge=0.0, le=90.0)] = 3.0
    cmd_vel_type: command_type.Option = "auto"
    cmd_vel_frame: Annotated[str, Meta(max_length=200)] = "base_link"
    cmd_vel_listeners: tuple[Name, ...] = ()
    other_commands: tuple[str, ...] = ()
    other_actions: tuple[str, ...] = ()
    scan_yaw_deg: Degrees = 0.0
    scan_upside_down: bool = False
    # Unbounded here: msgspec 0.22 crashes on a union of a bounded number and a tuple of such.
    ranges: dict[str, float | tuple[float, float]] = {}
    readings: dict[str, ReadingOptions] = {}
    hazards: dict[str, HazardOptions] = {}
    detections: dict[str, DetectionOptions] = {}
    stop_operator: Id | None = None
    message_path: str | tuple[str, ...] = ()

    @property
    def scan_topic(self) -> str:
        """The name of the lidar's topic; `scan` without option `scan`."""
        return self.scan or "scan"

    @property
    def command_types(self) -> tuple[type, ...]:
        """The message classes that the commands may have: one, or all if the base decides."""
        return command_type.allowed_types(self.cmd_vel_type)

    @property
    def pose_type(self) -> type:
        """The message class of the shared pose."""
        is_plain = self.shared_pose_type == "pose"
        return messages.PoseStamped if is_plain else messages.PoseWithCovarianceStamped

    def topic(self, name: str) -> str:
        """The full name of a topic, such as `/tb3_01/scan`."""
        namespace = self.namespace.strip("/")
        if name.startswith("/") or not namespace:
            return f"/{name.strip('/')}"
        return f"/{namespace}/{name}"

    @cached_property
    def message_types(self) -> MessageTypes:
        """The message types by name; ConfigError for a folder without them."""
        path = self.message_path
        return MessageTypes(self.distro, (path,) if isinstance(path, str) else path)

    @cached_property
    def topic_entries(self) -> dict[str, dict[str, TopicEntry]]:
        """The entries of each option of ENTRY_KINDS by name.

        ConfigError names the key that is wrong.
        """
        return {option: self._entries_of(option) for option in ENTRY_KINDS}

    def _entries_of(self, option: str) -> dict[str, TopicEntry]:
        given = getattr(self, option)
        entries = dict[str, TopicEntry]()
        for name, options in given.items():
            for entry in ENTRY_KINDS[option].read(name, options, self.topic, self.message_types):
                if entry.name in entries or (entry.name != name and entry.name in given):
                    text = f"{option}.{name} gives {entry.name}, too; rename one of them"
                    raise ConfigError(text)
                entries[entry.name] = entry
        return entries

    def ring(self) -> tuple[tuple[str, float, float], ...]:
        """Topic, bearing in rad and distance in m of each sensor of `ranges`."""
        placed = ((name, *_place(place)) for name, place in self.ranges.items())
        return tuple((name, math.radians(degrees), distance) for name, degrees, distance in placed)


class RosOptions(TopicOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the ROS 2 drivers.

    - `endpoint`: the address at which the bridge or router listens.
    - `publish_state`: publish the robot's state on `swarmd/pose`, `swarmd/markers` and
      `diagnostics`.
    - `services`: the services by which ROS runs and resets this robot.
    """

    endpoint: str = DEFAULT_ENDPOINT
    publish_state: bool = False
    services: ServiceOptions | None = None


class RmwOptions(RosOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of rmw_zenoh beside those of `ros2dds`.

    - `domain`: ROS_DOMAIN_ID on the robot.
    """

    domain: Annotated[int, Meta(ge=0, le=232)] = 0


class Ros1Options(TopicOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of driver `ros1`.

    - `master`, `ip`: override ROS_MASTER_URI and ROS_IP.
    - `shared_cmd_vel`: other nodes may publish commands, too, as with a multiplexer of the base.
    - `python`: an interpreter that has rospy.
    """

    master: str | None = None
    ip: str | None = None
    shared_cmd_vel: bool = False
    python: Name = "/usr/bin/python3"

    distro = Stores.ROS1_NOETIC

    @property
    def master_uri(self) -> str:
        """Where the master is."""
        return self.master or os.environ.get("ROS_MASTER_URI") or DEFAULT_MASTER

    @property
    def environ(self) -> dict[str, str]:
        """The adapter's environment."""
        own = {"ROS_MASTER_URI": self.master_uri, **({"ROS_IP": self.ip} if self.ip else {})}
        environ = {**os.environ, **own}
        if self.ip:
            environ.pop("ROS_HOSTNAME", None)  # rospy would use it in place of ROS_IP
        return environ


O = TypeVar("O", bound=TopicOptions)  # noqa: E741


def read_options(
    kind: type[O],
    options: Mapping[str, Value],
    driver: str,
    robot: str,
    platform: Platform | None = None,
) -> O:
    """The options with `{robot}` replaced; ConfigError names the option that is wrong.

    `platform`: the platform that the options must fit; None: the fit is not checked.
    """
    read = Layered((f"driver {driver}", options)).build(kind)
    own_name = re.sub(r"[^A-Za-z0-9_]", "_", robot)
    filled = msgspec.structs.replace(read, namespace=read.namespace.replace(_ROBOT, own_name))
    if isinstance(filled, RosOptions):
        parse_endpoint(filled.endpoint, f"driver {driver}: endpoint is ", DEFAULT_ENDPOINT)
    unfit = () if platform is None else _ring_faults(filled, platform.ranges is not None)
    for fault in (*unfit, *_faults(filled)):
        raise ConfigError(f"driver {driver}: {fault}")
    try:
        _ = filled.message_types, filled.topic_entries  # files are read once, here
    except ConfigError as error:
        raise ConfigError(f"driver {driver}: {error}") from None
    return filled


def _ring_faults(options: TopicOptions, has_ring: bool) -> Iterator[str]:
    if has_ring and not options.ranges:
        yield "ranges is missing; expected the topics of the platform's section ranges"
    if options.ranges and options.scan is not None and not has_ring:
        yield (
            f"scan is {options.scan!r} beside ranges; expected one of them, or the section ranges"
            " in the platform's file, which describes the further sensors: then both are used"
        )


def of_commands(options: Mapping[str, Value]) -> dict[str, Value]:
    """The options that a zero sender needs; it must start even if a `.msg` file is missing."""
    others = {*ENTRY_KINDS, "message_path", "services"}
    return {name: value for name, value in options.items() if name not in others}


def _faults(options: TopicOptions) -> Iterator[str]:
    """The texts of the faults of single options, and of names that are wrong or used twice."""
    if isinstance(options, Ros1Options) and _MASTER.fullmatch(options.master_uri) is None:
        yield (
            f"master is {options.master_uri!r}; expected a value such as {DEFAULT_MASTER}"
            " (without it, $ROS_MASTER_URI counts)"
        )
    if isinstance(options, RosOptions) and options.services is not None:
        yield from options.services.faults()
    for sensor, place in options.ranges.items():
        degrees, distance = _place(place)
        if not (abs(degrees) <= MAX_BEARING and 0.0 <= distance <= MAX_OFFSET):
            yield (
                f"ranges.{sensor} is {place}; expected a bearing in degrees, or"
                f" [bearing, distance] with 0 to {MAX_OFFSET:g} m"
            )
    empty, full = options.battery_volts or (1.0, 2.0)
    if not 0.0 < empty < full <= MAX_VOLTS:  # false for NaN too
        yield (
            f"battery_volts is [{empty:g}, {full:g}]; expected the volts of an empty and of a full"
            f" pack, such as [11.0, 12.6], up to {MAX_VOLTS:g}"
        )
    yield from _name_faults(options)


def _name_faults(options: TopicOptions) -> Iterator[str]:
    """The texts for options whose value is no ROS name, and for two options with one topic."""
    first_options: dict[str, str] = {}  # by topic
    own = f"{options.topic('swarmd')}/"  # where the robot publishes, and is stopped
    types = _types(options)
    pattern = _ROS2_NAME if isinstance(options, RosOptions) else _NAME
    for option, name in _names(options).items():
        if name is None:
            continue
        if pattern.fullmatch(name) is None:
            yield (
                f"{option} is {name!r}; expected a ROS name such as tb3_01 or front/scan"
                " (letters, digits, _ and /, a letter first)"
            )
        # A namespace is no topic, and an action and a topic may have one name.
        if option == "namespace" or option.startswith("other_actions"):
            continue
        topic = options.topic(name)
        if topic.startswith(own):
            yield f"{option} is {topic}; expected another topic: those in {own} are the robot's own"
        first = first_options.setdefault(topic, option)
        if first != option and (fault := _sharing_fault(first, option, types)):
            yield f"{first} and {option} are both {topic}{fault}"


def _sharing_fault(first: str, second: str, types: Mapping[str, str]) -> str:
    """Why two options may not name one topic, as the end of a sentence; empty if they may.

    `second` may share the topic if it is an entry, such as `readings.light`, and `first` is a
    sensor or an entry with the same message type. `types`: by option, as `_types` returns them.
    """
    is_entry = second.partition(".")[0] in ENTRY_KINDS
    if first not in types or not is_entry:
        return "; expected a topic each"
    if types[first] != types[second]:
        return f", as {types[first]} and {types[second]}; expected one type"
    return ""


def _names(options: TopicOptions) -> dict[str, str | None]:
    """The ROS names that the options hold, by option; None for an option without a name."""
    return {
        "namespace": options.namespace.strip("/") or None,
        # Without the option `ranges` a robot has a lidar, whose topic has a default name.
        "scan": options.scan if options.ranges else options.scan_topic,
        "odometry": options.odometry,
        "cmd_vel": options.cmd_vel,
        "imu": options.imu,
        "battery": options.battery,
        "shared_pose": options.shared_pose,
        **{f"ranges.{name}": name for name in options.ranges},
        **{option: topic for option, topic, _ in _entries(options)},
        **{f"other_commands[{n}]": name for n, name in enumerate(options.other_commands)},
        **{f"other_actions[{n}]": name for n, name in enumerate(options.other_actions)},
    }


def _types(options: TopicOptions) -> dict[str, str]:
    """The message type, such as `sensor_msgs/Imu`, of each option that is a sensor or an entry."""
    kinds = {
        "scan": messages.LaserScan,
        "odometry": messages.Odometry,
        "imu": messages.Imu,
        "battery": messages.BatteryState,
    }
    kinds |= {
        "shared_pose": options.pose_type,
        **{f"ranges.{name}": messages.Range for name in options.ranges},
    }
    return {
        **{option: name_of(kind).replace("/msg/", "/") for option, kind in kinds.items()},
        **{option: kind.replace("/msg/", "/") for option, _, kind in _entries(options)},
    }


def _entries(options: TopicOptions) -> Iterator[tuple[str, str, str]]:
    """The option, topic and message type of each topic of an entry."""
    for kind in ENTRY_KINDS:
        for name, entry in getattr(options, kind).items():
            for option, topic in entry.topics(name).items():
                yield option, topic, entry.type


def _place(place: float | tuple[float, float]) -> tuple[float, float]:
    """Bearing in degrees and distance in m."""
    return place if isinstance(place, tuple) else (place, 0.0)

"""Simulated robots that speak ROS 2 over Zenoh, all at one hub.

The hub is a session in router mode, as zenoh-bridge-ros2dds and rmw_zenohd are: drivers are clients
of it. Topics, types and domain are those of the platform's file for the driver; each robot has its
id for a namespace.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import zenoh
from msgspec.structs import astuple

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.events import OdometryInput, SensorInput
from swarmd.core.values import Platform, Twist, Value
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros import cdr, from_ros
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.options import RosOptions, read_options
from swarmd.drivers.ros.to_ros import InputEncoder, encoders, tag_encoders
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.link.carriers.session import PROMPT_OPTIONS, open_listening, realtime_publisher
from swarmd.settings.driver_options import BaseOptions

NAMESPACE = "{robot}"
MAX_COMMAND = 100.0
"""m/s or rad/s; a faster command is dropped as unreadable."""

_ROBOTS = "robot"
"""The kind of robots in the simulated world."""

_OPTIONS: dict[str, object] = {
    **PROMPT_OPTIONS,
    "mode": "router",
    # Zenoh's defaults, as of a bridge or rmw_zenohd: a message of other nodes beyond 65 kB, such as
    # a stop, comes in fragments, of which one without room drops all. Without a wait 0 of 10 stops
    # of 100 kB passed, with it 10 of 10 of 5 MB. The world waits once for a daemon that does not
    # read, at most: a full queue then drops at once (measured: 2 of 9400 messages took over 0.5 ms,
    # with the wait and without).
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 1_000,  # us
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 50_000,
    "transport/link/tx/queue/size/data": 16,  # batches; the world has a queue of its own
}


@dataclass(frozen=True, slots=True)
class EmulatorSpec:
    """The middleware of emulated robots; `scheme` takes the options and the robot's index."""

    driver: str
    options: type[RosOptions]
    scheme: Callable[[RosOptions, int], KeyScheme]


class EmulatedRobots:
    """Several robots at one hub: an `Emulator`."""

    def __init__(
        self,
        spec: EmulatorSpec,
        robots: Mapping[str, Platform],
        endpoint: str,
        on_command: OnCommand,
    ) -> None:
        """Open the hub at `endpoint`, announce the robots' topics, and subscribe to all commands.

        `spec`: the middleware. `robots`: the platform of each robot by its id. Sets
        `driver_options`, with which the robots' drivers find the hub. Raises as `EmulatorFactory`
        does.
        """
        self.dropped = 0  # commands that could not be read
        self._lock = threading.Lock()
        self._on_command = on_command
        options_of = {robot: _options(spec, robot, platform) for robot, platform in robots.items()}
        _check_distinct(spec, options_of)
        _check_tags(spec, options_of)
        # The first use of a message type takes milliseconds, which would delay a scan.
        cdr.build_codecs(ros.LaserScan, ros.Range, ros.Odometry, ros.Twist, ros.TwistStamped)
        self._hub, self.endpoint = open_listening(endpoint, _OPTIONS, f"the robots' {spec.driver}")
        platforms = {platform.name: platform for platform in robots.values()}
        readings = {name for each in platforms.values() for name in emulated_readings(each)}
        self.driver_options: Mapping[str, Value] = {
            "endpoint": self.endpoint,
            "namespace": NAMESPACE,
            "readings": {name: _reading(name) for name in sorted(readings)},
        }
        self._robots: dict[str, _Robot] = {}
        try:
            for index, (robot, platform) in enumerate(robots.items()):
                options = options_of[robot]
                scheme = spec.scheme(options, index)
                self._robots[robot] = self._start(robot, platform, options, scheme)
        except BaseException:
            self._hub.close()
            raise

    def publish(self, robot: str, input: SensorInput) -> None:
        """Publish an input on the topics that the robot's options name.

        `to_ros.encoders` gives the messages; an input of a kind without an encoder is ignored.
        """
        self._robots[robot].publish(input)

    def close(self) -> None:
        """End the session."""
        self._hub.close()

    def _start(
        self, robot: str, platform: Platform, options: RosOptions, scheme: KeyScheme
    ) -> _Robot:
        command_type = options.command_types[0]
        topic = options.topic(options.cmd_vel)

        def on_sample(sample: zenoh.Sample) -> None:
            try:
                twist = _command(cdr.decode(command_type, sample.payload.to_bytes()))
            except CodecError:  # an unreadable command must not replace an earlier command
                with self._lock:
                    self.dropped += 1
                return
            self._on_command(robot, twist)

        self._hub.declare_subscriber(scheme.key(topic, command_type), on_sample)
        command = TopicEnd(topic, command_type, is_publisher=False, is_reliable=True, depth=10)
        return _Robot(self._hub, platform, options, scheme, command)


class _Robot:
    """The publishers of one robot."""

    def __init__(
        self,
        hub: zenoh.Session,
        platform: Platform,
        options: RosOptions,
        scheme: KeyScheme,
        command: TopicEnd,
    ) -> None:
        """Declare a publisher for each topic of each sensor, and announce these topics.

        `command`: the subscription of commands, which is announced too.
        """
        self._scheme = scheme
        self._stamp = 0.0
        published: list[TopicEnd] = []
        # By kind of input, each encoder with the index of its first publisher.
        self._encoders: dict[type[SensorInput], list[tuple[int, InputEncoder]]] = {}
        for kind, kind_encoders in encoders(options, platform).items():
            self._encoders[kind] = []
            for encoder in kind_encoders:
                self._encoders[kind].append((len(published), encoder))
                published += [
                    TopicEnd(topic, message_type, True, encoder.is_reliable, encoder.depth)
                    for topic, message_type in encoder.topics
                ]
        # The tokens of the ends come last, in order; rmw_zenoh has a token of the node before them.
        ends = [*published, command]
        tokens = scheme.tokens(str(hub.info.zid()), ends)
        self._announced = [hub.liveliness().declare_token(token) for token in tokens]
        self._tokens = tokens[-len(ends) :]
        self._publishers = [
            realtime_publisher(hub, scheme.key(end.topic, end.message_type)) for end in published
        ]

    def publish(self, input: SensorInput) -> None:
        (value,) = astuple(input)
        if isinstance(input, OdometryInput):
            self._stamp = input.odometry.stamp
        for first, encoder in self._encoders.get(type(input), ()):
            for index, message in enumerate(encoder.encode(value, self._stamp), first):
                if message is not None:
                    self._put(index, message)

    def _put(self, index: int, message: object) -> None:
        attachment = self._scheme.attachment(self._tokens[index])
        with contextlib.suppress(zenoh.ZError):
            self._publishers[index].put(cdr.encode(message), attachment=attachment)


def emulated_readings(platform: Platform) -> dict[str, Value]:
    """The option `readings` of a robot's driver: a topic for each reading that it provides."""
    words = (word.partition(":") for word in sorted(platform.provides))
    return {name: _reading(name) for kind, colon, name in words if kind == "reading" and colon}


def _reading(name: str) -> dict[str, Value]:
    return {"topic": f"readings/{name}", "type": "std_msgs/Float64", "field": "data"}


def _options(spec: EmulatorSpec, robot: str, platform: Platform) -> RosOptions:
    """The options of the robot's driver, in the robot's own namespace."""
    common = BaseOptions.__struct_fields__
    given = platform.drivers.get(spec.driver, {})
    own = {name: value for name, value in given.items() if name not in common}
    own["readings"] = emulated_readings(platform)
    return read_options(spec.options, {**own, "namespace": NAMESPACE}, spec.driver, robot)


def _check_distinct(spec: EmulatorSpec, options_of: Mapping[str, RosOptions]) -> None:
    """Raise ConfigError if two robots would use one topic; `options_of`: by robot."""
    owners: dict[str, str] = {}
    for robot, options in options_of.items():
        for name in (options.cmd_vel, options.odometry, *(options.ranges or (options.scan_topic,))):
            topic = options.topic(name)
            owner = owners.setdefault(topic, robot)
            if owner != robot:
                raise ConfigError(
                    f"robots {owner} and {robot} have one topic {topic}; take the first slash off"
                    f" its name in the platform's file, under drivers.{spec.driver}"
                )


def _check_tags(spec: EmulatorSpec, options_of: Mapping[str, RosOptions]) -> None:
    """Raise ConfigError if the number of a robot's tag stands for another kind of object."""
    for robot, options in options_of.items():
        for encoder in tag_encoders(options):
            kind = encoder.taken_for(_ROBOTS, robot)
            if kind != _ROBOTS:
                raise ConfigError(
                    f"drivers.{spec.driver}.{encoder.option}.kinds: the tag of robot"
                    f" {robot} has its number, which stands for {kind}; give {kind} a number that"
                    " no robot's name ends with"
                )


def _command(message: object) -> Twist:
    """The twist of a command; CodecError if no base could follow it."""
    twist = from_ros.twist_of(message)
    speeds = abs(twist.linear), abs(twist.angular), abs(twist.lateral)
    if not twist.is_finite or max(speeds) > MAX_COMMAND:
        raise CodecError(f"a twist that is not finite, or faster than {MAX_COMMAND:g}")
    return twist

"""Robots that speak ROS 2 over Zenoh and are none: the bodies of a simulated world, at one hub.

The hub is a session in router mode, as zenoh-bridge-ros2dds and rmw_zenohd are: drivers are clients
of it. Topics, types and domain are those that the platform's file tells the driver; each robot has
its id for a namespace.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import zenoh

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.values import Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import from_ros as conversion
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.options import RosOptions, read_options, topic
from swarmd.drivers.ros.to_ros import odometry_message, scan_voice
from swarmd.network.session import open_listening
from swarmd.settings.driver_options import BaseOptions

NAMESPACE = "{robot}"

_FASTEST = 100.0  # m/s or rad/s: what asks for more is no command
_OPTIONS: dict[str, object] = {
    "mode": "router",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # The world never waits for a daemon that does not read.
    "transport/link/tx/queue/size/real_time": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 0,
    "transport/shared_memory/enabled": False,
}


@dataclass(frozen=True, slots=True)
class End:
    """One end of a topic at a robot: it publishes, or it listens. `topic` is the full name."""

    topic: str
    kind: type
    is_publisher: bool
    is_sensor: bool = False


class Voice(Protocol):
    """Keys and framing of one robot's side."""

    def key(self, topic: str, kind: type) -> str:
        """The key of a topic."""

    def announce(self, zid: str, ends: Sequence[End]) -> tuple[Sequence[str], Sequence[str]]:
        """The liveliness tokens that make the node known, and those of each end."""

    def attachment(self, token: str) -> bytes | None:
        """What goes with the next message of the end that is announced by this token."""


@dataclass(frozen=True, slots=True)
class Language:
    """What tells one dialect's robots from another's. `voice` is made of options and an index."""

    driver: str
    options: type[RosOptions]
    voice: Callable[[RosOptions, int], Voice]


class RosRobots:
    """Several robots at one hub."""

    def __init__(
        self,
        language: Language,
        robots: Mapping[str, Platform],
        endpoint: str,
        on_command: OnCommand,
    ) -> None:
        """Subscribe to all commands. Raises as `RobotSideFactory` does."""
        self.dropped = 0
        self._lock = threading.Lock()
        self._on_command = on_command
        read = {robot: _options(language, robot, robots[robot]) for robot in robots}
        _check_apart(language, read)
        cdr.warm(ros.LaserScan, ros.Range, ros.Odometry, ros.Twist, ros.TwistStamped)
        what = f"the robots' {language.driver}"
        self._hub, self.endpoint = open_listening(endpoint, _OPTIONS, what)
        self.driver_options: Mapping[str, Value] = {
            "endpoint": self.endpoint,
            "namespace": NAMESPACE,
        }
        try:
            self._robots = {
                robot: self._rise(robot, platform, read[robot], language.voice(read[robot], index))
                for index, (robot, platform) in enumerate(robots.items())
            }
        except BaseException:
            self._hub.close()
            raise

    def scan(self, robot: str, scan: Scan) -> None:
        """Say a sweep."""
        self._robots[robot].scan(scan)

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """Say pose and twist."""
        self._robots[robot].odometry(odometry)

    def close(self) -> None:
        """End the session."""
        self._hub.close()

    def _rise(self, robot: str, platform: Platform, options: RosOptions, voice: Voice) -> _Robot:
        is_stamped = options.cmd_vel_type == "twist_stamped"
        command = ros.TwistStamped if is_stamped else ros.Twist
        full = topic(options, options.cmd_vel)

        def on_sample(sample: zenoh.Sample) -> None:
            try:
                twist = _asked(cdr.decode(command, sample.payload.to_bytes()))
            except CodecError:  # it must not take the place of one that can be read
                with self._lock:
                    self.dropped += 1
                return
            self._on_command(robot, twist)

        self._hub.declare_subscriber(voice.key(full, command), on_sample)
        return _Robot(self._hub, platform, options, voice, End(full, command, is_publisher=False))


class _Robot:
    """What one robot says."""

    def __init__(
        self,
        hub: zenoh.Session,
        platform: Platform,
        options: RosOptions,
        voice: Voice,
        command: End,
    ) -> None:
        self._voice, self._eyes = voice, scan_voice(options, platform)
        says = [End(name, kind, True, is_sensor=True) for name, kind in self._eyes.topics]
        says.append(End(topic(options, options.odometry), ros.Odometry, is_publisher=True))
        nodes, self._ends = voice.announce(str(hub.info.zid()), [*says, command])
        liveliness = hub.liveliness()
        self._tokens = [liveliness.declare_token(token) for token in (*nodes, *self._ends)]
        self._publishers = [_publisher(hub, voice.key(end.topic, end.kind)) for end in says]

    def scan(self, scan: Scan) -> None:
        for index, message in enumerate(self._eyes.say(scan)):
            self._put(index, message)

    def odometry(self, odometry: Odometry) -> None:
        self._put(len(self._publishers) - 1, odometry_message(odometry))

    def _put(self, index: int, message: object) -> None:
        attachment = self._voice.attachment(self._ends[index])
        with contextlib.suppress(zenoh.ZError):
            self._publishers[index].put(cdr.encode(message), attachment=attachment)


def _options(language: Language, robot: str, platform: Platform) -> RosOptions:
    """What the robot's driver goes by, in the robot's own namespace."""
    common = BaseOptions.__struct_fields__
    given = platform.drivers.get(language.driver, {})
    told = {name: value for name, value in given.items() if name not in common}
    told = {**told, "namespace": NAMESPACE}
    return read_options(language.options, told, language.driver, robot)


def _check_apart(language: Language, read: Mapping[str, RosOptions]) -> None:
    """ConfigError if two robots would listen to the same commands, or say the same topic."""
    owners: dict[str, str] = {}
    for robot, options in read.items():
        for name in (options.cmd_vel, options.odometry, *(options.ranges or (options.scan,))):
            full = topic(options, name)
            other = owners.setdefault(full, robot)
            if other != robot:
                raise ConfigError(
                    f"robots {other} and {robot} have one topic {full}; take the first slash off"
                    f" its name in the platform's file, under drivers.{language.driver}"
                )


def _asked(message: object) -> Twist:
    """The command; CodecError if it is none that a base could follow."""
    if isinstance(message, ros.TwistStamped):
        message = message.twist
    assert isinstance(message, ros.Twist)
    twist = conversion.twist_of(message)
    speeds = abs(twist.linear), abs(twist.angular), abs(twist.lateral)
    if not twist.is_finite or max(speeds) > _FASTEST:
        raise CodecError("a twist that is not finite, or faster than anything")
    return twist


def _publisher(hub: zenoh.Session, key: str) -> zenoh.Publisher:
    return hub.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )

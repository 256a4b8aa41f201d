"""Driver `ros2dds`: ROS 2 over DDS, through a zenoh-bridge-ros2dds.

The key of a topic is its name, and a sample is CDR. Keys and announcements follow the bridge's
source (eclipse-zenoh/zenoh-plugin-ros2dds 1.10: `ros2_utils.rs`, `liveliness_mgt.rs`).
`make_robots` makes simulated robots behind such a bridge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from swarmd.core.errors import CodecError
from swarmd.core.values import Platform, Value
from swarmd.driver_api.driver import ZeroSenderSpec
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.foreign_commands import ROS2_ACTIONS
from swarmd.drivers.ros.options import RosOptions, of_commands, read_options
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.emulator import EmulatedRobots, EmulatorSpec
from swarmd.drivers.ros2.key_scheme import Ros2Middleware, TopicEnd
from swarmd.drivers.ros2.zero_sender import RosZeroSender

NAME = "ros2dds"

_RELIABILITY = {"0": "best effort", "1": "reliable"}  # by the numbers of DDS
_TRANSIENT_LOCAL = "1"
# of the attachment: client, number, byte order
_REQUEST_MARK = b"rqh"
_REQUEST_SIZE = 20


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> RosDriver:
    """A driver that has not connected yet; ConfigError for unknown options."""
    read = read_options(RosOptions, options, NAME, robot, platform)
    spec = ZeroSenderSpec(
        f"{__name__}:make_zero_sender", {"robot": robot, "given": of_commands(options)}
    )
    return RosDriver(NAME, Ros2Dds(), platform, read, spec)


def make_zero_sender(*, robot: str, given: Mapping[str, Value]) -> RosZeroSender:
    """The zero sender of the watchdog's process."""
    return RosZeroSender(Ros2Dds(), read_options(RosOptions, given, NAME, robot))


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> EmulatedRobots:
    """Simulated robots, each in its own namespace, at one bridge that listens at `endpoint`."""
    spec = EmulatorSpec(NAME, RosOptions, lambda options, index: Ros2Dds())
    return EmulatedRobots(spec, robots, endpoint, on_command)


class Ros2Dds(Ros2Middleware):
    """The bridge's keys: the topic without its first slash, behind the bridge's namespace."""

    hub = "zenoh-bridge-ros2dds"
    start = "start zenoh-bridge-ros2dds on the robot"
    silent = (
        "announces no topic at all; start the robot's ROS 2 or, if it runs, the bridge again, with"
        " its ROS_DOMAIN_ID, ROS_DISTRO and localhost settings"
    )
    announcements = "@/*/@ros2_lv/**"
    admin_space = "@/*/ros2"
    is_node = False
    crashed = "zenoh-bridge-ros2dds will forget it: start that again"
    lease = 13.0  # s: 10 s of DDS, and 2 s between two queries of the bridge
    domain: int | None = None

    def subscription_key(self, topic: str) -> str:
        """The one key of the topic or service."""
        return topic.removeprefix("/")

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """The fault of a put on a wildcard key; the key does not name the type."""
        return "" if key == self.subscription_key(topic) else f"sent on key {key[:80]!a}"

    def parse_token(self, token: str) -> Endpoint | None:
        """The endpoint of `@/<zid>/@ros2_lv/{MP|MS}/<key>/<type>/<qos>`, with § for inner slashes.

        MP is a publisher of messages, MS a subscriber; other tokens give None. The server of an
        action has a token `AS/<key>/<type>`, which is read as the publisher of the action's status.
        """
        parts = token.split("/")
        if len(parts) == 6 and parts[3] == "AS":
            topic = f"/{parts[4].replace('§', '/')}/{ROS2_ACTIONS.status}"
            return Endpoint(True, topic, name_of(ROS2_ACTIONS.message_type), parts[1])
        if len(parts) != 7 or parts[3] not in ("MP", "MS"):
            return None
        topic, type_name = (part.replace("§", "/") for part in parts[4:6])
        _, reliability, durability, *_ = f"{parts[6]}:::".split(":")
        quality = _RELIABILITY.get(reliability, "")
        quality += ", transient local" if quality and durability == _TRANSIENT_LOCAL else ""
        return Endpoint(parts[3] == "MP", f"/{topic}", type_name, parts[1], quality=quality)

    def key(self, topic: str, message_type: type) -> str:
        """The one key of the topic."""
        return self.subscription_key(topic)

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """The one key of the topic."""
        return (self.subscription_key(topic),)

    def tokens(
        self, zid: str, ends: Sequence[TopicEnd], services: Sequence[str] | None = None
    ) -> tuple[str, ...]:
        """The tokens of a bridge, one for each end; emulated bridges have no services."""
        found = []
        for end in ends:
            direction = "MP" if end.is_publisher else "MS"
            key = self.subscription_key(end.topic).replace("/", "§")
            type_name = name_of(end.message_type).replace("/", "§")
            qos = f":{int(end.is_reliable)}::0,{end.depth}"
            found.append(f"@/{zid}/@ros2_lv/{direction}/{key}/{type_name}/{qos}")
        return tuple(found)

    def attachment(self, token: str = "") -> bytes | None:
        """None: the bridge uses no attachments."""
        return None

    def call_stamp(self, key: str, attachment: bytes | None) -> None:
        """None: the bridge hands on no time. CodecError without the header of a DDS request."""
        is_marked = attachment is not None and attachment.startswith(_REQUEST_MARK)
        if "*" in key or not is_marked or len(attachment or b"") != _REQUEST_SIZE:
            raise CodecError("no call of a bridge")

    def reply_attachment(self, attachment: bytes | None) -> None:
        """None: the bridge needs no attachment of a reply."""

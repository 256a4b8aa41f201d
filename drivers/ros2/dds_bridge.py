"""ROS 2 over DDS, through a zenoh-bridge-ros2dds: a topic is its key, a sample is raw CDR.

Keys and announcements as in the bridge's own source (eclipse-zenoh/zenoh-plugin-ros2dds 1.10:
`ros2_utils.rs`, `liveliness_mgt.rs`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from swarmd.core.values import Platform, Value
from swarmd.driver_api.driver import SenderSpec
from swarmd.drivers.ros.options import RosOptions, read_options
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.key_scheme import Endpoint
from swarmd.drivers.ros2.zero_sender import RosZeroSender, zero_sender_of

NAME = "ros2dds"


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> RosDriver:
    """A driver that has not connected yet; ConfigError for options it does not know."""
    read = read_options(RosOptions, options, NAME, robot)
    stopping = SenderSpec(f"{__name__}:make_zero_sender", {"robot": robot, "given": dict(options)})
    return RosDriver(NAME, Ros2Dds(), platform, read, stopping)


def make_zero_sender(*, robot: str, given: Mapping[str, Value]) -> RosZeroSender:
    """What the stopper's process says zero with."""
    return zero_sender_of(Ros2Dds(), read_options(RosOptions, given, NAME, robot))


class Ros2Dds:
    """The bridge's keys: the topic without its first slash, behind the bridge's namespace."""

    hub = "zenoh-bridge-ros2dds"
    start = "start zenoh-bridge-ros2dds on the robot"
    silent = (
        "start the robot's ROS 2 or, if it runs, the bridge anew, with its ROS_DOMAIN_ID,"
        " ROS_DISTRO and localhost settings"
    )
    graph = "@/*/@ros2_lv/**"
    nodes = "@/*/ros2/node/**"
    domain: int | None = None

    def listening(self, topic: str) -> str:
        """The one key of the topic."""
        return topic.removeprefix("/")

    def fault(self, key: str, topic: str, kind: type) -> str:
        """Only a wildcard put can be wrong: the key says nothing of the type."""
        return "" if key == self.listening(topic) else f"said on key {key[:80]!a}"

    def announced(self, token: str) -> Endpoint | None:
        """From `@/<zid>/@ros2_lv/{MP|MS}/<key>/<type>/<qos>`, with § for the slashes inside."""
        parts = token.split("/")
        if len(parts) != 7 or parts[3] not in ("MP", "MS"):
            return None
        topic, kind = (part.replace("§", "/") for part in parts[4:6])
        return Endpoint(parts[3] == "MP", f"/{topic}", kind, parts[1])

    def command_keys(self, topic: str, kind: type) -> tuple[str, ...]:
        """The one key of the topic."""
        return (self.listening(topic),)

    def command_key(self, topic: str, kind: type) -> str:
        """The one key of the topic."""
        return self.listening(topic)

    def attachment(self) -> bytes | None:
        """None: the bridge wants the payload alone."""
        return None

    def introduce(self, zid: str, heard: Iterable[tuple[str, type]]) -> tuple[str, ...]:
        """Nothing: only a bridge announces itself to bridges."""
        return ()

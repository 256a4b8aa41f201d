"""How the two ways of ROS 2 over Zenoh differ: keys, framing, and how topics are announced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.diagnosis import Middleware
from swarmd.drivers.ros.endpoints import Endpoint


@dataclass(frozen=True, slots=True)
class TopicEnd:
    """A publisher or a subscription of this process. `topic` is the full name."""

    topic: str
    message_type: type
    is_publisher: bool
    is_reliable: bool
    depth: int


class Ros2Middleware:
    """What both ways have in common."""

    endpoint_option = "driver_options.endpoint"
    silent_topic = "look at the sensor: ros2 topic hz"
    topic_info = "ros2 topic info -v"

    def type_name(self, message_type: type) -> str:
        """Such as `sensor_msgs/msg/LaserScan`."""
        return name_of(message_type)


class KeyScheme(Middleware, Protocol):
    """Keys and framing of one way of speaking ROS 2 over Zenoh.

    `announcements` is the key expression of the tokens, `admin_space` the root of a bridge's
    answers, with `*` for the bridge, empty where there is no bridge.
    `is_node`: whether the driver announces itself; only a bridge announces itself to bridges.
    """

    announcements: str
    admin_space: str
    is_node: bool

    def subscription_key(self, topic: str) -> str:
        """The key expression to subscribe to for a topic."""

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """What is wrong with a sample's key; empty if it is of that topic and type."""

    def parse_token(self, token: str) -> Endpoint | None:
        """The endpoint that a liveliness token announces; None if it announces no topic."""

    def key(self, topic: str, message_type: type) -> str:
        """The key to publish on, as far as the robot's samples tell."""

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """All keys on which a robot may subscribe to commands."""

    def tokens(self, zid: str, ends: Sequence[TopicEnd]) -> tuple[str, ...]:
        """The tokens that announce a node with these ends; those of the ends come last."""

    def attachment(self, token: str = "") -> bytes | None:
        """The attachment of the next message of the publisher that this token announces."""

"""How the two ways of ROS 2 over Zenoh differ: keys, framing, and how topics are announced."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.diagnosis import Endpoint, Middleware


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

    `tokens` is the key expression of the announcements and `nodes` that of a bridge's answers about
    its nodes, empty where there is no bridge.
    """

    tokens: str
    nodes: str

    def subscription_key(self, topic: str) -> str:
        """The key expression to subscribe to for a topic."""

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """What is wrong with a sample's key; empty if it is of that topic and type."""

    def parse_token(self, token: str) -> Endpoint | None:
        """The endpoint that a liveliness token announces; None if it announces no topic."""

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """All keys on which a robot may subscribe to commands."""

    def command_key(self, topic: str, message_type: type) -> str:
        """The one of them that this robot uses, as far as its samples tell."""

    def attachment(self) -> bytes | None:
        """The attachment of the next command."""

    def own_tokens(self, zid: str, topics: Iterable[tuple[str, type]]) -> tuple[str, ...]:
        """The tokens that announce the driver as a node with these topics, commands last."""

"""The interface of a ROS 2 middleware over Zenoh: keys, attachments and liveliness tokens.

`dds_bridge.py` and `rmw_zenoh.py` implement it.
"""

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
    """The phrases that both middlewares have in common."""

    endpoint_option = "driver_options.endpoint"
    silent_topic = "look at the sensor: ros2 topic hz"
    topic_info = "ros2 topic info -v"

    def type_name(self, message_type: type) -> str:
        """Such as `sensor_msgs/msg/LaserScan`."""
        return name_of(message_type)


class KeyScheme(Middleware, Protocol):
    """Keys, attachments and tokens of one ROS 2 middleware over Zenoh."""

    announcements: str  # the key expression of the liveliness tokens
    admin_space: str  # the root of a bridge's admin space, `*` for its id; empty without a bridge
    is_node: bool  # the driver declares tokens of its own; with a bridge only the bridge does

    def subscription_key(self, topic: str) -> str:
        """The key expression on which the messages of a topic, or calls of a service, arrive."""

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """The fault of a sample's key; empty if the key is of that topic and type."""

    def parse_token(self, token: str) -> Endpoint | None:
        """The endpoint that a liveliness token announces; None if it announces no topic."""

    def key(self, topic: str, message_type: type) -> str:
        """The key to publish on; it may depend on the samples of the robot so far."""

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """All keys on which a robot may subscribe to commands."""

    def tokens(
        self, zid: str, ends: Sequence[TopicEnd], services: Sequence[str] | None = None
    ) -> tuple[str, ...]:
        """The tokens that announce a node with these ends; those of the ends come last.

        With `services`, of type std_srvs/Trigger, the node is a further node of this process.
        """

    def attachment(self, token: str = "") -> bytes | None:
        """The attachment of the next message of the publisher that this token announces."""

    def call_stamp(self, key: str, attachment: bytes | None) -> float | None:
        """When a call was sent, in s since 1970 by the caller's clock; None: not known.

        CodecError if key or attachment are not those of a call of a std_srvs/Trigger.
        """

    def reply_attachment(self, attachment: bytes | None) -> bytes | None:
        """The attachment of the reply to a call with this attachment."""

"""How the two ways of ROS 2 over Zenoh differ: keys, framing, and how topics are announced."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a topic, as it is announced: a publisher or a subscription.

    `topic` such as `/tb3_01/scan`, `type` such as `sensor_msgs/msg/LaserScan`; `domain` None where
    the announcement does not tell it, `node` empty likewise. `zid` is the session that announced
    it.
    """

    is_publisher: bool
    topic: str
    type: str
    zid: str
    domain: int | None = None
    node: str = ""

    @property
    def who(self) -> str:
        """The node, or what stands for all of those that a bridge announces without a name."""
        return self.node or f"a node behind bridge {self.zid[:8]}"


class KeyScheme(Protocol):
    """Keys and framing of one way of speaking ROS 2 over Zenoh.

    `hub` is what listens at the endpoint, `start` the step that starts it, `silent` what to look
    at when it announces no topic at all. `graph` is the key expression of the announcements,
    `nodes` that of a bridge's answers about its nodes, or empty.
    """

    hub: str
    start: str
    silent: str
    graph: str
    nodes: str
    domain: int | None

    def listening(self, topic: str) -> str:
        """The key expression to subscribe to for a topic."""

    def fault(self, key: str, topic: str, kind: type) -> str:
        """What is wrong with a sample's key; empty if it is one of that topic and type."""

    def announced(self, token: str) -> Endpoint | None:
        """What a liveliness token announces; None if no topic."""

    def command_keys(self, topic: str, kind: type) -> tuple[str, ...]:
        """All keys on which a robot may listen for commands."""

    def command_key(self, topic: str, kind: type) -> str:
        """The one of them on which this robot listens, going by what was heard of it."""

    def attachment(self) -> bytes | None:
        """What goes with the next command, beside its payload."""

    def introduce(self, zid: str, heard: Iterable[tuple[str, type]]) -> tuple[str, ...]:
        """The tokens that make us known to the others, as a node that hears these topics."""

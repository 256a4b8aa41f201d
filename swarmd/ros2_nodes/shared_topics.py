"""Topics whose messages go to the other robots, as messages of the pattern, bounded in number."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from swarmd.core.codec import MAX_MESSAGE, encode_value
from swarmd.core.errors import CodecError, PluginError
from swarmd.core.values import Message, Value
from swarmd.ros2_nodes.graph import Graph, Published

CHANNEL = "topics"
"""The channel of the pattern; its values are lists of [number of the topic, fields]."""
MAX_WAITING = 64
"""Messages that wait to be sent; a further one replaces the oldest."""
_ROOM = MAX_MESSAGE - 64
"""Encoded bytes of the messages of one step, less the envelope."""


class SharedTopics:
    """The shared topics of one robot, in the order of the launch file, which all robots have.

    `lost`: messages of this robot that were replaced before they were sent. `refused`: messages of
    others that do not fit the topic.
    """

    def __init__(self, graph: Graph, topics: Sequence[str]) -> None:
        self._graph = graph
        self._topics = list(topics)
        self._waiting: deque[tuple[int, list[Any]]] = deque()
        self.lost = 0
        self.refused = 0

    def take(self, published: Published) -> None:
        """Keep a message of a node for the other robots; PluginError if it is too large."""
        if published.topic not in self._topics:
            return
        fields = type(published.message).plain(published.message)
        number = self._topics.index(published.topic)
        if _size([number, fields]) > _ROOM:
            raise PluginError(
                f"a message on {published.topic} has more than {_ROOM} bytes, the most that goes"
                " to other robots; take the topic out of `shared`, or send less"
            )
        if len(self._waiting) >= MAX_WAITING:
            self._waiting.popleft()
            self.lost += 1
        self._waiting.append((number, fields))

    def outgoing(self) -> dict[str, Value]:
        """The messages of this step for the channel of the pattern, oldest first."""
        sent: list[Any] = []
        room = _ROOM
        while self._waiting:
            one = list(self._waiting[0])
            room -= _size(one)
            if room < 0:
                break
            sent.append(one)
            self._waiting.popleft()
        return {CHANNEL: sent} if sent else {}

    def deliver(self, messages: Iterable[Message]) -> None:
        """Hand the messages of other robots to the nodes; what does not fit is counted."""
        for message in messages:
            if message.channel != CHANNEL or not isinstance(message.value, list):
                continue
            for one in message.value:
                if not self._deliver(one):
                    self.refused += 1

    def _deliver(self, one: Any) -> bool:
        try:
            number, fields = one
            topic = self._topics[number]
            if number < 0:
                return False
            for subscription in self._graph.subscriptions_of(topic):
                kind = subscription.msg_type
                self._graph.deliver(topic, kind.of_plain(fields))
                break
        except (ValueError, TypeError, AssertionError, LookupError, OverflowError, AttributeError):
            return False
        return True


def _size(value: Any) -> int:
    try:
        return len(encode_value(value))
    except CodecError:
        return MAX_MESSAGE

"""Makes the graph of a ROS 1 robot's topics for `diagnosis.py` from the adapter's events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.options import Ros1Options
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.adapter import ForeignMessage, MasterState

_ANY_TYPE = "*"
"""The type that a node states which takes a topic of any type."""


class Ros1:
    """The phrases for ROS 1 in the texts of `diagnosis.py`."""

    hub = "roscore"
    start = "start roscore"
    endpoint_option = "driver_options.master (or ROS_MASTER_URI)"
    silent = (
        "knows no topic of that type; start the robot's nodes, or correct driver_options.namespace"
    )
    silent_topic = (
        "look at the sensor, at whether its node still runs, and at ROS_IP on both machines:"
        " rostopic hz"
    )
    topic_info = "rostopic info"
    crashed = "the master knows one node of a name"
    lease = 0.0
    domain: int | None = None

    def type_name(self, message_type: type) -> str:
        """Such as `sensor_msgs/LaserScan`."""
        return serialization.type_name(message_type)


class MasterGraph:
    """The state of the ROS master and of publishers, for the life of one adapter process.

    `command_type`: such as `geometry_msgs/Twist`; empty while neither the options nor a base give
    the type.
    """

    def __init__(self, options: Ros1Options, topics: Mapping[str, TopicStats]) -> None:
        """Start without a state; `topics`: of the driver."""
        self.cmd_vel = options.topic(options.cmd_vel)
        self.state: MasterState | None = None
        names = [serialization.type_name(kind) for kind in options.command_types]
        self.command_type = names[0] if len(names) == 1 else ""
        self._options = options
        self._topics = {stats.topic: stats for stats in topics.values()}
        self._foreign_types: dict[tuple[str, str], str] = {}

    def on_state(self, state: MasterState) -> None:
        """Take a new state; the next messages report foreign types again."""
        self.state = state
        self.command_type = state.command_type or self.command_type
        self._foreign_types.clear()

    def on_foreign(self, message: ForeignMessage) -> None:
        """Note a publisher with another type than the driver's, or with another definition."""
        stats = self._topics.get(message.topic)
        kind = message.type
        if stats is not None and kind == serialization.type_name(stats.message_type):
            wanted = serialization.definition(stats.message_type)[1]
            kind = f"{kind} (md5 {message.md5sum}, not {wanted})"
        self._foreign_types[message.topic, message.node] = kind

    @property
    def blocks(self) -> bool:
        """True if another node's publisher of commands keeps the driver from commanding."""
        return bool(self.state and self.state.others) and not self._options.shared_cmd_vel

    def graph(self) -> Graph:
        """The publishers and subscribers of other nodes, from the last state of the master."""
        state = self.state or MasterState(master=False)
        return Graph(
            middleware=Ros1(),
            endpoints=[*self._publishers(state), *self._subscribers(state)],
            options=self._options,
            heard={stats.topic for stats in self._topics.values() if stats.count},
        )

    def _publishers(self, state: MasterState) -> Iterator[Endpoint]:
        """The publishers of the driver's topics with their nodes, then topics of equal types."""
        for topic, nodes in state.publishers.items():
            for node in nodes:
                master_type = self._type_of(topic, state.types.get(topic, ""))
                kind = self._foreign_types.get((topic, node), master_type)
                yield Endpoint(True, topic, kind, node=node)
        for kind, topics in state.candidates.items():
            for topic in topics:
                if topic not in state.publishers:
                    yield Endpoint(True, topic, kind)

    def _subscribers(self, state: MasterState) -> Iterator[Endpoint]:
        """The subscribers of the commands with their nodes, then other topics of command types."""
        for node in state.listeners:
            wanted = state.wants.get(node, "")  # empty for a connected node
            takes_command_type = wanted in ("", _ANY_TYPE)
            kind = self.command_type if takes_command_type else wanted
            if kind:
                yield Endpoint(False, self.cmd_vel, kind, node=node)
        for kind, topics in state.taken_topics.items():
            for topic in topics:
                if topic != self.cmd_vel:
                    yield Endpoint(False, topic, kind)

    def _type_of(self, topic: str, kind: str) -> str:
        """The type of a topic by the master; if it knows none, the type of the driver."""
        stats = self._topics.get(topic)
        if kind in ("", _ANY_TYPE) and stats is not None:
            return serialization.type_name(stats.message_type)
        return kind

"""Makes the graph of a ROS 1 robot's topics for `diagnosis.py` from the adapter's events."""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.options import Ros1Options
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.adapter import ForeignMessage, MasterState


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
        stats, kind = self._topics.get(message.topic), message.type
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
        state, ends = self.state or MasterState(master=False), list[Endpoint]()
        # 1. Publishers: of the driver's topics with their nodes, and of topics of the same types.
        for topic, nodes in state.publishers.items():
            for node in nodes:
                master_type = self._type_of(topic, state.types.get(topic, ""))
                kind = self._foreign_types.get((topic, node), master_type)
                ends.append(Endpoint(True, topic, kind, node=node))
        ends += [
            Endpoint(True, topic, kind)
            for kind, topics in state.candidates.items()
            for topic in topics
            if topic not in state.publishers
        ]
        # 2. Subscribers: of the commands with their nodes, and of other topics of command types.
        for node in state.listeners:
            # A node that takes any type states `*`; a node that is connected takes `command_type`.
            kind = state.wants.get(node, "").strip("*") or self.command_type
            if kind:
                ends.append(Endpoint(False, self.cmd_vel, kind, node=node))
        ends += [
            Endpoint(False, topic, kind)
            for kind, topics in state.taken_topics.items()
            for topic in topics
            if topic != self.cmd_vel
        ]
        return Graph(
            middleware=Ros1(),
            endpoints=ends,
            options=self._options,
            heard={stats.topic for stats in self._topics.values() if stats.count},
        )

    def _type_of(self, topic: str, kind: str) -> str:
        """The type of a topic by the master; if it knows none, the type of the driver."""
        stats = self._topics.get(topic)
        if kind in ("", "*") and stats is not None:
            return serialization.type_name(stats.message_type)
        return kind

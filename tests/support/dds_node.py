"""A ROS 2 node on DDS, by cyclonedds, for tests and benchmarks: no ROS is needed for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.support import ros2_types as dds

SENSOR = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
RELIABLE = Qos(Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(10))
_KEPT = Qos(
    Policy.Reliability.Reliable(10**8), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
)
_SENSORS = (dds.LaserScan,)


class DdsNode:
    """Publishes and subscribes to topics, full names such as `/scan`, each with its type.

    It announces itself on `ros_discovery_info`, as each node does; a bridge requires that.
    """

    def __init__(
        self,
        domain: int,
        name: str,
        published: Mapping[str, type] | None = None,
        subscribed: Mapping[str, type] | None = None,
    ) -> None:
        """The node exists from now on, with the settings of a `Domain` made before."""
        self._participant = DomainParticipant(domain)
        self._writers = {
            topic: DataWriter(self._participant, self._topic(topic, kind))
            for topic, kind in (published or {}).items()
        }
        self._subscribed = dict(subscribed or {})
        self._readers = {
            topic: DataReader(self._participant, self._topic(topic, kind))
            for topic, kind in self._subscribed.items()
        }
        kept = dds.ParticipantEntitiesInfo
        about = Topic(self._participant, "ros_discovery_info", kept, _KEPT)
        self._about = DataWriter(self._participant, about)
        self._about.write(self._info(name))

    def publish(self, topic: str, message: object) -> None:
        self._writers[topic].write(message)

    def take(self, topic: str) -> Sequence[Any]:
        """The messages since the last call, oldest first."""
        taken = self._readers[topic].take(100)
        return [message for message in taken if self._is_whole(topic, message)]

    def wait(self, topic: str, seconds: float) -> Any:
        """The next message; None if none arrives within this time."""
        found = self._readers[topic].take_iter(timeout=duration(seconds=seconds))
        return next((message for message in found if self._is_whole(topic, message)), None)

    def close(self) -> None:
        self._writers.clear()
        self._readers.clear()
        del self._about, self._participant

    def _is_whole(self, topic: str, message: object) -> bool:
        """Whether this is a message, and not the end of a writer."""
        return isinstance(message, self._subscribed[topic])

    def _topic(self, name: str, kind: type) -> Any:
        qos = SENSOR if kind in _SENSORS else RELIABLE
        return Topic(self._participant, f"rt{name}", kind, qos)

    def _info(self, name: str) -> object:
        node = dds.NodeEntitiesInfo(
            node_namespace="/",
            node_name=name,
            reader_gid_seq=[_gid(reader) for reader in self._readers.values()],
            writer_gid_seq=[_gid(writer) for writer in self._writers.values()],
        )
        return dds.ParticipantEntitiesInfo(_gid(self._participant), [node])


def _gid(entity: Any) -> dds.Gid:
    return dds.Gid(list(entity.guid.bytes))

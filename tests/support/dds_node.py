"""A ROS 2 node on DDS, by cyclonedds, for tests and benchmarks: no ROS is needed for it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
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
_CLIENT = 0x0102030405060708
_SENSORS = (dds.LaserScan,)


class DdsNode:
    """Publishes and subscribes to topics, full names such as `/scan`, each with its type.

    It announces itself on `ros_discovery_info`, as each node does; a bridge requires that. With an
    empty name it does not, as a program that knows nothing of ROS. `qos`:
    of topics that have not the usual one. `actions`: full names such as `/dock` of actions that it
    serves; `goals` publishes the states of an action's goals. `clients`: full names of services of
    type std_srvs/Trigger that it calls.
    """

    def __init__(
        self,
        domain: int,
        name: str,
        published: Mapping[str, type] | None = None,
        subscribed: Mapping[str, type] | None = None,
        *,
        qos: Mapping[str, Qos] | None = None,
        actions: Sequence[str] = (),
        clients: Sequence[str] = (),
        namespace: str = "/",
        latched: Collection[str] = (),
    ) -> None:
        """The node exists from now on, with the settings of a `Domain` made before.

        `namespace`, such as `/tb3_01`, is that of its name; topics are given with theirs.
        `latched`: topics with durability TRANSIENT_LOCAL.
        """
        self._latched = latched
        enclave = Qos(Policy.Userdata(b"enclave=/;")) if name else None  # as each ROS process
        self._participant = DomainParticipant(domain, enclave)
        self._qos = {**(qos or {}), **{f"{name}/_action/status": _KEPT for name in actions}}
        self._served = [self._end(*end) for name in actions for end in action_ends(name)]
        statuses = {f"{name}/_action/status": dds.GoalStatusArray for name in actions}
        published = {**(published or {}), **statuses}
        self._writers = {
            topic: DataWriter(self._participant, self._topic(topic, kind))
            for topic, kind in published.items()
        }
        self._subscribed = dict(subscribed or {})
        self._readers = {
            topic: DataReader(self._participant, self._topic(topic, kind))
            for topic, kind in self._subscribed.items()
        }
        self._clients = {service: self._client(service) for service in clients}
        self._served += [entity for ends in self._clients.values() for entity in ends]
        self._about: DataWriter[Any] | None = None
        if name:
            kept = dds.ParticipantEntitiesInfo
            about = Topic(self._participant, "ros_discovery_info", kept, _KEPT)
            self._about = DataWriter(self._participant, about)
            self._about.write(self._info(name, namespace))

    def publish(self, topic: str, message: object) -> None:
        self._writers[topic].write(message)

    def is_heard(self, topic: str) -> bool:
        """Whether anyone takes what it publishes on a topic."""
        return bool(self._writers[topic].get_matched_subscriptions())

    def goals(self, action: str, *states: int) -> None:
        """Publish the states of all goals that an action has."""
        listed = [dds.GoalStatus(status=state) for state in states]
        self.publish(f"{action}/_action/status", dds.GoalStatusArray(listed))

    def take(self, topic: str) -> Sequence[Any]:
        """The messages since the last call, oldest first."""
        taken = self._readers[topic].take(100)
        return [message for message in taken if self._is_whole(topic, message)]

    def wait(self, topic: str, seconds: float) -> Any:
        """The next message; None if none arrives within this time."""
        found = self._readers[topic].take_iter(timeout=duration(seconds=seconds))
        return next((message for message in found if self._is_whole(topic, message)), None)

    def call(self, service: str, number: int) -> None:
        """Call a service."""
        self._clients[service][0].write(dds.TriggerCall(_CLIENT, number))

    def answers(self, service: str) -> dict[int, Any]:
        """The answers since the last call of this method, by the number of the call."""
        taken = self._clients[service][1].take(100)
        return {one.number: one for one in taken if isinstance(one, dds.TriggerAnswer)}

    def close(self) -> None:
        self._clients.clear()
        self._writers.clear()
        self._readers.clear()
        self._served.clear()
        del self._about, self._participant

    def _is_whole(self, topic: str, message: object) -> bool:
        """Whether this is a message, and not the end of a writer."""
        return isinstance(message, self._subscribed[topic])

    def _topic(self, name: str, kind: type) -> Any:
        usual = SENSOR if kind in _SENSORS else RELIABLE
        qos = _KEPT if name in self._latched else self._qos.get(name, usual)
        return Topic(self._participant, f"rt{name}", kind, qos)

    def _client(self, service: str) -> tuple[Any, Any]:
        request = Topic(self._participant, f"rq{service}Request", dds.TriggerCall, RELIABLE)
        reply = Topic(self._participant, f"rr{service}Reply", dds.TriggerAnswer, RELIABLE)
        return DataWriter(self._participant, request), DataReader(self._participant, reply)

    def _end(self, topic: str, kind: type, is_writer: bool) -> Any:
        end = DataWriter if is_writer else DataReader
        return end(self._participant, Topic(self._participant, topic, kind, RELIABLE))

    def _info(self, name: str, namespace: str) -> object:
        entities = [*self._readers.values(), *self._writers.values(), *self._served]
        readers = [_guid(entity) for entity in entities if isinstance(entity, DataReader)]
        writers = [_guid(entity) for entity in entities if isinstance(entity, DataWriter)]
        return node_info(_guid(self._participant), name, namespace, readers, writers)


def action_ends(name: str) -> Iterator[tuple[str, type, bool]]:
    """What an action's server has beside the status: DDS topic, type, and True for a writer.

    No test uses these services and feedback, but a bridge wants all. `name`: such as `/dock`.
    """
    typed = "irobot_create_msgs::action::dds_::Dock"
    for part, kind in {
        "send_goal": f"{typed}_SendGoal",
        "cancel_goal": "action_msgs::srv::dds_::CancelGoal",
        "get_result": f"{typed}_GetResult",
    }.items():
        topic = f"{name}/_action/{part}"
        yield f"rq{topic}Request", dds.empty(f"{kind}_Request_"), False
        yield f"rr{topic}Reply", dds.empty(f"{kind}_Response_"), True
    yield f"rt{name}/_action/feedback", dds.empty(f"{typed}_FeedbackMessage_"), True


def node_info(
    participant: bytes,
    name: str,
    namespace: str,
    readers: Sequence[bytes],
    writers: Sequence[bytes],
) -> dds.ParticipantEntitiesInfo:
    """What a process with one node writes on `ros_discovery_info`; a GUID has 16 bytes."""
    ends = ([dds.Gid(list(guid)) for guid in guids] for guids in (readers, writers))
    node = dds.NodeEntitiesInfo(namespace, name, *ends)
    return dds.ParticipantEntitiesInfo(dds.Gid(list(participant)), [node])


def _guid(entity: Any) -> bytes:
    guid: bytes = entity.guid.bytes
    return guid

"""Reads the admin spaces of Zenoh bridges: ROS nodes, and DDS readers and writers of topics.

A bridge announces a topic once, whatever the number of nodes with that topic. Its admin space lists
the nodes, and all DDS readers and writers except its own. Every DDS reader of a topic of commands
gets the commands that the bridge writes: also a reader without a ROS node, and another bridge in
the domain.

DDS counts a killed process as alive for its lease, 10 s by default. At the end of the lease the
bridge (1.10, its issue 702) withdraws the announcements of every node of that name, for good: a
base that restarted meanwhile no longer receives commands, not even zero.
"""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeVar

import msgspec
import zenoh
from msgspec import Struct
from zenoh.handlers import Callback

from swarmd.core.threads import hand_over
from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.messages import ros_name

PERIOD = 2.0
"""Seconds between two whole queries: of nodes, and of all readers and writers."""
WATCH_PERIOD = 0.25
"""Seconds between two queries of the readers of the commands. A change leads to a whole query.

Only these readers show a second base that comes later: the bridge announces a topic once. The query
takes 0.4 ms on loopback, with an answer of 0.6 kB for each reader.
"""
SETTLING = 0.5
"""Seconds between the first queries: a bridge's list is complete once two in a row are equal."""

_RETRY = 0.1
_QUERY_TIMEOUT = 1.0
_MAX_ANSWERS = 4096
_MAX_PAYLOAD = 100_000
_ANY = "*"
MAX_FIRST = 3
"""Answers of a bridge after which the driver no longer waits for a complete list."""
MAX_AGE = 15.0
"""Seconds without a complete answer of a bridge after which its last answer no longer counts."""
NAMING_TIME = 0.5
"""Seconds for which a DDS reader of a ROS process may still get the name of its node.

A ROS process announces its nodes after their readers, and the bridge looks every 0.1 s. A DDS
process that is no ROS process has no nodes, and is not waited for: each ROS middleware names its
enclave in the user data of its DDS participant.
"""

_BRIDGE = "zenoh_bridge_ros2dds"
_NAMELESS = "/dds_reader"
_ENCLAVE = list(b"enclave=")
_BEST_EFFORT = "BEST_EFFORT"
_KEPT = "TRANSIENT_LOCAL"


class AdminSpaces:
    """Queries the admin space of each Zenoh bridge periodically; keeps the ROS nodes in `nodes`.

    A whole query asks for nodes, DDS readers and DDS writers. More frequent queries ask for the
    readers of the commands alone. Each bridge is queried by its own selectors, so that a silent
    bridge does not hide the answers of other bridges. `asked_at`: s on the loop's clock, the begin
    of the last whole query that all known bridges answered.
    """

    def __init__(
        self, root: str, sensed: Iterable[str], cmd_vel: str, on_answer: Callable[[], None]
    ) -> None:
        """Make no query yet.

        `root`: the root of a bridge's admin space, with `*` for the bridge's id; empty for a
        middleware without a bridge. `sensed`: the topics that the robot publishes. `cmd_vel`: the
        topic of its commands. `on_answer` is called after each answer that `nodes` has taken.
        """
        self._root = root
        self._on_answer = on_answer
        self._sensed = tuple(sensed)
        self._cmd_vel = cmd_vel
        self.asked_at = -math.inf
        # s on the loop's clock: begin of the last whole query, and of the last query of readers.
        self._queried_at = -math.inf
        self._watched_at = -math.inf
        self._query: object | None = None  # of the query that has not ended
        self._readers: Collection[str] = ()  # keys of DDS readers in the last whole answer
        self.nodes = NodeList()

    def is_awaited(self, announcing: Collection[str]) -> bool:
        """True while the first complete list may still come, or the node of a new reader."""
        return bool(self._root) and self.nodes.is_awaited(announcing)

    def is_known(self, announcing: Collection[str]) -> bool:
        """True unless an announcing session is a bridge whose list of nodes has not come."""
        return not self._root or set(announcing) <= set(self.nodes.namespaces)

    def renew(self) -> None:
        """Let the next call of `query` make a whole query, without waiting for the period."""
        self._queried_at = -math.inf

    def query(
        self, session: zenoh.Session, announcing: Collection[str], loop: asyncio.AbstractEventLoop
    ) -> None:
        """Make the query that is due, unless the last query has no end yet. Returns at once.

        A whole query lists the nodes of each bridge, and all DDS readers and writers. Between whole
        queries, a query of the readers of the commands is due each WATCH_PERIOD. `announcing`: the
        ids of the sessions that announce topics of this robot.
        """
        now = loop.time()
        bridges = self.nodes.namespaces
        if not self._root or self._query is not None:
            return
        if now - self._queried_at >= self._period(announcing):
            self._queried_at = now
            self._watched_at = now
            # Until a bridge is known, query all: a bridge may list nodes and announce no topic.
            zids = {*announcing, *bridges} or {_ANY}
            selectors = [(zid, selector) for zid in zids for selector in self._selectors(zid)]
            self._ask(session, selectors, loop, partial(self._take, announcing, loop, now))
        elif now - self._watched_at >= WATCH_PERIOD and bridges:
            self._watched_at = now
            selectors = [(zid, self._dds_selector(zid, "reader", self._cmd_vel)) for zid in bridges]
            self._ask(session, selectors, loop, self._compare)  # a change makes a whole query due

    def _period(self, announcing: Collection[str]) -> float:
        """Seconds from one whole query to the next; fewer while a list is awaited."""
        if self.nodes.is_naming:  # a DDS reader may still get the name of its node
            return WATCH_PERIOD
        if not self.nodes.is_awaited(announcing):
            return PERIOD
        have_all_answered = set(announcing) <= self.nodes.namespaces.keys()
        return SETTLING if have_all_answered else _RETRY  # the first list may not be complete

    def _selectors(self, zid: str) -> Iterator[str]:
        """The selectors of a whole query of the bridge `zid`; `*`: of all bridges."""
        root = self._root.replace(_ANY, zid, 1)
        yield from (f"{root}/config", f"{root}/node/**", f"{root}/dds/*")
        yield self._dds_selector(zid, "reader", self._cmd_vel)
        yield from {self._dds_selector(zid, "writer", topic) for topic in self._sensed}

    def _dds_selector(self, zid: str, kind: str, topic: str) -> str:
        """The selector of the DDS readers or writers (`kind`) of a topic at one bridge.

        Names of DDS topics lack the bridge's namespace. While the namespace is not known, the
        selector matches the topic behind any prefix.
        """
        prefix = f"{self.nodes.namespaces.get(zid, '?')}/"
        is_known = topic.startswith(prefix)
        name = topic.removeprefix(prefix) if is_known else f"**/{topic.rpartition('/')[2]}"
        return f"{self._root.replace(_ANY, zid, 1)}/dds/*/{kind}/*/rt/{name}"

    def _ask(
        self,
        session: zenoh.Session,
        selectors: Collection[tuple[str, str]],
        loop: asyncio.AbstractEventLoop,
        take: Callable[[Mapping[str, bytes], Collection[str]], None],
    ) -> None:
        """Send queries, and call `take` in the loop once all have ended.

        `selectors`: each with the id of its bridge. `take` gets the payload of each answer by its
        key, and the ids of the bridges that had an error or did not answer in time (Zenoh then
        gives an error in place of an answer). Answers beyond the limits of number and size are
        dropped. `on_reply` and `on_end` run in a thread of Zenoh.
        """
        query = object()
        answers = dict[str, bytes]()
        late_bridges = set[str]()
        running = [*selectors]  # a list as a counter: its `pop` is safe in several threads
        self._query = query

        def on_reply(zid: str, reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None:
                late_bridges.add(zid)
            elif len(answers) < _MAX_ANSWERS and len(sample.payload) <= _MAX_PAYLOAD:
                answers[str(sample.key_expr)] = sample.payload.to_bytes()

        def on_end() -> None:
            running.pop()
            if not running:
                hand_over(loop, finish)

        def finish() -> None:
            if query is self._query:  # otherwise the query is of an earlier start of the hub
                self._query = None
                take(answers, late_bridges)

        for zid, selector in selectors:
            receive = Callback(partial(on_reply, zid), on_end)
            session.get(selector, receive, timeout=_QUERY_TIMEOUT)

    def _take(
        self,
        announcing: Collection[str],
        loop: asyncio.AbstractEventLoop,
        begun: float,
        answers: Mapping[str, bytes],
        late: Collection[str],
    ) -> None:
        if not set(late) & self.nodes.namespaces.keys():  # else parts of `nodes` are older
            self.asked_at = begun
        self._readers = _readers(answers)
        self.nodes.take(None if _ANY in late else answers, announcing, loop.time(), late)
        self._on_answer()

    def _compare(self, answers: Mapping[str, bytes], late: Collection[str]) -> None:
        """Let a whole query follow if the readers of the commands have changed since the last."""
        if not late and _readers(answers) != self._readers:
            self.renew()


class _Topic(Struct, frozen=True):
    name: str
    type: str


class _Node(Struct, frozen=True):
    publishers: list[_Topic]
    subscribers: list[_Topic]


class _Config(Struct, frozen=True):
    namespace: str
    nodename: str


class _Policy(Struct, frozen=True):
    kind: str = ""


class _Quality(Struct, frozen=True):
    reliability: _Policy = _Policy()
    durability: _Policy = _Policy()
    properties: dict[str, str] = {}
    user_data: list[int] = []


class _InDds(Struct, frozen=True):
    """A DDS entity in a bridge's list: a reader or writer, or a participant (no names then)."""

    qos: _Quality
    topic_name: str = ""
    type_name: str = ""


_nodes: msgspec.json.Decoder[_Node] = msgspec.json.Decoder(_Node)
_configs: msgspec.json.Decoder[_Config] = msgspec.json.Decoder(_Config)
_in_dds: msgspec.json.Decoder[_InDds] = msgspec.json.Decoder(_InDds)
_S = TypeVar("_S", bound=Struct)


@dataclass(frozen=True, slots=True)
class _Answer:
    """The content of one bridge's admin space."""

    namespace: str  # such as `/tb3_01`; may be empty
    nodes: frozenset[Endpoint]
    dds: frozenset[Endpoint]  # DDS readers and writers
    strays: frozenset[Endpoint]  # DDS readers without a node, or of another bridge
    nodeless: frozenset[Endpoint]  # DDS ends of ROS processes without a node, not of bridges
    not_ros: frozenset[str]  # DDS participants that are no ROS processes


class NodeList:
    """The nodes, and DDS readers and writers, that all bridges list. Pure.

    `endpoints`: of all nodes that are no bridges; the `zid` of an endpoint is the bridge that lists
    the node. `dds`: the DDS readers and writers that were queried. `strays`: the DDS readers that
    belong to no listed node, or to a bridge other than the one that lists them; the `node` of a
    stray is the name of its process, or of its bridge. `nodeless`: the DDS readers and writers of
    ROS processes that belong to no listed node.
    """

    def __init__(self) -> None:
        """No answer yet."""
        self._answers: Mapping[str, bytes] = {}  # the last answers
        self._read: Mapping[str, _Answer] = {}  # the same, decoded
        self._by_bridge: Mapping[str, _Answer] = {}
        # Times in s: first heard, by process and node; first without a name, by process and topic;
        # last complete answer, by bridge.
        self._since: Mapping[tuple[str, str], float] = {}
        self._unnamed_since: Mapping[tuple[str, str], float] = {}
        self._heard_at: Mapping[str, float] = {}
        self._tries: Mapping[str, int] = {}  # whole queries, by announcing session
        self._settled: frozenset[str] = frozenset()  # bridges with two equal answers in a row
        self.endpoints: tuple[Endpoint, ...] = ()
        self.dds: tuple[Endpoint, ...] = ()
        self.strays: tuple[Endpoint, ...] = ()
        self.nodeless: tuple[Endpoint, ...] = ()

    @property
    def namespaces(self) -> Mapping[str, str]:
        """The namespace of each bridge that answered, by its id: empty or such as `/tb3_01`."""
        return {zid: answer.namespace for zid, answer in self._by_bridge.items()}

    def take(
        self,
        answers: Mapping[str, bytes] | None,
        announcing: Collection[str],
        now: float,
        late: Collection[str] = (),
    ) -> None:
        """Update the lists by the answers to a whole query.

        Args:
            answers: the payload of each answer by its key; None if no bridge answered in time. The
                keys are `@/<zid>/ros2/config`, `.../node/<participant>/<name>`,
                `.../dds/<participant>`, and `.../dds/<participant>/reader/<id>/rt/<topic>` or the
                same with `writer`.
            announcing: the ids of the sessions that announce topics.
            now: s, the time of the answers.
            late: the ids of bridges whose answers are not complete; their earlier answers count
                for MAX_AGE.
        """
        self._tries = {zid: self._tries.get(zid, 0) + 1 for zid in announcing}
        before = self._by_bridge
        if answers is None:
            answers = {}
            late = {*before}
        complete = {zid: answer for zid, answer in self._decode(answers).items() if zid not in late}
        earlier = {
            zid: answer
            for zid, answer in before.items()
            if zid in late and now - self._heard_at[zid] <= MAX_AGE
        }
        by_bridge = earlier | complete
        heard_before = {zid: self._heard_at[zid] for zid in earlier}
        self._heard_at = heard_before | dict.fromkeys(complete, now)
        if by_bridge != before:  # comparing 2000 endpoints takes 40 ms, with decoding them
            self._replace(by_bridge, now)
        self._update_strays(now)
        # A bridge's list is settled, thus complete, once two answers in a row were equal. The list
        # stays settled while the bridge answers.
        unchanged = {zid for zid, answer in complete.items() if before.get(zid) == answer}
        self._settled = frozenset(unchanged | (self._settled & self._by_bridge.keys()))

    def _decode(self, answers: Mapping[str, bytes]) -> Mapping[str, _Answer]:
        """The decoded answers by bridge; answers equal to the last ones are not decoded again."""
        if answers and answers != self._answers:
            self._answers = dict(answers)
            self._read = dict(_by_bridge(answers))
        return self._read if answers else {}

    def _update_strays(self, now: float) -> None:
        """Set `strays`: the readers for which no node will be announced any more.

        These are the readers of a process that is no ROS process, which has no nodes. In a ROS
        process the node may be announced up to NAMING_TIME after its readers; a reader that has no
        node then is a stray, too.
        """
        by_bridge = self._by_bridge.values()
        unnamed = {(end.process, end.topic): end for answer in by_bridge for end in answer.strays}
        self._unnamed_since = {key: self._unnamed_since.get(key, now) for key in unnamed}
        not_ros = {process for answer in by_bridge for process in answer.not_ros}
        self.strays = tuple(
            end
            for key, end in unnamed.items()
            if end.process in not_ros or now - self._unnamed_since[key] >= NAMING_TIME
        )

    @property
    def is_naming(self) -> bool:
        """True while a DDS reader may still get the name of its node."""
        return len(self.strays) < len(self._unnamed_since)

    def is_awaited(self, announcing: Collection[str]) -> bool:
        """True while the complete list of an announcing session, or a node's name, may come."""
        unsettled = set(announcing) - self._settled
        return self.is_naming or any(self._tries.get(zid, 0) < MAX_FIRST for zid in unsettled)

    def _replace(self, by_bridge: Mapping[str, _Answer], now: float) -> None:
        self._by_bridge = by_bridge
        answers = by_bridge.values()
        ends = [end for answer in answers for end in answer.nodes]
        self._since = {end.source: self._since.get(end.source, now) for end in ends}
        self.endpoints = tuple(replace(end, since=self._since[end.source]) for end in ends)
        self.dds = tuple(end for answer in answers for end in answer.dds)
        self.nodeless = tuple(end for answer in answers for end in answer.nodeless)


def route_faults(ends: Iterable[Endpoint], graph: Graph) -> dict[str, str]:
    """By topic, why messages of these DDS readers and writers do not pass the bridge.

    The bridge (1.10) makes one route for a topic, with the quality of service of the first node
    that it finds, and keeps the route while any node has the topic. A later node that requests a
    higher quality, or offers a lower one, is not connected; DDS and the bridge report no error.
    """
    faults: dict[str, str] = {}
    for end in ends:
        routes = graph.qualities(end.topic, is_publisher=end.is_publisher)
        difference = _differs(end, routes[0]) if len(routes) == 1 else ""
        if difference and end.topic not in faults:
            does = "publishes" if end.is_publisher else "takes"
            hub = graph.middleware.hub
            faults[end.topic] = (
                f"a node {does} {end.topic} {difference}, but {hub} has a {routes[0]} route, as the"
                f" first node of that topic was: nothing passes; start {hub} again when the other"
                " node has ended"
            )
    return faults


def _readers(answers: Iterable[str]) -> Collection[str]:
    return {key for key in answers if "/reader/" in key}


def _by_bridge(answers: Mapping[str, bytes]) -> Iterator[tuple[str, _Answer]]:
    """The decoded answer of each bridge, by the bridge's id; `answers`: payload by key.

    A bridge without the answer `config` is left out.
    """
    configs = dict[str, _Config]()
    # By bridge: the payloads of nodes, and of DDS entities, by the <rest> of their keys, which are
    # `@/<zid>/ros2/<kind>/<rest>`.
    nodes, in_dds = (defaultdict[str, dict[str, bytes]](dict) for _ in range(2))
    for key, payload in answers.items():
        parts = key.split("/", 4)
        if len(parts) < 4 or (parts[0], parts[2]) != ("@", "ros2"):
            continue
        zid = parts[1]
        kind = parts[3]
        rest = parts[4] if len(parts) > 4 else ""
        if kind == "config" and not rest and (config := _decoded(_configs, payload)):
            configs[zid] = config
        elif kind == "node" and rest:
            nodes[zid][rest] = payload
        elif kind == "dds" and rest:
            in_dds[zid][rest] = payload
    bridge_names = {_BRIDGE, *(config.nodename for config in configs.values())}
    for zid, config in configs.items():
        prefix = config.namespace.rstrip("/")
        ends = [
            end
            for name, payload in nodes[zid].items()
            for end in _of_node(zid, prefix, name, payload)
        ]
        yield zid, _answer(prefix, ends, bridge_names, _ends_in_dds(zid, prefix, in_dds[zid]))


def _answer(
    prefix: str, ends: Collection[Endpoint], bridge_names: Collection[str], in_dds: _DdsEnds
) -> _Answer:
    """Join what was decoded from one bridge's admin space; marks its ends without a node.

    `prefix`: the namespace of the bridge. `ends`: the endpoints of the nodes that it lists, bridges
    included. `in_dds`: the DDS entities that it lists. `bridge_names`: the names by which nodes of
    bridges are known. The strays of the result are the DDS readers in `in_dds` that belong to no
    listed node, or to another bridge. `nodeless` are its DDS ends of ROS processes without a node.
    """
    of_nodes = [end for end in ends if end.node.rpartition("/")[2] not in bridge_names]
    # By process: the name of the bridge in it, else the name of the process itself.
    bridges = {end.process: end.node for end in ends if end not in of_nodes}
    owners = {**in_dds.processes, **bridges}
    node_ends = {(end.process, end.topic, end.is_publisher) for end in of_nodes}
    unlisted = [
        replace(end, node=owners.get(end.process, _NAMELESS))
        for end in in_dds.ends
        if (end.process, end.topic, end.is_publisher) not in node_ends
    ]
    strays = frozenset(end for end in unlisted if not end.is_publisher)
    nodeless = frozenset(
        end for end in unlisted if end.process not in in_dds.not_ros | bridges.keys()
    )
    return _Answer(prefix, frozenset(of_nodes), in_dds.ends, strays, nodeless, in_dds.not_ros)


def _of_node(zid: str, prefix: str, name: str, payload: bytes) -> Iterator[Endpoint]:
    """The ends of one node; `name` is `<participant>/<name>`, `prefix` the bridge's namespace."""
    participant, _, node_name = name.partition("/")
    if (node := _decoded(_nodes, payload)) is None or not node_name.isprintable():
        return
    for is_publisher, topics in ((True, node.publishers), (False, node.subscribers)):
        for topic in topics:
            full = f"{prefix}{topic.name}"
            if full.isprintable():
                yield Endpoint(
                    is_publisher, full, topic.type, zid, node=f"/{node_name}", process=participant
                )


class _DdsEnds(NamedTuple):
    """The DDS entities that a bridge lists."""

    ends: frozenset[Endpoint]  # readers and writers
    processes: Mapping[str, str]  # the name of each participant
    not_ros: frozenset[str]  # participants that are no ROS processes


def _ends_in_dds(zid: str, prefix: str, answers: Mapping[str, bytes]) -> _DdsEnds:
    """The DDS entities that a bridge lists.

    `answers`: the payloads by the end of their keys, which is `<participant>` or
    `<participant>/reader/...`. CycloneDDS states the name of a process. The participants of other
    implementations are called _NAMELESS.
    """
    ends = list[Endpoint]()
    processes = dict[str, str]()
    not_ros = set[str]()
    for key, payload in answers.items():
        participant, _, rest = key.partition("/")  # without `rest`: the participant itself
        if (read := _decoded(_in_dds, payload)) is None:
            continue
        if not rest and read.qos.user_data[: len(_ENCLAVE)] != _ENCLAVE:
            not_ros.add(participant)
        if not rest and (process := read.qos.properties.get("__ProcessName", "")).isprintable():
            processes[participant] = f"{_NAMELESS}_{process}" if process else _NAMELESS
        topic = read.topic_name.removeprefix("rt/")
        type_name = ros_name(read.type_name)
        if rest and f"{topic}{type_name}".isprintable():
            quality = "best effort" if read.qos.reliability.kind == _BEST_EFFORT else "reliable"
            quality += ", transient local" if read.qos.durability.kind == _KEPT else ""
            end = Endpoint(rest.startswith("writer/"), f"{prefix}/{topic}", type_name, zid)
            ends.append(replace(end, quality=quality, process=participant))
    return _DdsEnds(frozenset(ends), processes, frozenset(not_ros))


def _decoded(decoder: msgspec.json.Decoder[_S], payload: bytes) -> _S | None:
    try:
        return decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def _differs(end: Endpoint, route: str) -> str:
    """The quality that a writer lacks, or a reader requests in vain; empty if messages pass."""
    is_kept = "transient" in end.quality
    if not end.is_publisher:
        return "transient local" if is_kept and "transient" not in route else ""
    if route.startswith("reliable") and not end.quality.startswith("reliable"):
        return "best effort"
    return "volatile" if "transient" in route and not is_kept else ""

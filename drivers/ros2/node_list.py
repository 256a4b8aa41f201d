"""The nodes that each zenoh-bridge-ros2dds lists, with the topics that they publish and take.

A bridge announces a topic once, however many nodes have it; its admin space names the nodes.

DDS counts a killed process as alive for the time of its lease, 10 s by default. At the lease's end
the bridge (1.10, its issue 702) withdraws the announcements of every node of that name, for good: a
base that restarted meanwhile no longer receives commands, not even zero.
"""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial

import msgspec
import zenoh
from msgspec import Struct
from zenoh.handlers import Callback

from swarmd.core.threads import hand_over
from swarmd.drivers.ros.endpoints import Endpoint

PERIOD = 2.0
"""Seconds between two queries."""
SETTLING = 0.5
"""Seconds between the first queries: a bridge's list is whole once two in a row are alike."""
MAX_FIRST = 3
"""Answers after which the driver waits no longer for a bridge's list to be whole."""
MAX_AGE = 15.0
"""Seconds without a whole answer of a bridge after which its last one no longer counts."""

_RETRY = 0.1
_QUERY_TIMEOUT = 1.0
_MAX_ANSWERS = 4096
_MAX_PAYLOAD = 100_000
_BRIDGE = "zenoh_bridge_ros2dds"
_ANY = "*"


class _Topic(Struct, frozen=True):
    name: str
    type: str


class _Node(Struct, frozen=True):
    publishers: list[_Topic]
    subscribers: list[_Topic]


class _Config(Struct, frozen=True):
    namespace: str
    nodename: str


_nodes: msgspec.json.Decoder[_Node] = msgspec.json.Decoder(_Node)
_configs: msgspec.json.Decoder[_Config] = msgspec.json.Decoder(_Config)


class NodeList:
    """What the bridges list, by the answers that `take` gets. Pure.

    `endpoints`: of all nodes but the bridges themselves; `zid` is the bridge that lists the node.
    `bridges`: the ids of the bridges that answered.
    """

    def __init__(self) -> None:
        """No answer yet."""
        self._answers: Mapping[str, bytes] = {}  # the last ones, and what was read in them
        self._read: Mapping[str, frozenset[Endpoint]] = {}
        self._by_bridge: Mapping[str, frozenset[Endpoint]] = {}
        self._since: Mapping[tuple[str, str], float] = {}
        self._heard_at: Mapping[str, float] = {}
        self._tries: Mapping[str, int] = {}
        self._settled: frozenset[str] = frozenset()
        self.endpoints: tuple[Endpoint, ...] = ()

    @property
    def bridges(self) -> Collection[str]:
        """The ids of the bridges whose nodes are known."""
        return self._by_bridge.keys()

    def take(
        self,
        answers: Mapping[str, bytes] | None,
        announcing: Collection[str],
        now: float,
        late: Collection[str] = (),
    ) -> None:
        """All answers to one query, payload by key; None if all timed out.

        Keys are `@/<zid>/ros2/config` and `@/<zid>/ros2/node/<participant>/<name>`. `announcing`:
        the sessions that announce topics. `late`: those whose answers are not whole.
        """
        self._tries = {zid: self._tries.get(zid, 0) + 1 for zid in announcing}
        before = self._by_bridge
        late = {*before} if answers is None else late
        if answers is not None and answers != self._answers:
            self._answers, self._read = dict(answers), dict(_by_bridge(answers))
        read = {} if answers is None else self._read
        whole = {zid: ends for zid, ends in read.items() if zid not in late}
        alike = {zid for zid, ends in whole.items() if before.get(zid) == ends}
        kept = {
            zid: ends
            for zid, ends in before.items()
            if zid in late and now - self._heard_at[zid] <= MAX_AGE
        }
        self._heard_at = {zid: self._heard_at[zid] for zid in kept} | dict.fromkeys(whole, now)
        if kept | whole != before:  # to read and compare 2000 endpoints takes 40 ms
            self._replace(kept | whole, now)
        self._settled = frozenset(alike | (self._settled & self._by_bridge.keys()))

    def is_awaited(self, announcing: Collection[str]) -> bool:
        """True if a session announces topics, and its whole list of nodes may still come."""
        unsettled = set(announcing) - self._settled
        return any(self._tries.get(zid, 0) < MAX_FIRST for zid in unsettled)

    def _replace(self, by_bridge: Mapping[str, frozenset[Endpoint]], now: float) -> None:
        ends = [end for one in by_bridge.values() for end in one]
        self._since = {end.source: self._since.get(end.source, now) for end in ends}
        self._by_bridge = by_bridge
        self.endpoints = tuple(replace(end, since=self._since[end.source]) for end in ends)


class NodeListQuery:
    """Queries the bridges for their nodes, again and again, and hands the answers to the list.

    Each is queried by itself, so that a silent bridge hides no nodes of the others.
    `selectors`: of the answers; empty where there is no bridge. `on_answer` is called after each.
    `asked_at`: when the query of the last whole answer began, in s on the loop's clock.
    """

    def __init__(self, selectors: Collection[str], on_answer: Callable[[], None]) -> None:
        """Nothing queried yet."""
        self._selectors, self._on_answer = selectors, on_answer
        self.asked_at = -math.inf
        self._begun = -math.inf
        self._query: object | None = None
        self.nodes = NodeList()

    def is_awaited(self, announcing: Collection[str]) -> bool:
        """True while the first whole list may still come."""
        return bool(self._selectors) and self.nodes.is_awaited(announcing)

    def is_known(self, announcing: Collection[str]) -> bool:
        """True if each session that announces topics lists its nodes, or is itself one."""
        return not self._selectors or set(announcing) <= set(self.nodes.bridges)

    def renew(self) -> None:
        """Let the next call of `query` query, however short the last one is ago."""
        self._begun = -math.inf

    def query(
        self,
        session: zenoh.Session,
        announcing: Collection[str],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        """Query again each PERIOD, sooner while the first whole list is awaited."""
        waits = self.nodes.is_awaited(announcing)
        is_known = waits and set(announcing) <= set(self.nodes.bridges)
        period = (SETTLING if is_known else _RETRY) if waits else PERIOD
        if not self._selectors or loop.time() - self._begun < period or self._query is not None:
            return
        self._begun, self._query = loop.time(), object()
        query, answers, late = self._query, dict[str, bytes](), set[str]()
        # Until a bridge is known, any may answer: one may list nodes and announce nothing.
        asked = {*announcing, *self.nodes.bridges} or {_ANY}
        left = [(zid, selector) for zid in asked for selector in self._selectors]

        def on_reply(zid: str, reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None:
                late.add(zid)
            elif len(answers) < _MAX_ANSWERS and len(sample.payload) <= _MAX_PAYLOAD:
                answers[str(sample.key_expr)] = sample.payload.to_bytes()

        def on_end() -> None:
            left.pop()
            if not left:
                hand_over(loop, self._on_end, query, answers, announcing, late, loop)

        for zid, selector in tuple(left):
            receive = Callback(partial(on_reply, zid), on_end)
            session.get(selector.replace(_ANY, zid, 1), receive, timeout=_QUERY_TIMEOUT)

    def _on_end(
        self,
        query: object,
        answers: Mapping[str, bytes],
        announcing: Collection[str],
        late: Collection[str],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        if query is not self._query:
            return  # of an earlier start of the hub
        self._query = None
        if not set(late) & set(self.nodes.bridges):  # else some of what is known is older
            self.asked_at = self._begun
        self.nodes.take(None if _ANY in late else answers, announcing, loop.time(), late)
        self._on_answer()


def _by_bridge(answers: Mapping[str, bytes]) -> Iterator[tuple[str, frozenset[Endpoint]]]:
    """The endpoints that each bridge lists; of a bridge that does not tell its namespace, none."""
    configs, payloads = dict[str, _Config](), defaultdict[str, dict[str, bytes]](dict)
    for key, payload in answers.items():
        parts = key.split("/", 4)
        if len(parts) < 4 or (parts[0], parts[2]) != ("@", "ros2"):
            continue
        if parts[3:] == ["config"]:
            try:
                configs[parts[1]] = _configs.decode(payload)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                continue
        elif parts[3] == "node" and len(parts) == 5:
            payloads[parts[1]][parts[4]] = payload
    ignored = {_BRIDGE, *(config.nodename for config in configs.values())}
    for zid, config in configs.items():
        listed = (_endpoints(zid, config.namespace, *node) for node in payloads[zid].items())
        yield (
            zid,
            frozenset(
                end for ends in listed for end in ends if end.node.rpartition("/")[2] not in ignored
            ),
        )


def _endpoints(zid: str, namespace: str, name: str, payload: bytes) -> Iterator[Endpoint]:
    """Those of one node; `name` is `<participant>/<name>`. The bridge's namespace precedes each."""
    try:
        node = _nodes.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return
    participant, _, node_name = name.partition("/")
    prefix = "" if namespace == "/" else namespace
    for is_publisher, topics in ((True, node.publishers), (False, node.subscribers)):
        for topic in topics:
            full = f"{prefix}{topic.name}"
            if full.isprintable() and node_name.isprintable():
                yield Endpoint(
                    is_publisher, full, topic.type, zid, node=f"/{node_name}", process=participant
                )

"""Queries of the admin spaces of bridges: nodes, and the ends of the robot's topics in DDS."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial

import zenoh
from zenoh.handlers import Callback

from swarmd.core.threads import hand_over
from swarmd.drivers.ros2.node_list import NodeList

PERIOD = 2.0
"""Seconds between two queries of everything."""
WATCH_PERIOD = 0.25
"""Seconds between two queries of the readers of the commands: other readers lead to a whole query.

A base that comes later shows itself there alone: a bridge announces a topic once. The query takes
0.4 ms on loopback, with one answer of 0.6 kB for each reader.
"""
SETTLING = 0.5
"""Seconds between the first queries: a bridge's list is whole once two in a row are alike."""

_RETRY = 0.1
_QUERY_TIMEOUT = 1.0
_MAX_ANSWERS = 4096
_MAX_PAYLOAD = 100_000
_ANY = "*"


class AdminSpaces:
    """Queries the bridges again and again, and hands the answers to `nodes`.

    Each is queried by itself, so that a silent bridge hides no nodes of the others. `asked_at`:
    when the query of the last whole answer began, in s on the loop's clock.
    """

    def __init__(
        self, root: str, sensed: Iterable[str], cmd_vel: str, on_answer: Callable[[], None]
    ) -> None:
        """Nothing queried yet.

        `root`: of a bridge's admin space, `*` for the bridge; empty where there is no bridge.
        `sensed` are the topics that the robot publishes, `cmd_vel` is that of its commands.
        `on_answer` is called after each answer that `nodes` got.
        """
        self._root, self._on_answer = root, on_answer
        self._sensed, self._cmd_vel = tuple(sensed), cmd_vel
        self.asked_at = -math.inf
        self._begun = self._watched = -math.inf
        self._query: object | None = None
        self._readers: Collection[str] = ()
        self.nodes = NodeList()

    def is_awaited(self, announcing: Collection[str]) -> bool:
        """True while the first whole list may still come, or the node of a new reader."""
        return bool(self._root) and self.nodes.is_awaited(announcing)

    def is_known(self, announcing: Collection[str]) -> bool:
        """True if each session that announces topics lists its nodes, or is itself one."""
        return not self._root or set(announcing) <= set(self.nodes.namespaces)

    def renew(self) -> None:
        """Let the next call of `query` query everything, however short the last one is ago."""
        self._begun = -math.inf

    def query(
        self, session: zenoh.Session, announcing: Collection[str], loop: asyncio.AbstractEventLoop
    ) -> None:
        """Query everything each PERIOD, sooner while `is_awaited`; else the readers of commands."""
        now, bridges = loop.time(), self.nodes.namespaces
        if self.nodes.is_naming:
            period = WATCH_PERIOD
        elif self.nodes.is_awaited(announcing):
            period = SETTLING if set(announcing) <= bridges.keys() else _RETRY
        else:
            period = PERIOD
        if not self._root or self._query is not None:
            return
        if now - self._begun >= period:
            self._begun = self._watched = now
            # Until a bridge is known, any may answer: one may list nodes and announce nothing.
            zids = {*announcing, *bridges} or {_ANY}
            asked = [(zid, selector) for zid in zids for selector in self._everything(zid)]
            self._ask(session, asked, loop, partial(self._take, announcing, loop, now))
        elif now - self._watched >= WATCH_PERIOD and bridges:
            self._watched = now
            asked = [(zid, self._ends(zid, "reader", self._cmd_vel)) for zid in bridges]
            self._ask(session, asked, loop, self._compare)

    def _everything(self, zid: str) -> Iterator[str]:
        root = self._root.replace(_ANY, zid, 1)
        yield from (f"{root}/config", f"{root}/node/**", f"{root}/dds/*")
        yield self._ends(zid, "reader", self._cmd_vel)
        yield from {self._ends(zid, "writer", topic) for topic in self._sensed}

    def _ends(self, zid: str, kind: str, topic: str) -> str:
        """The selector of a topic's ends in DDS, of which a bridge's namespace is no part."""
        prefix = f"{self.nodes.namespaces.get(zid, '?')}/"
        is_known = topic.startswith(prefix)
        name = topic.removeprefix(prefix) if is_known else f"**/{topic.rpartition('/')[2]}"
        return f"{self._root.replace(_ANY, zid, 1)}/dds/*/{kind}/*/rt/{name}"

    def _ask(
        self,
        session: zenoh.Session,
        asked: Collection[tuple[str, str]],
        loop: asyncio.AbstractEventLoop,
        take: Callable[[Mapping[str, bytes], Collection[str]], None],
    ) -> None:
        """Query each bridge's selectors; `take` gets all answers, and which bridges were late."""
        query, answers, late, left = object(), dict[str, bytes](), set[str](), [*asked]
        self._query = query

        def on_reply(zid: str, reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None:
                late.add(zid)
            elif len(answers) < _MAX_ANSWERS and len(sample.payload) <= _MAX_PAYLOAD:
                answers[str(sample.key_expr)] = sample.payload.to_bytes()

        def on_end() -> None:
            left.pop()
            if not left:
                hand_over(loop, end)

        def end() -> None:
            if query is self._query:  # else of an earlier start of the hub
                self._query = None
                take(answers, late)

        for zid, selector in asked:
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
        if not set(late) & self.nodes.namespaces.keys():  # else some of what is known is older
            self.asked_at = begun
        self._readers = _readers(answers)
        self.nodes.take(None if _ANY in late else answers, announcing, loop.time(), late)
        self._on_answer()

    def _compare(self, answers: Mapping[str, bytes], late: Collection[str]) -> None:
        """Query everything if the commands have other readers than at the last whole query."""
        if not late and _readers(answers) != self._readers:
            self.renew()


def _readers(answers: Iterable[str]) -> Collection[str]:
    return {key for key in answers if "/reader/" in key}

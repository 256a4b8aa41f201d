"""The Zenoh side of a daemon: answers queries of operators, and publishes the robot's state.

Order of use in a daemon::

    bus = ZenohBus(session, swarm="lab", robot="tb3-01")
    bus.serve("control", "run", on_run)  # on_run(query): query.payload, query.reply(bytes)
    bus.publish("status", lambda: encode(status))
    bus.close(); session.close()

Zenoh's threads call the callbacks. Each callback checks key, kind and size, and puts the bytes into
an inbound queue (`inbound_queue.py`). No callback raises into Zenoh. The handlers run on the loop.
An error of a handler is counted, for example as `control/run:malformed`, and the query gets no
answer (`DropCounter.refusing`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Protocol

import zenoh
from zenoh.handlers import Callback

from swarmd.core.codec import MAX_CONTROL, Decoder, as_json, encode
from swarmd.core.key_table import PUBLISHED, is_queried
from swarmd.core.keys import ANY, CONTROL, SHARED, STATE, Key, build, parse
from swarmd.core.messages import Member, PeerView, Status
from swarmd.core.verbs import MembersQuery
from swarmd.link.carriers.inbound_queue import DropCounter, InboundQueue
from swarmd.link.carriers.programs import Programs
from swarmd.link.carriers.session import has_subscriber, undeclare


class Query(Protocol):
    """A question or request put to this robot, on its own key."""

    payload: bytes
    asker: str
    """The last chunk of the key; in a secured swarm the name that the link has proved."""

    @property
    def source(self) -> str:
        """The address from which the query came."""

    def reply(self, payload: bytes) -> None:
        """Answer at most once, now or later, on the loop; never blocks or raises."""

    def drop(self) -> None:
        """Do not answer; the asker learns that no answer comes. Harmless after `reply`."""


_members_query = Decoder(MembersQuery)


class ZenohQuery:
    """A `Query` of Zenoh that came on a session, answered on this robot's own key."""

    __slots__ = ("_info", "_key", "_query", "_session", "asker", "payload")

    def __init__(
        self, session: zenoh.Session, query: zenoh.Query, key: str, asker: str, payload: bytes
    ) -> None:
        self.asker = asker
        self._session = session
        self._query: zenoh.Query | None = query
        self._info = query.source_info
        self._key = key
        self.payload = payload

    @property
    def source(self) -> str:
        """The address of the link to the session that the query names; no signature proves it.

        Without such a link the session itself, as `zid`: its queries come through another session,
        such as a router, or it has ended.
        """
        asker = None if self._info is None else self._info.source_id.zid
        with suppress(zenoh.ZError):
            for link in self._session.info.links():
                is_proved = link.auth_identifier is None or link.auth_identifier == self.asker
                if link.zid == asker and is_proved:
                    address = str(link.dst).partition("/")[2].partition("?")[0].partition("#")[0]
                    return without_mapping(address)
        return "an unnamed Zenoh session" if asker is None else f"Zenoh session {asker}, no link"

    def reply(self, payload: bytes) -> None:
        """Send `payload` (MessagePack) as the answer; a second call has no effect.

        If the selector of the query has `_format=json`, the answer is JSON: the REST server of
        `zenohd` would show MessagePack as base64.
        """
        query = self._query
        self._query = None
        if query is None:
            return
        encoding = None
        if query.parameters.get("_format") == "json":
            payload = as_json(payload)
            encoding = zenoh.Encoding.APPLICATION_JSON
        try:
            # Without a timestamp the asker gets the status of a storage in place of this answer.
            now = self._session.new_timestamp()
            query.reply(self._key, payload, encoding=encoding, timestamp=now)
            query.drop()
        except zenoh.ZError:  # the asker or the session is gone
            return

    def drop(self) -> None:
        """Do not answer."""
        query = self._query
        self._query = None
        if query is not None:
            query.drop()


def without_mapping(address: str) -> str:
    """The address and port; an IPv4-mapped address, `[::ffff:10.0.0.7]:7440`, as IPv4."""
    start = "[::ffff:"
    end = "]:"
    if not address.startswith(start) or "." not in address:
        return address
    return address.removeprefix(start).replace(end, ":", 1)


class ZenohBus:
    """The queries and publications of one robot; handlers run on the loop of the constructor.

    A query with wildcards for its name, or with the key of another robot, is dropped and counted.
    """

    programs: Programs | None = None
    """From `meet_programs` on."""

    def __init__(
        self, session: zenoh.Session, *, swarm: str, robot: str, drops: DropCounter
    ) -> None:
        """Declare a publisher for each `state/<name>` of `robot`, on the open Zenoh session.

        Call it on the running loop, on which all handlers will run. `drops` counts the queries and
        messages that are dropped, by kind and reason.
        """
        self.swarm = swarm
        self.robot = robot
        self.drops = drops
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._queryables: list[zenoh.Queryable[None]] = []
        self._queues: list[InboundQueue] = []
        self._is_closed = False
        # DROP: a full link loses a value and does not block the loop. express: no batching.
        self._publishers = {
            name: session.declare_publisher(
                build(swarm, robot, STATE, name),
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,
            )
            for name in PUBLISHED
        }
        # By name: whether the publisher has subscribers, as Zenoh last said. Asking takes 50 us.
        self._has_subscriber = dict.fromkeys(self._publishers, False)
        self._unsure_names = set(self._publishers)  # names for which Zenoh must be asked again
        for name, publisher in self._publishers.items():
            # indirect=False: on Zenoh's own thread, without a further thread for each callback.
            on_change = Callback(partial(self._on_viewers, name), indirect=False)
            publisher.declare_matching_listener(on_change)

    def meet_programs(self, is_robot: Callable[[str], bool], *, takes_messages: bool) -> None:
        """Declare the liveliness token of this robot, and receive from Zenoh programs."""
        self.programs = Programs(
            self._session,
            self.swarm,
            self.robot,
            is_robot,
            self.drops,
            takes_messages=takes_messages,
        )

    def publish(self, name: str, payload: Callable[[], bytes | None]) -> None:
        """Publish `state/<name>` to its subscribers; without a subscriber `payload` is not called.

        `name`: of the table `PUBLISHED`. A `payload` of None: there is nothing to publish.
        """
        publisher = self._publishers[name]
        if self._is_closed:
            return
        if name in self._unsure_names:
            self._unsure_names.discard(name)  # before the question: a later change adds it again
            self._has_subscriber[name] = has_subscriber(publisher)
        if not self._has_subscriber[name]:
            return
        try:
            content = payload()
            if content is not None:
                publisher.put(content)
        except zenoh.ZError:
            self.drops.add(f"state/{name}:unsent")

    def serve(self, plane: str, name: str, handler: Callable[[Query], None]) -> None:
        """Answer Zenoh queries on `<plane>/<name>` by `handler`.

        The key of a query names this robot, or has the wildcard ANY in the place of its name.
        `plane`, `name`: a row of the tables in `core/key_table.py`, such as "control" and "run";
        ValueError for any other. Any asker that the links permit may query. A query is dropped and
        counted if its key or size is wrong, or if `handler` raises. `handler` runs on the loop.
        """
        if not is_queried(plane, name):
            raise ValueError(f"{plane}/{name} is not in the tables of core/key_table.py")
        kind = f"{plane}/{name}"
        queue = InboundQueue(self._loop, self.drops, kind)
        self._queues.append(queue)

        def handle(query: Query) -> None:
            """Call `handler` on the loop; an error drops the query."""
            with self.drops.refusing(kind, lambda code, text: query.drop()):
                handler(query)

        def on_query(query: zenoh.Query) -> None:
            """Check a query on a thread of Zenoh, and hand it to the loop."""
            question = None if queue.is_full() else self._checked(query, plane, name)
            is_taken = question is not None and queue.offer(handle, question)
            if not is_taken:
                query.drop()

        # A key of `control` or `shared` ends with the name of its asker, here ANY; a key of `state`
        # has no asker. Zenoh also hands over the queries to all robots, since their keys match.
        asker = ANY if plane in (CONTROL, SHARED) else ""
        served_key = build(self.swarm, self.robot, plane, name, asker)
        self._queryables.append(self._session.declare_queryable(served_key, on_query))

    def _checked(self, query: zenoh.Query, plane: str, name: str) -> ZenohQuery | None:
        """The query for a handler of `<plane>/<name>`; None, and counted, for a wrong key or size.

        The reply goes out on this robot's own key, also if the query went to all robots.
        """
        payload = b"" if query.payload is None else query.payload
        key = parse(str(query.key_expr), is_query=True)
        if key is None or not self._is_own(key, plane, name):
            self.drops.add(f"{plane}/{name}:key")
            return None
        if len(payload) > MAX_CONTROL:
            self.drops.add(f"{plane}/{name}:oversized")
            return None
        asker = key.last  # the last chunk of the key; empty for `state`
        reply_key = build(self.swarm, self.robot, plane, name, asker)
        return ZenohQuery(self._session, query, reply_key, asker, bytes(payload))

    def serve_view(
        self,
        status: Callable[[], Status],
        members: Callable[[], tuple[Member, ...]],
        roster: tuple[str, ...] = (),
    ) -> None:
        """Answer `state/status` with the status, and `control/members` with a view."""

        def on_members(query: Query) -> None:
            if self._has_answered(query.payload):
                query.drop()
                return
            view = PeerView(robot=self.robot, status=status(), members=members(), roster=roster)
            query.reply(encode(view))

        self.serve(STATE, "status", lambda query: query.reply(encode(status())))
        self.serve(CONTROL, "members", on_members)

    def close(self) -> None:
        """Stop at once: no handler is called and no state is published any more. Idempotent."""
        if self._is_closed:
            return
        self._is_closed = True
        for queue in self._queues:
            queue.close()
        undeclare(*self._queryables, *self._publishers.values())
        if self.programs is not None:
            self.programs.close()

    def _on_viewers(self, name: str, _: zenoh.MatchingStatus) -> None:
        """Note a first or last subscriber; a thread of Zenoh calls it."""
        self._unsure_names.add(name)

    def _is_own(self, key: Key, plane: str, name: str) -> bool:
        """True if a query on `key` asks this robot, or all robots, for `<plane>/<name>`."""
        asked = (key.swarm, key.plane, key.name)
        return asked == (self.swarm, plane, name) and key.robot in (self.robot, ANY)

    def _has_answered(self, payload: bytes) -> bool:
        """True if the query lists this robot among the robots that have answered the asker.

        Raises CodecError for a malformed query.
        """
        return bool(payload) and self.robot in _members_query(payload).answered

"""The bus over Zenoh: how one daemon exchanges messages with the other robots and with operators.

Order of use in a daemon::

    bus = ZenohBus(session, swarm="lab", robot="tb3-01")  # learns of members from here on
    claim = await claim_id(session, ...)  # may raise NetworkError
    bus.serve("control", "run", on_run)  # on_run(query): query.payload, query.reply(bytes)
    bus.listen("msg", "*/*", on_message)  # on_message(key, payload)
    bus.publish("state", "status", encode(status))  # at last one with has_left=True
    claim.release(); bus.close(); session.close()

Zenoh calls from its own threads. Each callback checks key, kind and size, and puts the bytes into
an inbound queue (`inbound_queue.py`). Nothing raises into Zenoh. The handlers run on the loop, and
count payloads that they cannot decode: `bus.drop("control/run:malformed")`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Protocol

import zenoh
from msgspec.structs import replace
from zenoh.handlers import Callback

from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.keys import ANY, Key, build, parse
from swarmd.core.messages import Member, MembersQuery, PeerView, Presence, Status
from swarmd.network.inbound_queue import DropCounter, InboundQueue
from swarmd.network.membership import Membership
from swarmd.network.session import undeclare

# The plane whose puts reach a robot on its own key; samples of the others come from other robots.
SAFETY = "safety"
MAX_REPLIES = 1024


class Query(Protocol):
    """A question or request put to this robot, on its own key."""

    payload: bytes

    def reply(self, payload: bytes) -> None:
        """Answer, at most once, now or later, on the loop; never blocks, never raises."""

    def drop(self) -> None:
        """Do not answer; the asker learns that nothing more comes. Harmless after `reply`."""


Listener = Callable[[Key, bytes], None]


def members_for_view(membership: Membership, now: float) -> tuple[Member, ...]:
    """The members in a view: each living instance without its status, which it sends itself."""
    found: dict[tuple[str, str], Member] = {}
    for robot, instances in membership.duplicates.items():
        for instance in instances:
            found[robot, instance] = Member(
                robot=robot, instance=instance, presence=Presence.ALIVE, age=0.0
            )
    for member in membership.members(now).values():
        is_alive = member.presence is Presence.ALIVE
        found[member.robot, member.instance] = replace(member, status=None) if is_alive else member
    return tuple(found[key] for key in sorted(found))


_status = Decoder(Status)
_members_query = Decoder(MembersQuery)


class ZenohQuery:
    """A `Query` of Zenoh, answered on this robot's own key."""

    __slots__ = ("_key", "_query", "payload")

    def __init__(self, query: zenoh.Query | None, key: str, payload: bytes) -> None:
        self._query = query
        self._key = key
        self.payload = payload

    def reply(self, payload: bytes) -> None:
        """Answer; nothing happens for a plain put or after the first time."""
        query, self._query = self._query, None
        if query is None:
            return
        try:
            query.reply(self._key, payload)
            query.drop()
        except zenoh.ZError:  # the asker or the session is gone
            return

    def drop(self) -> None:
        """Do not answer."""
        query, self._query = self._query, None
        if query is not None:
            query.drop()


class ZenohBus:
    """The bus of one robot; built on the loop's thread, on which all handlers run.

    Samples and queries with a wild or foreign key are dropped and counted in `dropped`, by kind.
    """

    def __init__(self, session: zenoh.Session, *, swarm: str, robot: str) -> None:
        self.swarm = swarm
        self.robot = robot
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._drops = DropCounter()
        self._membership = Membership(robot)
        self._member_callbacks: list[Callable[[Member], None]] = []
        self._status_callbacks: list[Callable[[Status], None]] = []
        self._publishers: dict[tuple[str, str, bool], zenoh.Publisher] = {}
        self._entities: list[zenoh.Subscriber[None] | zenoh.Queryable[None]] = []
        self._queues: list[InboundQueue] = []
        self._is_closed = False
        self._watch_tokens()
        self.listen("state", "status", self._on_status)

    @property
    def members(self) -> Mapping[str, Member]:
        """The other robots that were ever seen and not forgotten, by id."""
        return self._membership.members(boottime())

    @property
    def dropped(self) -> dict[str, int]:
        """What was dropped so far, by kind, such as `control/run:key`."""
        return self._drops.counts()

    def drop(self, kind: str) -> None:
        """Count what could not be read, such as `control/run:malformed`."""
        self._drops.add(kind)

    def publish(self, plane: str, name: str, payload: bytes, *, express: bool = False) -> None:
        """Publish on this robot's own key; dropped where a link is congested."""
        if self._is_closed:
            return
        try:
            self._publisher(plane, name, express).put(payload)
        except zenoh.ZError:
            self._drops.add(f"{plane}/{name}:unsent")

    def listen(self, plane: str, name: str, handler: Listener) -> None:
        """Subscribe to other robots' `<plane>/<name>`, where a chunk of `name` may be `*`."""
        self._subscribe(build(self.swarm, ANY, plane, name), f"{plane}/{name}", plane, handler)

    def serve(self, plane: str, name: str, handler: Callable[[Query], None]) -> None:
        """Answer queries to this robot or to all; in plane `safety` also take plain puts."""
        own = build(self.swarm, self.robot, plane, name)
        accepted = frozenset({own, build(self.swarm, ANY, plane, name)})
        kind = f"{plane}/{name}"
        queue = self._queue(kind, is_urgent=plane == SAFETY)

        def on_query(query: zenoh.Query) -> None:
            if not queue.is_full():
                payload = b"" if query.payload is None else query.payload
                if str(query.key_expr) not in accepted:
                    self._drops.add(f"{kind}:key")
                elif len(payload) > MAX_CONTROL:
                    self._drops.add(f"{kind}:oversized")
                elif queue.offer(handler, ZenohQuery(query, own, bytes(payload))):
                    return
            query.drop()

        self._entities.append(self._session.declare_queryable(own, on_query))
        if plane == SAFETY:
            self._subscribe(
                own,
                f"{kind}:put",
                plane,
                lambda _key, payload: handler(ZenohQuery(None, own, payload)),
            )

    def serve_view(self, status: Callable[[], Status], roster: tuple[str, ...] = ()) -> None:
        """Answer `state/status` and `control/members` from `status()` and the membership."""

        def on_members(query: Query) -> None:
            if self._is_excused(query.payload):
                query.drop()
                return
            members = members_for_view(self._membership, boottime())
            view = PeerView(robot=self.robot, status=status(), members=members, roster=roster)
            query.reply(encode(view))

        self.serve("state", "status", lambda query: query.reply(encode(status())))
        self.serve("control", "members", on_members)

    def on_member(self, callback: Callable[[Member], None]) -> None:
        """Call back for each member whose instance or presence changed."""
        self._member_callbacks.append(callback)

    def on_status(self, callback: Callable[[Status], None]) -> None:
        """Call back for each status that another robot publishes on its own key."""
        self._status_callbacks.append(callback)

    def forget(self, robot: str) -> bool:
        """Remove a robot that is not alive from the members; False if there is none such."""
        return self._membership.forget(robot)

    async def ask(
        self, plane: str, name: str, payload: bytes = b"", *, timeout: float = 1.0
    ) -> list[tuple[str, bytes]]:
        """Other robots' answers on `<plane>/<name>` as (robot, payload), within `timeout` s.

        Returns when all reachable robots have answered. A missing answer does not prove absence.
        """
        answers: list[tuple[str, bytes]] = []
        done = asyncio.Event()
        queue = InboundQueue(self._loop, self._drops, f"ask {plane}/{name}", is_urgent=True)

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None:
                return
            key = parse(str(sample.key_expr))
            if key is None or (key.swarm, key.plane, key.name) != (self.swarm, plane, name):
                self._drops.add(f"{queue.kind}:key")
            elif key.robot != self.robot:
                queue.offer(answers.append, (key.robot, sample.payload.to_bytes()))

        try:
            self._session.get(
                build(self.swarm, ANY, plane, name),
                Callback(on_reply, lambda: queue.offer(done.set), indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.DROP,
                timeout=timeout,
                payload=payload,
            )
            async with asyncio.timeout(timeout + 0.5):
                await done.wait()
        except (zenoh.ZError, TimeoutError):
            self._drops.add(f"{queue.kind}:timeout")
        finally:
            queue.close()
        return answers[:MAX_REPLIES]

    def close(self) -> None:
        """Stop at once: no handler is called and nothing is published any more. Idempotent.

        Publish `left` before.
        """
        if self._is_closed:
            return
        self._is_closed = True
        for queue in self._queues:
            queue.close()
        undeclare(*self._entities, *self._publishers.values())

    def _publisher(self, plane: str, name: str, express: bool) -> zenoh.Publisher:
        publisher = self._publishers.get((plane, name, express))
        if publisher is None:
            publisher = self._session.declare_publisher(
                build(self.swarm, self.robot, plane, name),
                congestion_control=zenoh.CongestionControl.DROP,
                express=express,
            )
            self._publishers[(plane, name, express)] = publisher
        return publisher

    def _subscribe(self, key_expr: str, kind: str, plane: str, handler: Listener) -> None:
        """Zenoh delivers every key that intersects `key_expr`, so a concrete key always matches."""
        is_own = plane == SAFETY
        queue = self._queue(kind, is_urgent=is_own)
        limit = MAX_MESSAGE if plane == "msg" else MAX_CONTROL

        def on_sample(sample: zenoh.Sample) -> None:
            if queue.is_full():
                return
            key = parse(str(sample.key_expr))
            is_accepted = key is not None and (key.robot == self.robot) == is_own
            if not is_accepted or sample.kind != zenoh.SampleKind.PUT:
                self._drops.add(f"{kind}:key")
            elif len(sample.payload) > limit:
                self._drops.add(f"{kind}:oversized")
            else:
                queue.offer(handler, key, sample.payload.to_bytes())

        self._entities.append(
            self._session.declare_subscriber(
                key_expr, on_sample, allowed_origin=zenoh.Locality.REMOTE
            )
        )

    def _queue(self, kind: str, *, is_urgent: bool) -> InboundQueue:
        queue = InboundQueue(self._loop, self._drops, kind, is_urgent=is_urgent)
        self._queues.append(queue)
        return queue

    def _watch_tokens(self) -> None:
        queue = self._queue("alive", is_urgent=True)

        def on_token(sample: zenoh.Sample) -> None:
            key = parse(str(sample.key_expr))
            if key is None:
                self._drops.add("alive:key")
            elif key.robot != self.robot:
                is_there = sample.kind == zenoh.SampleKind.PUT
                queue.offer(self._on_token, key.robot, key.name, is_there)

        self._entities.append(
            self._session.liveliness().declare_subscriber(
                build(self.swarm, ANY, "alive", ANY), on_token, history=True
            )
        )

    def _on_token(self, robot: str, instance: str, is_there: bool) -> None:
        event = self._membership.on_alive if is_there else self._membership.on_gone
        if event(robot, instance, boottime()):
            self._notify(robot)

    def _on_status(self, key: Key, payload: bytes) -> None:
        try:
            status = _status(payload)
        except CodecError:
            self._drops.add("state/status:malformed")
            return
        if status.robot != key.robot:
            self._drops.add("state/status:key")
            return
        if self._membership.on_status(status, boottime()):
            self._notify(key.robot)
        for callback in self._status_callbacks:
            callback(status)

    def _notify(self, robot: str) -> None:
        member = self._membership.member(robot, boottime())
        if member is not None:
            for callback in self._member_callbacks:
                callback(member)

    def _is_excused(self, payload: bytes) -> bool:
        """True if the asker has this robot's answer already, or the query is malformed."""
        if not payload:
            return False
        try:
            return self.robot in _members_query(payload).answered
        except CodecError:
            self._drops.add("control/members:malformed")
            return True

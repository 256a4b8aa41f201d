"""The bus in memory: the same rules as over the network, without threads, sockets or waiting.

Everything that is said waits in the medium until `deliver` is called, so that a test or a lockstep
simulation decides when; who hears whom is `reaches`, such as a radio model::

    medium = MemoryMedium(clock=lambda: now)
    a, b = MemoryBus(medium, "a", "boot-a"), MemoryBus(medium, "b", "boot-b")
    b.listen("msg", "*/*", heard)
    a.publish("msg", "vote/opinion", b"...")
    medium.deliver()
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from swarmd.clock import Clock, boottime
from swarmd.codec import MAX_CONTROL, Decoder, encode
from swarmd.errors import CodecError
from swarmd.keys import ANY, Key, build, parse
from swarmd.messages import Member, Status, View
from swarmd.network.contract import (
    SAFETY,
    Listener,
    MemberListener,
    Query,
    Server,
    StatusListener,
)
from swarmd.network.membership import Membership
from swarmd.network.rules import limit_of, matches, members_to_tell

Reaches = Callable[[str, str], bool]

_status = Decoder(Status)


class MemoryQuery:
    """A query in memory; its answers are collected by robot. See `contract.Query`."""

    def __init__(self, payload: bytes, robot: str, replies: dict[str, bytes]) -> None:
        self.payload = payload
        self._robot = robot
        self._replies: dict[str, bytes] | None = replies

    def reply(self, payload: bytes) -> None:
        """Answer once."""
        if self._replies is not None:
            self._replies[self._robot] = payload
        self._replies = None

    def drop(self) -> None:
        """Do not answer."""
        self._replies = None


class MemoryMedium:
    """What lies between buses. `reaches(sender, hearer)` says who hears whom now."""

    def __init__(
        self,
        *,
        swarm: str = "memory",
        clock: Clock = boottime,
        reaches: Reaches = lambda _sender, _hearer: True,
    ) -> None:
        self.swarm = swarm
        self.clock = clock
        self.reaches = reaches
        self.buses: dict[str, MemoryBus] = {}
        self._queue: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()

    def send(self, function: Callable[..., object], *args: Any) -> None:
        """Have something happen at the next delivery."""
        self._queue.append((function, args))

    def deliver(self) -> int:
        """Let all that was said until now arrive, in its order; says how much.

        What handlers say meanwhile waits for the next time.
        """
        waiting = len(self._queue)
        for _ in range(waiting):
            function, args = self._queue.popleft()
            function(*args)
        return waiting

    def ask(
        self, plane: str, name: str, payload: bytes = b"", *, robot: str = ANY
    ) -> dict[str, bytes]:
        """Query as swarmctl does; the answers by robot, which later ones still join."""
        replies: dict[str, bytes] = {}
        key = build(self.swarm, robot, plane, name)
        for bus in list(self.buses.values()):
            self.send(bus.on_query, key, payload, replies)
        self.deliver()
        return replies

    def put(self, key: str, payload: bytes) -> None:
        """Publish on any key, as a stranger may."""
        for bus in list(self.buses.values()):
            self.send(bus.on_sample, key, payload)


class MemoryBus:
    """See `contract.Bus`. A member from the start; `close` lets it vanish."""

    def __init__(self, medium: MemoryMedium, robot: str, instance: str) -> None:
        self.robot = robot
        self.instance = instance
        self._medium = medium
        self._membership = Membership(robot)
        self._listeners: list[tuple[str, str, Listener]] = []
        self._servers: dict[tuple[str, str], Server] = {}
        self._callbacks: list[MemberListener] = []
        self._status_callbacks: list[StatusListener] = []
        self._drops: dict[str, int] = {}
        for other in medium.buses.values():
            medium.send(other.on_token, robot, instance, True)
            medium.send(self.on_token, other.robot, other.instance, True)
        medium.buses[robot] = self

    @property
    def members(self) -> Mapping[str, Member]:
        """The other robots, by id."""
        return self._membership.members(self._medium.clock())

    @property
    def dropped(self) -> dict[str, int]:
        """What was dropped so far, by kind."""
        return dict(self._drops)

    def drop(self, kind: str, count: int = 1) -> None:
        """Count something that could not be read."""
        self._drops[kind] = self._drops.get(kind, 0) + count

    def publish(self, plane: str, name: str, payload: bytes, *, express: bool = False) -> None:
        """Say something on the own key to all that it reaches when it is said."""
        key = build(self._medium.swarm, self.robot, plane, name)
        for other in self._others():
            self._medium.send(other.on_sample, key, payload)

    def listen(self, plane: str, name: str, handler: Listener) -> None:
        """Hear other robots' `<plane>/<name>`."""
        self._listeners.append((plane, name, handler))

    def serve(self, plane: str, name: str, handler: Server) -> None:
        """Answer queries on the own key or `*` in its place; `safety` also takes plain puts."""
        if (plane, name) in self._servers:
            raise ValueError(f"{plane}/{name} is served already")
        self._servers[plane, name] = handler

    def serve_view(self, status: Callable[[], Status], roster: tuple[str, ...] = ()) -> None:
        """Answer `state/status` and `control/members`."""

        def on_members(query: Query) -> None:
            query.reply(encode(self.view(status(), roster)))

        self.serve("state", "status", lambda query: query.reply(encode(status())))
        self.serve("control", "members", on_members)

    def view(self, status: Status, roster: tuple[str, ...] = ()) -> View:
        """This robot's status and what it knows of the others."""
        members = members_to_tell(self._membership, self._medium.clock())
        return View(robot=self.robot, status=status, members=members, roster=roster)

    def on_member(self, callback: MemberListener) -> None:
        """Be told of each member whose instance or condition changed."""
        self._callbacks.append(callback)

    def on_status(self, callback: StatusListener) -> None:
        """Be told of each status that another robot publishes."""
        self._status_callbacks.append(callback)

    def forget(self, robot: str) -> bool:
        """Take a robot that is not alive off the list."""
        return self._membership.forget(robot)

    async def ask(
        self, plane: str, name: str, payload: bytes = b"", *, timeout: float = 1.0
    ) -> list[tuple[str, bytes]]:
        """Other robots' answers that come at once."""
        replies: dict[str, bytes] = {}
        key = build(self._medium.swarm, ANY, plane, name)
        for other in self._others():
            other.on_query(key, payload, replies)
        return sorted(replies.items())

    def close(self) -> None:
        """Vanish: nothing is heard or said any more."""
        if self._medium.buses.get(self.robot) is self:
            del self._medium.buses[self.robot]
            for other in self._medium.buses.values():
                self._medium.send(other.on_token, self.robot, self.instance, False)
        self._listeners.clear()
        self._servers.clear()

    # What the medium calls

    def on_token(self, robot: str, instance: str, is_there: bool) -> None:
        """A token appeared or vanished."""
        event = self._membership.on_alive if is_there else self._membership.on_gone
        if event(robot, instance, self._medium.clock()):
            self._tell(robot)

    def on_sample(self, text: str, payload: bytes) -> None:
        """A put: taken if its key is exactly one that is listened to."""
        key = parse(text)
        if key is None or key.swarm != self._medium.swarm:
            self.drop("key")
        elif key.robot == self.robot:
            self._on_own(key, payload)
        elif len(payload) > limit_of(key.plane):
            self.drop(f"{key.plane}/{key.name}:oversized"[:64])
        else:
            if key.plane == "state" and key.name == "status":
                self._on_status(key, payload)
            for plane, name, handler in list(self._listeners):
                if plane == key.plane and matches(key.name, name):
                    handler(key, payload)

    def on_query(self, text: str, payload: bytes, replies: dict[str, bytes]) -> None:
        """A query: taken if its key is the own one, or `*` stands for the robot."""
        for (plane, name), handler in list(self._servers.items()):
            wanted = (
                build(self._medium.swarm, self.robot, plane, name),
                build(self._medium.swarm, ANY, plane, name),
            )
            if text in wanted and len(payload) <= MAX_CONTROL:
                handler(MemoryQuery(payload, self.robot, replies))

    def _on_own(self, key: Key, payload: bytes) -> None:
        handler = self._servers.get((key.plane, key.name))
        if key.plane != SAFETY or handler is None:
            self.drop(f"{key.plane}/{key.name}:key"[:64])
        else:
            handler(MemoryQuery(payload, self.robot, {}))

    def _on_status(self, key: Key, payload: bytes) -> None:
        try:
            status = _status(payload)
        except CodecError:
            self.drop("state/status:malformed")
            return
        if status.robot != key.robot:
            self.drop("state/status:key")
            return
        if self._membership.on_status(status, self._medium.clock()):
            self._tell(key.robot)
        for callback in self._status_callbacks:
            callback(status)

    def _tell(self, robot: str) -> None:
        member = self._membership.member(robot, self._medium.clock())
        if member is not None:
            for callback in self._callbacks:
                callback(member)

    def _others(self) -> list[MemoryBus]:
        return [
            bus
            for bus in self._medium.buses.values()
            if bus is not self and self._medium.reaches(self.robot, bus.robot)
        ]

"""A swarm without bodies: real sessions, membership and acks, for tests of the network and the CLI.

In one process::

    async with FakeDaemon(settings, "tb3-01") as daemon: ...
"""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Self

from swarmd.core import verbs
from swarmd.core.clock import ClockSample
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.events import Input
from swarmd.core.goal import Goal
from swarmd.core.messages import Code, Epoch, Reason, Reply, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import AnyRequest
from swarmd.daemon.network import Network, NetworkRobot
from swarmd.link.carriers.bus import Query, ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.interface_watch import InterfaceChange
from swarmd.link.datagram import Address, Beacon, Stop
from swarmd.link.peer import StopVerdict, Summary
from swarmd.link.settings import NetworkSettings
from swarmd.link.signature import Author
from tests.support.keys import SwarmKeys
from tests.support.statuses import status

VERBS = ("run", "reset", "param", "forget")


_DECODERS = {verb: Decoder(verbs.VERBS[verb].asked) for verb in VERBS}
# How to answer a request; None: not at all.
Answer = Callable[[AnyRequest | Stop], Code | None]


def light_status(robot: str, instance: str) -> Status:
    """The status of an idle robot."""
    epoch = Epoch(instance=instance, revision=0)
    idle = {"state": State.IDLE, "reason": Reason.NEVER_ASKED, "pattern": None}
    return status(robot, instance=instance, epoch=epoch, **idle)


class FakeDaemon:
    """One robot that is a member, answers for itself, and acks what names it with `answer`."""

    def __init__(
        self,
        settings: NetworkSettings,
        robot: str,
        *,
        answer: Answer = lambda _request: Code.APPLIED,
        roster: tuple[str, ...] = (),
        version: str = "1.0",
        keys: SwarmKeys | None = None,
    ) -> None:
        self.robot = robot
        self._identity = None if keys is None else keys[robot]
        self.instance = secrets.token_hex(6)
        self.is_moving = False  # as its acks say
        self.settings = settings
        self.requests: list[AnyRequest | Stop] = []
        self.network: Network
        self._version = version
        self._answer = answer
        self._roster = roster
        self._advancing: asyncio.Task[None] | None = None

    @property
    def different_requests(self) -> list[AnyRequest | Stop]:
        """The requests without their repetitions, which come if an answer takes its time."""
        return [*{one.id: one for one in reversed(self.requests)}.values()][::-1]

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.leave()

    async def start(self) -> None:
        """Open, claim and serve; NetworkError if the id is taken."""
        self.network = Network(
            self.settings,
            NetworkRobot(
                name=self.robot,
                instance=self.instance,
                roster=self._roster,
                version=self._version,
            ),
            drops=DropCounter(),
            identity=self._identity,
            stop_counters=None if self._identity is None else self._identity.folder / "stops",
        )
        self._advancing = asyncio.create_task(self._advance())
        try:
            await self.network.join(self)
        except BaseException:
            self.vanish()
            raise

    def summary(self) -> Summary:
        return Summary(State.IDLE, 0, {})

    def check_goal(self, goal: Goal, now: float) -> bool:
        return True

    def judge_stop(self, stop: Stop, author: Author | None) -> StopVerdict:
        return StopVerdict(stop)

    def on_refused_stop(
        self, stop: Stop, source: Address, text: str, answer: Callable[[Reply], None]
    ) -> None:
        """It refuses none."""

    def on_input(self, input: Input) -> None:
        """It has no robot."""

    def on_clock(self, sample: ClockSample) -> None:
        """It records nothing."""

    def on_members(self) -> None:
        """It has no neighbors."""

    def on_lost(self, beacon: Beacon) -> None:
        """It keeps no incidents."""

    def on_interface(self, change: InterfaceChange) -> None:
        """It has no run to end."""

    def on_event(self, text: str) -> None:
        """It has no log."""

    def on_newer_roster(self, robot: str, address: Address, generation: int) -> None:
        """It keeps its roster."""

    def on_beacon(self, beacon: Beacon, address: Address) -> None:
        """It takes no pushed patterns."""

    def status(self) -> Status:
        return light_status(self.robot, self.instance)

    def leave(self) -> None:
        """Say so, and go."""
        self._end(is_leaving=True)

    def vanish(self) -> None:
        """Go without a word. Idempotent."""
        self._end(is_leaving=False)

    def _end(self, *, is_leaving: bool) -> None:
        if self._advancing is not None:
            self._advancing.cancel()
            self._advancing = None
            self.network.close(is_leaving=is_leaving)

    async def _advance(self) -> None:
        while True:
            self.network.advance()
            await asyncio.sleep(0.05)

    def serve(self, bus: ZenohBus) -> None:
        bus.serve_view(self.status, lambda: tuple(self.network.members.values()), self._roster)
        for verb in VERBS:
            bus.serve("control", verb, partial(self._on_query, verb))

    def on_stop(self, stop: Stop, source: Address, answer: Callable[[Reply], None]) -> None:
        if stop.targets is None or self.robot in stop.targets:
            self.requests.append(stop)
            self._reply(stop, answer)

    def _on_query(self, verb: str, query: Query) -> None:
        try:
            request = _DECODERS[verb](query.payload)
        except CodecError:
            self.network.drops.add("request:malformed")
            query.drop()
            return
        if request.targets is not None and self.robot not in request.targets:
            query.drop()
            return
        self.requests.append(request)
        self._reply(request, lambda reply: query.reply(encode(reply)))

    def _reply(self, request: AnyRequest | Stop, answer: Callable[[Reply], None]) -> None:
        code, epoch = self._answer(request), self.status().epoch
        if code is not None:
            why = Refusal.BUSY if code is Code.REFUSED else None
            answer(
                Reply(
                    id=request.id,
                    robot=self.robot,
                    code=code,
                    refusal=why,
                    epoch=epoch,
                    is_moving=self.is_moving,
                )
            )


class FakeSwarm:
    """Light daemons on a loop of their own, for code that blocks; by name, until `close`.

    `is_awaited` False: they may start later.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        robots: Sequence[str],
        *,
        is_awaited: bool = True,
        **options: Any,
    ) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._daemons = {robot: FakeDaemon(settings, robot, **options) for robot in robots}
        self._starting = asyncio.run_coroutine_threadsafe(self._start(), self._loop)
        if is_awaited:
            self._starting.result()

    def __getitem__(self, robot: str) -> FakeDaemon:
        return self._daemons[robot]

    def call(self, function: Callable[[], object]) -> None:
        """Call on the daemons' loop, and wait for it."""

        async def now() -> None:
            function()

        asyncio.run_coroutine_threadsafe(now(), self._loop).result()

    def until(self, condition: Callable[[], bool], timeout: float = 20.0) -> None:
        """Wait for a condition that is looked at on the daemons' loop; TimeoutError."""

        async def look() -> None:
            async with asyncio.timeout(timeout):
                while not condition():
                    await asyncio.sleep(0.005)

        asyncio.run_coroutine_threadsafe(look(), self._loop).result()

    def close(self) -> None:
        self._starting.cancel()
        for daemon in self._daemons.values():
            self.call(daemon.vanish)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _start(self) -> None:
        await asyncio.gather(*(daemon.start() for daemon in self._daemons.values()))

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

import msgspec
import zenoh

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import (
    REQUEST_TYPES,
    AnyRequest,
    Code,
    Epoch,
    Reason,
    Refusal,
    Reply,
    State,
    Status,
)
from swarmd.network.bus import Query, ZenohBus
from swarmd.network.claim import Claim, claim_id
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.statuses import status

VERBS = ("run", "stop", "reset", "param", "forget")


_DECODERS = {verb: Decoder(kind) for verb, kind in REQUEST_TYPES.items()}
# How to answer a request; None: not at all.
Answer = Callable[[AnyRequest], Code | None]


def light_status(robot: str, instance: str, *, has_left: bool = False) -> Status:
    """The status of an idle robot."""
    epoch = Epoch(instance=instance, revision=0)
    idle = {"state": State.IDLE, "reason": Reason.NEVER_ASKED, "pattern": None}
    return status(robot, instance=instance, epoch=epoch, has_left=has_left, **idle)


class FakeDaemon:
    """One peer that is a member, answers for itself, and acks what names it with `answer`."""

    def __init__(
        self,
        settings: NetworkSettings,
        robot: str,
        *,
        answer: Answer = lambda _request: Code.APPLIED,
        roster: tuple[str, ...] = (),
    ) -> None:
        self.robot = robot
        self.instance = secrets.token_hex(6)
        self.settings = settings
        self.requests: list[AnyRequest] = []
        self._answer = answer
        self._roster = roster
        self._claim: Claim | None = None

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.leave()

    async def start(self) -> None:
        """Open, serve and claim; NetworkError if the id is taken."""
        self.session: zenoh.Session = await asyncio.to_thread(open_session, self.settings)
        self.bus = ZenohBus(self.session, swarm=self.settings.swarm, robot=self.robot)
        self.bus.serve_view(self.status, self._roster)
        for verb in VERBS:
            self.bus.serve("control", verb, partial(self._on_query, verb))
        self.bus.serve("safety", "estop", partial(self._on_query, "estop"))
        try:
            self._claim = await claim_id(
                self.session,
                swarm=self.settings.swarm,
                robot=self.robot,
                instance=self.instance,
                settle=self.settings.settle,
                lease=self.settings.lease_seconds,
                on_duplicate=lambda instance: None,
            )
        except BaseException:
            self.vanish()
            raise

    def status(self) -> Status:
        return light_status(self.robot, self.instance)

    def leave(self) -> None:
        """Publish `left`, and go."""
        left = msgspec.structs.replace(self.status(), has_left=True)
        self.bus.publish("state", "status", encode(left))
        self.vanish()

    def vanish(self) -> None:
        """Go without a word. Idempotent."""
        self._claim = None  # the session takes the token along
        self.bus.close()
        self.session.close()

    def _on_query(self, verb: str, query: Query) -> None:
        try:
            request = _DECODERS[verb](query.payload)
        except CodecError:
            self.bus.drop("request:malformed")
            query.drop()
            return
        if request.targets is not None and self.robot not in request.targets:
            query.drop()
            return
        self.requests.append(request)
        code, epoch = self._answer(request), self.status().epoch
        if code is not None:
            why = Refusal.BUSY if code is Code.REFUSED else None
            reply = Reply(id=request.id, robot=self.robot, code=code, refusal=why, epoch=epoch)
            query.reply(encode(reply))


class FakeSwarm:
    """Light daemons on a loop of their own, for code that blocks; by name, until `close`."""

    def __init__(self, settings: NetworkSettings, robots: Sequence[str], **options: Any) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._daemons = {robot: FakeDaemon(settings, robot, **options) for robot in robots}
        asyncio.run_coroutine_threadsafe(self._start(), self._loop).result()

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
        for daemon in self._daemons.values():
            self.call(daemon.vanish)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _start(self) -> None:
        await asyncio.gather(*(daemon.start() for daemon in self._daemons.values()))

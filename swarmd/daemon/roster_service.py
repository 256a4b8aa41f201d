"""Takes rosters from operators and peers, and hands the own roster to peers.

A thread checks a roster and writes it to disk. Then the loop stops the robot, answers the request,
and reopens the network with the new roster, in this order.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.messages import Code, KeySummary, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import RosterRequest
from swarmd.daemon.requests import SendReply
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster_change import (
    SharedRoster,
    TakenRoster,
    read_shared,
    share_roster,
    take_roster,
)

log = logging.getLogger(__name__)


class RosterService:
    """The roster of one daemon, which takes one new roster at a time.

    `on_taken` is called on the loop with each new roster; the daemon applies it there. `drops`
    counts rosters whose handling raised an error.
    """

    def __init__(
        self,
        robot: str,
        identity: Identity | None,
        on_taken: Callable[[TakenRoster], None],
        drops: DropCounter,
    ) -> None:
        self._drops = drops
        self._robot = robot
        self._on_taken = on_taken
        self._loop = asyncio.get_running_loop()
        self._one_at_a_time = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self.identity = identity

    @property
    def summary(self) -> KeySummary | None:
        """The present roster in short; None without keys."""
        identity = self.identity
        if identity is None:
            return None
        return KeySummary(generation=identity.roster.generation, expires=identity.info.expires)

    def on_roster(self, request: RosterRequest, answer: SendReply) -> None:
        """Take the roster of a request; the reply follows after the robot has stopped."""

        def tell(code: Code, refusal: Refusal | None, text: str) -> None:
            answer(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text))

        def refuse(code: Code, text: str) -> None:
            tell(code, Refusal.INVALID_ROSTER if code is Code.REFUSED else None, text)

        async def run() -> None:
            shared = SharedRoster(request.roster, request.secret)
            certificate = request.certificates.get(self._robot, b"")
            with self._drops.refusing("control/roster", refuse):
                refusal, text = await self.take(shared, certificate)
                code = Code.APPLIED
                if refusal is not None:
                    code = Code.FAILED if refusal is Refusal.NOT_WRITTEN else Code.REFUSED
                tell(code, refusal, text)

        self._start(run())

    def on_pulled(self, blob: bytes | None, why: str) -> None:
        """Take the roster that a peer handed over; `blob` None: log the reason `why`."""
        if blob is None:
            log.info("no newer roster: %s", why)
            return
        self._start(self._take_pulled(blob))

    def share(self, name: str, asker: str) -> bytes | None:
        """The own roster as bytes for `asker`, whose name the link has proved; in a thread."""
        return None if self.identity is None else share_roster(self.identity, asker)

    async def take(
        self, shared: SharedRoster, certificate: bytes = b""
    ) -> tuple[Refusal | None, str]:
        """Take a roster if it is valid and newer.

        Returns a refusal and its reason; or None and what has changed. The refusal is NOT_WRITTEN
        if the identity's folder cannot be written: the robot then uses the roster, but only until a
        restart. The refusal is NOT_WRITTEN, too, if this folder cannot be read: nothing changes.
        """
        async with self._one_at_a_time:
            if self.identity is None:
                return Refusal.INVALID_ROSTER, "this swarm has no keys"
            try:
                taken = await asyncio.to_thread(take_roster, self.identity, shared, certificate)
            except (CodecError, ConfigError) as error:
                return Refusal.INVALID_ROSTER, str(error)[:300]
            except OSError as error:
                return Refusal.NOT_WRITTEN, f"identity: {error.strerror}"[:300]
            self.identity = taken.identity
            if taken.is_changed:
                self._on_taken(taken)
            if taken.fault:
                return Refusal.NOT_WRITTEN, taken.text[:300]
            return None, (taken.text if taken.is_changed else f"{taken.text}, as before")[:300]

    def close(self) -> None:
        """Take no roster any more."""
        for task in self._tasks:
            task.cancel()

    def _start(self, work: Coroutine[None, None, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _take_pulled(self, blob: bytes) -> None:
        def refuse(code: Code, text: str) -> None:
            log.warning("the roster of a peer (%s): %s", code, text)

        with self._drops.refusing("shared/roster", refuse):
            refusal, text = await self.take(read_shared(blob))
            if refusal is not None:
                log.warning("the roster of a peer (%s): %s", refusal, text)

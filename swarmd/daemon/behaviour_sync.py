"""Pushed behaviours of other robots: a beacon shows a digest of the table, the rest is pulled.

A robot that joins late, was cut off or restarted takes over the manifests that it missed, checks
their signatures, and pulls the code that it is to have from a robot that has it. Nothing is sent
while all agree.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial

from swarmd.core.behaviour import Entry, decode_table, encode_table
from swarmd.core.clock import boottime
from swarmd.core.goal import generation_of
from swarmd.core.messages import Code
from swarmd.core.verbs import BehavioursReply, Nothing
from swarmd.daemon.behaviour_state import BehaviourState
from swarmd.daemon.behaviour_store import BehaviourStore
from swarmd.network.bus import ZenohBus
from swarmd.network.datagram import Address
from swarmd.network.inbound_queue import DropCounter
from swarmd.network.pull import Blob, Puller, serve_shared

log = logging.getLogger(__name__)

TABLE, CODE = "behaviours", "behaviour"
# s until the same is asked of the same robot again: it may not have it, or its manifests may be
# signed by an operator that the own roster does not have.
TABLE_PERIOD, CODE_PERIOD = 30.0, 5.0
FALSE_PERIOD = 300.0
"""s for which nothing is pulled from a robot that handed over a false signature: each takes 4 ms
of a core to refuse, and robots keep only entries that they verified."""
MAX_ASKED = 256


class BehaviourSync:
    """Pulls what `state` lacks with `puller` and hands it to `store`; serves what it has.

    `on_taken(robot, entry)`: code came from a robot, and is tried. `drops` counts the tables that
    cannot be read.
    """

    def __init__(
        self,
        state: BehaviourState,
        store: BehaviourStore,
        puller: Puller,
        on_taken: Callable[[str, Entry], None],
        drops: DropCounter,
    ) -> None:
        self._drops = drops
        self._state = state
        self._store = store
        self._on_taken = on_taken
        self._puller = puller
        self._asked: dict[tuple[str, bytes], float] = {}
        self._complete_at: tuple[int, tuple[str, ...]] = (-1, ())  # nothing was missing then
        self._checking: asyncio.Task[None] | None = None
        self._false: dict[str, float] = {}  # until when nothing is pulled from a robot

    def serve(self, bus: ZenohBus) -> None:
        """Hand tables and code to other robots."""
        state = self._state
        serve_shared(bus, TABLE, lambda name, asker: encode_table(state.table))
        serve_shared(bus, CODE, lambda name, asker: state.shared_code(name))

    def on_plugins(self, _: Nothing) -> BehavioursReply:
        """The pushed behaviours of this robot."""
        return self._state.report()

    def close(self) -> None:
        """End a check under way."""
        if self._checking is not None:
            self._checking.cancel()

    def on_beacon(self, robot: str, digest: bytes, address: Address, now: float) -> None:
        """The beacon of another robot shows this digest of its table."""
        if not digest or self._checking is not None or self._store.is_busy:
            return
        if now < self._false.get(robot, -1e9):
            return
        own = self._state.digest
        is_new = digest != own and generation_of(digest) >= generation_of(own)
        if not is_new or not self._pull_table(robot, digest, address, now):
            self._pull_code(robot, address, now)

    def _pull_table(self, robot: str, digest: bytes, address: Address, now: float) -> bool:
        def on_done(blob: Blob, why: str) -> None:
            if blob is None:
                log.info("the behaviours of %s are not known: %s", robot, why)
                self._asked[robot, digest] = now + CODE_PERIOD - TABLE_PERIOD
            else:
                self._checking = asyncio.get_running_loop().create_task(
                    self._check(robot, address, blob)
                )

        if not self._may_ask(robot, digest, now, TABLE_PERIOD):
            return False
        is_begun = self._puller.pull(robot, address, TABLE, on_done=on_done)
        if is_begun:
            self._asked[robot, digest] = now
        return is_begun

    def _pull_code(self, robot: str, address: Address, now: float) -> None:
        """Pull the first missing behaviour that this robot may have."""
        present = self._state.changes, tuple(self._state.control.labels())
        if self._complete_at == present:
            return
        missing = self._state.missing()
        if not missing:
            self._complete_at = present
        for entry in missing:
            wanted = entry.manifest.digest
            if not self._may_ask(robot, wanted, now, CODE_PERIOD):
                continue
            if self._puller.pull(
                robot,
                address,
                CODE,
                wanted.hex(),
                limit=entry.manifest.size,
                digest=wanted,
                on_done=partial(self._on_code, robot, entry),
            ):
                self._asked[robot, wanted] = now
            return

    def _may_ask(self, robot: str, what: bytes, now: float, period: float) -> bool:
        while len(self._asked) > MAX_ASKED:
            del self._asked[next(iter(self._asked))]
        return now >= self._asked.get((robot, what), -1e9) + period

    async def _check(self, robot: str, address: Address, blob: bytes) -> None:
        known, operators = set(self._state.table), self._state.operators()

        def trusted() -> tuple[list[Entry], int, bool]:
            """The good ones, how many there are, and whether one has a false signature."""
            new, good = [one for one in decode_table(blob) if one not in known], list[Entry]()
            for entry in new:
                if self._state.is_trusted(entry):
                    good.append(entry)
                elif operators is not None and entry.manifest.issuer in operators:
                    return good, len(new), True
            return good, len(new), False

        def refuse(code: Code, text: str) -> None:
            log.warning("%s: %s", robot, text)

        with self._drops.refusing(f"shared/{TABLE}", refuse):
            try:
                good, count, is_false = await asyncio.to_thread(trusted)
            finally:
                self._checking = None
            if is_false:
                self._false[robot] = boottime() + FALSE_PERIOD
            if len(good) < count:
                log.warning(
                    "%s has behaviours that no operator of the roster signed; they are left out",
                    robot,
                )
            if good:
                self._store.merge(good)
                self._pull_code(robot, address, boottime())

    def _on_code(self, robot: str, entry: Entry, blob: Blob, why: str) -> None:
        if blob is None:
            log.info("%s is not pulled yet: %s", entry.manifest.label, why)
        elif not self._store.is_busy:
            self._on_taken(robot, entry)
            self._store.take(entry, blob, robot)

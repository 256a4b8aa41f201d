"""Signs what a daemon of a secured swarm sends, and verifies what it hears."""

from __future__ import annotations

import logging
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.token_bucket import TokenBucket
from swarmd.daemon.store import StateFile
from swarmd.network.carriers.inbound_queue import DropCounter
from swarmd.network.datagram import KIND_OFFSET, Ack, Address, Beacon, Kind, Stop, unpack
from swarmd.network.members.admission import Admission
from swarmd.network.signature import PREVIOUS_TIME, Author, Flaw, Previous, Trust, generation_of
from swarmd.network.spread.asks import Asks
from swarmd.network.stops.stop_freshness import REPLAYED
from swarmd.security.identity import Identity

log = logging.getLogger(__name__)

NOTICE_PERIOD = 60.0  # s between two lines about refused datagrams
REPLAY_PERIOD = 10.0  # s between two lines about replayed stops
REFUSAL_RATE = 20.0  # answers a second to replayed stops
HINT_PERIOD = 5.0  # s between two hints that a newer roster exists, to keep links few
HINT_AGAIN = 15.0  # s between two hints of one host: others must have their turn
_STRANGE = (Flaw.UNSIGNED, Flaw.FORGED, Flaw.ROLE)


class StopCounters(Struct, frozen=True):
    """The greatest counter of stops of each origin."""

    counters: dict[bytes, int] = {}


class DatagramGuard:
    """The keys of a daemon at work.

    `counters`: the file that keeps the greatest counters of stops. `on_event` takes a line for the
    log, `on_newer_roster` the name, address and generation of a beacon that may be of a robot with
    a newer roster; that is not proven.
    """

    def __init__(
        self,
        identity: Identity,
        tag: bytes,
        lease: float,
        counters: Path,
        drops: DropCounter,
        *,
        on_event: Callable[[str], None],
        on_newer_roster: Callable[[str, Address, int], None],
    ) -> None:
        self._identity = identity
        self._tag = tag
        self._file = StateFile(counters, StopCounters, "replayed stops may count")
        self._drops = drops
        self._on_event, self._on_newer_roster = on_event, on_newer_roster
        self._trust = Trust.of(identity)
        self._written: Mapping[bytes, int] = self._file.read().counters
        self._writing = threading.Lock()
        self._refusals = TokenBucket(REFUSAL_RATE, REFUSAL_RATE)
        self._strange: Counter[str] = Counter()
        self._asks = Asks(HINT_AGAIN, window=HINT_PERIOD)  # hosts that gave a hint
        self._noticed_at = self._replay_at = -1e9
        self.admission = Admission(
            identity.name,
            identity.roster.robots,
            lease,
            lambda: secrets.randbits(53) or 1,
            self._written,
        )

    def take(self, identity: Identity) -> None:
        """Use another generation of the roster; stops of the one before count for a while."""
        old = self._identity
        previous = Previous(old.datagram_keys, old.roster, boottime() + PREVIOUS_TIME)
        is_newer = identity.roster.generation > old.roster.generation
        self._trust = Trust.of(identity, previous if is_newer else None)
        self._identity = identity
        self._asks = Asks(HINT_AGAIN, window=HINT_PERIOD)

    def sign(self, payload: bytes, asker: Author | None = None) -> bytes:
        """A datagram with its signature. Raises CodecError if it gets too long."""
        return self._trust.signer.sign(payload, asker)

    def author_of(self, payload: bytes, source: Address, now: float) -> Author | None:
        """The author of a datagram; None, counted, if it does not count."""
        found = self._trust.verifier.verify(payload, now)
        if not isinstance(found, Flaw):
            return found
        self.count(found, source, now)
        if found is Flaw.NEWER and payload[KIND_OFFSET] == Kind.BEACON:
            self._hint(payload, source, now)
        return None

    def count(self, flaw: Flaw, source: Address, now: float) -> None:
        """Count what does not count, with a line in the log if its sender may not send it."""
        self._drops.add(f"datagram:{flaw}")
        if flaw not in _STRANGE:
            return
        self._strange[flaw] += 1
        if now - self._noticed_at >= NOTICE_PERIOD:
            self._noticed_at = now
            kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(self._strange.items()))
            self._strange.clear()
            self._on_event(f"refused datagrams: {kinds}; {_shown(source)}")

    def proven(self, ack: Ack, stop: Stop) -> Ack:
        """The ack with its proof for the operator of the stop."""
        return replace(ack, proof=self._trust.signer.proof(ack, stop.operator))

    def refusal(self, stop: Stop, source: Address, ack: Ack, now: float) -> Ack | None:
        """The answer to a replayed stop; None: none is due."""
        self._drops.add("datagram:replayed_stop")
        if now - self._replay_at >= REPLAY_PERIOD:
            self._replay_at = now
            self._on_event(f"refused a replayed {stop.verb} of {stop.operator}; {_shown(source)}")
        if not self._refusals.take(1.0, now):
            return None
        text = "a later stop of this operator was heard before"
        return self.proven(replace(ack, code="refused", refusal=REPLAYED, text=text), stop)

    def has_new_counters(self) -> bool:
        """True, once, if the counters of stops have changed: then call `write_counters`."""
        counters = self.admission.stops.counters
        if counters == self._written:
            return False
        self._written = dict(counters)
        return True

    def write_counters(self) -> None:
        """Write the counters for the next life of the daemon; on a thread, since disks are slow."""
        try:
            with self._writing:
                self._file.write(StopCounters(dict(self._written)))
        except OSError as error:
            log.warning(
                "%s cannot be written (%s): a restart forgets stops", self._file.path, error
            )

    def _hint(self, payload: bytes, source: Address, now: float) -> None:
        if not self._asks.take(source[0], now, "all"):
            return
        try:
            body = unpack(self._tag, payload)
        except CodecError:
            return
        if isinstance(body, Beacon) and body.robot != self._identity.name:
            self._on_newer_roster(body.robot, source, generation_of(payload))


def _shown(source: Address) -> str:
    return f"the last from {source[0]}:{source[1]}"

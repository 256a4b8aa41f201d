"""Signs the datagrams of a daemon in a secured swarm, and verifies received datagrams."""

from __future__ import annotations

import logging
import math
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.names import owner_of
from swarmd.core.token_bucket import TokenBucket
from swarmd.daemon.store import StateFile
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import KIND_OFFSET, Ack, Address, Beacon, Kind, Stop, unpack
from swarmd.link.keys.identity import Identity
from swarmd.link.members.admission import Admission
from swarmd.link.signature import PREVIOUS_TIME, Author, Flaw, Previous, Trust, generation_of
from swarmd.link.spread.asks import Asks
from swarmd.link.stops.stop_freshness import REPLAYED

log = logging.getLogger(__name__)

NOTICE_PERIOD = 60.0  # s between two lines about refused datagrams
REPLAY_PERIOD = 10.0  # s between two lines about replayed stops
REFUSAL_RATE = 20.0  # answers a second to replayed stops, and to those without a permit
HINT_PERIOD = 5.0  # s between two hints of a newer roster that are followed, to keep links few
HINT_AGAIN = 15.0  # s until a host's next hint is followed; meanwhile hints of other hosts are
_STRANGE = (Flaw.UNSIGNED, Flaw.FORGED, Flaw.ROLE)


class StopCounters(Struct, frozen=True):
    """By origin (an operator's installation): the greatest counter of its stops."""

    counters: dict[bytes, int] = {}


class DatagramGuard:
    """Signs and verifies the datagrams of a secured swarm with the keys of the present identity.

    A stop carries a counter that rises with each stop of its origin (an operator's installation).
    `StopFreshness` keeps the greatest counter of each origin, and refuses a stop that was replayed.
    The file `counters` keeps the greatest counters for the next start.
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
        """Read the greatest counters of stops from the file `counters`.

        `lease`: s of silence after which a peer has failed. `on_event(text)`: a warning for the
        operator. `on_newer_roster(robot, address, generation)` is called if a beacon shows a
        newer roster; the present keys cannot verify this beacon.
        """
        self._identity = identity
        self._tag = tag
        # `lost`: what the log says that an unreadable file leads to.
        self._file = StateFile(counters, StopCounters, lost="replayed stops may count")
        self._drops = drops
        self._on_event = on_event
        self._on_newer_roster = on_newer_roster
        self._trust = Trust.of(identity)
        # The counters that are on disk now.
        self._written: Mapping[bytes, int] = self._file.read().counters
        self._writing = threading.Lock()  # guards the file, which a thread writes
        self._refusals = TokenBucket(REFUSAL_RATE, REFUSAL_RATE)  # of replayed stops
        self._denials = TokenBucket(REFUSAL_RATE, REFUSAL_RATE)  # of stops without a permit
        self._strange: Counter[str] = Counter()  # refused datagrams by flaw, until the next warning
        # A hint is a beacon of a newer roster, which cannot be verified: anyone can send hints.
        # `_asks` limits how often hints lead to `on_newer_roster`.
        self._asks = Asks(HINT_AGAIN, window=HINT_PERIOD)
        self._noticed_at = -math.inf  # s; the last warning of refused datagrams
        self._replay_at = -math.inf  # s; the last warning of a replayed stop
        # Decides which robots count as members, and which stops are replays.
        self.admission = Admission(
            identity.name, identity.roster.robots, lease, _question_number, self._written
        )

    def take(self, identity: Identity) -> None:
        """Use the keys of `identity`.

        After a newer roster, stops signed with keys of the previous roster stay valid for
        PREVIOUS_TIME.
        """
        before = self._identity
        previous = Previous(before.datagram_keys, before.roster, boottime() + PREVIOUS_TIME)
        is_newer = identity.roster.generation > before.roster.generation
        self._trust = Trust.of(identity, previous if is_newer else None)
        self._identity = identity
        self._asks = Asks(HINT_AGAIN, window=HINT_PERIOD)

    def sign(self, payload: bytes, asker: Author | None = None) -> bytes:
        """The datagram with its signature; CodecError if it gets too long.

        `asker`: the operator or viewer whom the datagram answers.
        """
        return self._trust.signer.sign(payload, asker)

    def author_of(self, payload: bytes, source: Address, now: float) -> Author | None:
        """The verified author of a datagram; None if the datagram is refused, which is counted."""
        author = self._trust.verifier.verify(payload, now)
        if not isinstance(author, Flaw):
            return author
        flaw = author
        self.count(flaw, source, now)
        if flaw is Flaw.NEWER and payload[KIND_OFFSET] == Kind.BEACON:
            self._hint(payload, source, now)
        return None

    def count(self, flaw: Flaw, source: Address, now: float) -> None:
        """Count a refused datagram; log it, at most once per NOTICE_PERIOD, if `flaw` is strange.

        Strange flaws are those of senders that may not send such a datagram.
        """
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
        """The ack with a proof by which the operator of the stop sees that this robot made it."""
        return replace(ack, proof=self._trust.signer.proof(ack, owner_of(stop.operator)))

    def refusal(self, stop: Stop, source: Address, ack: Ack, now: float) -> Ack | None:
        """The answer to a replayed stop; None beyond REFUSAL_RATE."""
        self._drops.add("datagram:replayed_stop")
        if now - self._replay_at >= REPLAY_PERIOD:
            self._replay_at = now
            self._on_event(f"refused a replayed {stop.verb} of {stop.operator}; {_shown(source)}")
        if not self._refusals.take(1.0, now):
            return None
        text = "a later stop of this operator was heard before"
        return self.proven(replace(ack, code="refused", refusal=REPLAYED, text=text), stop)

    def denial(self, stop: Stop, ack: Ack, now: float) -> Ack | None:
        """The answer to a stop that its permit does not permit; None beyond REFUSAL_RATE."""
        self._drops.add("datagram:permit")
        return self.proven(ack, stop) if self._denials.take(1.0, now) else None

    def has_new_counters(self) -> bool:
        """True once after each change of the counters; the caller then calls `write_counters`."""
        counters = self.admission.stops.counters
        if counters == self._written:
            return False
        self._written = dict(counters)
        return True

    def write_counters(self) -> None:
        """Write the counters for the next start of the daemon; blocks, so called in a thread."""
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


def _question_number() -> int:
    """A random number for a question to a peer; above 0, since 0 means no question.

    The answer repeats the number, so that a replayed answer does not count.
    """
    return secrets.randbits(53) or 1


def _shown(source: Address) -> str:
    return f"the last from {source[0]}:{source[1]}"

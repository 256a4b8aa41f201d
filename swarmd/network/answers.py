"""What an operator or viewer takes from the robots of a secured swarm. Pure.

Each look asks often, so that a robot counts once it has answered, as in `liveness.py`. Answers
count only if the robot itself signed them for this operator; acks only with its proof for this
operator, also if another robot hands them on. An identity that is older than a robot has no key of
that pair: then the signature of any robot is enough, and the robot is among `unproven`.
"""

from __future__ import annotations

from collections.abc import Callable

from swarmd.network.datagram import (
    Ack,
    Address,
    Beacon,
    ClockReply,
    Datagram,
    Flag,
    GoalReport,
    MemberList,
    only_names,
)
from swarmd.network.liveness import Liveness
from swarmd.network.signature import Flaw, Trust, generation_of
from swarmd.security.identity import Identity

HINT_PERIOD = 5.0  # s between two hints


class Answers:
    """The keys of an operator or viewer at work.

    `on_newer_roster` takes the name, address and generation of a robot that may have a newer
    roster. `outdated`: the robots that were heard with an older one, with their addresses; both are
    not proven. `unproven`: the robots of which this identity has no key.
    """

    def __init__(
        self,
        identity: Identity,
        lease: float,
        on_newer_roster: Callable[[str, Address, int], object] = lambda *_: None,
    ) -> None:
        self._trust = Trust.of(identity)
        self._names = frozenset(identity.roster.robots)
        self._on_newer_roster = on_newer_roster
        self._hint_at = -1e9
        # Its own questions are numbered by the operator, which notes them.
        self.liveness = Liveness(lease, lambda: 0)
        self.unproven: set[str] = set()
        self.outdated: dict[str, Address] = {}

    def sign(self, payload: bytes) -> bytes:
        """A datagram with the signature of this name."""
        return self._trust.signer.sign(payload)

    def admit(self, body: Datagram, payload: bytes, source: Address, now: float) -> Datagram | None:
        """What of a datagram counts; None: nothing."""
        if isinstance(body, Ack):
            return self._ack(body, payload, now)
        author = self._trust.verifier.verify(payload, now)
        if isinstance(author, Flaw):
            self._note_generation(author, body, payload, source, now)
            return None
        match body:
            case Beacon() if body.robot in self._names:
                self.outdated.pop(body.robot, None)
                return body if self._is_fresh(body, payload, now) else None
            case MemberList() if self.liveness.is_own_echo(body.echo, now):
                is_known = self.liveness.knows(body.robot, body.instance)
                return (
                    only_names(body, self._names)
                    if is_known and self._is_own(body, payload)
                    else None
                )
            case ClockReply() | GoalReport() if body.robot in self._names:
                return body if self._is_own(body, payload) else None
        return None

    def _is_fresh(self, beacon: Beacon, payload: bytes, now: float) -> bool:
        if beacon.flags & Flag.JOINING:
            return False
        is_answer = self.liveness.is_own_echo(beacon.echo, now)
        if is_answer and not self._is_own(beacon, payload):
            return False
        return self.liveness.on_beacon(beacon, now) is None

    def _is_own(self, body: Beacon | MemberList | ClockReply | GoalReport, payload: bytes) -> bool:
        """True if that robot answers this operator, as far as its keys can tell."""
        is_proven = self._trust.verifier.is_answer_of(body.robot, payload)
        if is_proven is None:
            self.unproven.add(body.robot)
        return is_proven is not False

    def _ack(self, ack: Ack, payload: bytes, now: float) -> Ack | None:
        is_proven = self._trust.verifier.is_proven(ack)
        if is_proven is not None or ack.robot not in self._names:
            return ack if is_proven else None
        if isinstance(self._trust.verifier.verify(payload, now), Flaw):
            return None
        self.unproven.add(ack.robot)
        return ack

    def _note_generation(
        self, flaw: Flaw, body: Datagram, payload: bytes, source: Address, now: float
    ) -> None:
        if not isinstance(body, Beacon):
            return
        if flaw is Flaw.OLDER and body.robot in self._names:
            self.outdated[body.robot] = source
        elif flaw is Flaw.NEWER and now - self._hint_at >= HINT_PERIOD:
            self._hint_at = now
            self._on_newer_roster(body.robot, source, generation_of(payload))

"""Which datagrams of robots an operator or viewer of a secured swarm accepts. Pure.

1. A robot counts as alive once it has answered a solicit of this operator (`beacon_freshness.py`).
2. An answer is accepted only if the robot itself signed it for this operator.
3. Any robot of the roster may sign the datagram of an ack, since robots hand acks on. The ack must
   contain a proof for this operator, which only the acking robot can make.
4. Operator and robot share a key. An identity that was made before the robot was added lacks this
   key. Datagrams of the robot are then refused until the robot has handed over the key on a link
   (`RosterFollower` of roster.py).

A swarm without keys does not import this module, nor the signatures that it checks: a command must
start fast.
"""

from __future__ import annotations

from collections.abc import Callable

from swarmd.core.bounds import keep_newest
from swarmd.link.datagram import (
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
from swarmd.link.keys.identity import Identity
from swarmd.link.members.beacon_freshness import BeaconFreshness
from swarmd.link.signature import Flaw, Trust, generation_of

HINT_PERIOD = 5.0  # s between two calls of a callback; for missing keys, of each robot and source
MAX_HINTS = 4096


class OperatorAdmission:
    """Signs the operator's datagrams, and checks the datagrams of robots.

    `on_newer_roster(robot, address, generation)`: a robot may have a newer roster.
    `on_missing_key(robot, address)`: this identity has no key that it shares with the robot.
    `outdated`: addresses of robots that were heard with an older roster. `unproven`: addresses of
    robots whose key is missing. No signature proves these addresses: only a link to an address
    shows whether the named robot is there.
    """

    def __init__(
        self,
        identity: Identity,
        lease: float,
        on_newer_roster: Callable[[str, Address, int], object] = lambda *_: None,
        on_missing_key: Callable[[str, Address], object] = lambda *_: None,
    ) -> None:
        self._trust = Trust.of(identity)
        self._names = frozenset(identity.roster.robots)
        self._on_newer_roster = on_newer_roster
        self._on_missing_key = on_missing_key
        # The last calls of `on_newer_roster`: for robots of the own roster, for other names.
        self._known_hint_at = -1e9
        self._unknown_hint_at = -1e9
        self._key_asked_at: dict[tuple[str, Address], float] = {}  # the last hints of missing keys
        # OperatorDatagrams numbers the questions, and notes each number here.
        self.freshness = BeaconFreshness(lease, lambda: 0)
        self.unproven: dict[str, Address] = {}
        self.outdated: dict[str, Address] = {}

    def take_keys(self, identity: Identity) -> None:
        """Use an identity with the same roster, and with keys of more robots."""
        self._trust = Trust.of(identity)
        has_key_of = self._trust.verifier.has_key_of
        self.unproven = {n: address for n, address in self.unproven.items() if not has_key_of(n)}

    def sign(self, payload: bytes) -> bytes:
        """A datagram with the signature of this name."""
        return self._trust.signer.sign(payload)

    def admit(self, body: Datagram, payload: bytes, source: Address, now: float) -> Datagram | None:
        """Check a robot's datagram; returns the datagram, or None if it is refused.

        `payload`: the bytes of the datagram with its signature. `source`: the address of the
        sender. A member list comes back without robots that the roster lacks. Refused datagrams:

        1. a datagram with a wrong signature, or signed with the keys of another roster,
        2. a datagram in the name of a robot that the roster lacks,
        3. an ack or beacon of a robot whose key this identity lacks,
        4. an ack without a valid proof of the robot that acks,
        5. a beacon of a robot that does not own its id,
        6. a beacon or member list that may be replayed,
        7. an answer that its robot did not sign for this operator,
        8. a datagram of any other kind.
        """
        author = self._trust.verifier.verify(payload, now)
        if isinstance(author, Flaw):
            self._note_generation(author, body, payload, source, now)
            return None
        match body:
            case Ack() if body.robot in self._names:
                is_accepted = self._is_proven(body, source, now)
            case Beacon() if body.robot in self._names:
                self.outdated.pop(body.robot, None)  # its signature is of the present roster
                has_key = self._has_key(body.robot, source, now)
                is_accepted = has_key and self._is_fresh(body, payload, now)
            case MemberList() if self.freshness.is_own_echo(body.echo, now):
                # Only beacons of robots on the roster make an instance known.
                is_known = self.freshness.knows(body.robot, body.instance)
                is_accepted = is_known and self._is_own(body, payload)
                body = only_names(body, self._names)
            case ClockReply() | GoalReport() if body.robot in self._names:
                is_accepted = self._is_own(body, payload)
            case _:
                is_accepted = False
        return body if is_accepted else None

    def _is_proven(self, ack: Ack, source: Address, now: float) -> bool:
        """True if the acking robot has made the proof in the ack for this operator."""
        # The address of the acking robot is not known if another robot handed the ack on.
        robot_address = None if ack.via else source
        has_key = self._has_key(ack.robot, robot_address, now)
        return has_key and self._trust.verifier.is_proven(ack) is True

    def _is_fresh(self, beacon: Beacon, payload: bytes, now: float) -> bool:
        """True if the beacon's robot owns its id, and the beacon is no replay."""
        if beacon.flags & Flag.JOINING:
            return False
        is_answer = self.freshness.is_own_echo(beacon.echo, now)
        if is_answer and not self._is_own(beacon, payload):
            return False
        return self.freshness.on_beacon(beacon, now) is None

    def _is_own(self, body: Beacon | MemberList | ClockReply | GoalReport, payload: bytes) -> bool:
        """True if the robot named in the datagram signed it as an answer for this operator."""
        return self._trust.verifier.is_answer_of(body.robot, payload) is True

    def _has_key(self, robot: str, source: Address | None, now: float) -> bool:
        """True if this identity has the key that it shares with the robot; else asks for the key.

        A datagram does not prove its sender: any robot of the roster can make a datagram with the
        name `robot`. If the key is missing, `on_missing_key` is therefore called with `source`, the
        address of the sender. A link to this address proves the name, and hands over the key.
        `source` None: the address of the robot is not known, and nothing is called.
        """
        if self._trust.verifier.has_key_of(robot):
            return True
        if source is not None:
            self.unproven[robot] = source
            if now - self._key_asked_at.get((robot, source), -1e9) >= HINT_PERIOD:
                keep_newest(self._key_asked_at, (robot, source), now, MAX_HINTS)
                self._on_missing_key(robot, source)
        return False

    def _note_generation(
        self, flaw: Flaw, body: Datagram, payload: bytes, source: Address, now: float
    ) -> None:
        """Note a beacon that is signed with the keys of an older or newer generation of the roster.

        Older: `outdated` gets the robot. Newer: `on_newer_roster` is called, at most once within
        HINT_PERIOD for all robots of the own roster, and once for all other names. So datagrams
        with invented names suppress no call for a robot of the roster.
        """
        if not isinstance(body, Beacon):
            return
        if flaw is Flaw.OLDER and body.robot in self._names:
            self.outdated[body.robot] = source
        elif flaw is Flaw.NEWER:
            is_known = body.robot in self._names
            if now - (self._known_hint_at if is_known else self._unknown_hint_at) < HINT_PERIOD:
                return
            if is_known:
                self._known_hint_at = now
            else:
                self._unknown_hint_at = now
            self._on_newer_roster(body.robot, source, generation_of(payload))

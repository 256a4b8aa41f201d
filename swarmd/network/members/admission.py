"""Which datagrams count in a secured swarm, and which are forged or replayed. Pure.

Verified datagrams and times go in. A signature shows the class of the signer. A datagram counts if
three conditions hold: its signer may send this kind, the robot in the datagram is on the roster,
and the datagram is fresh:

- beacons as `beacon_freshness.py` describes; a question is due for those that are unproven,
- messages, places, latches and goals of the instance that is the member now,
- latches with the digest of that member's newest beacon,
- member lists as answers to an own question,
- stops as `stop_freshness.py` describes, in the name of the operator that signed them; robots hand
  them on in the operator's name, with their own signature.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from swarmd.network.datagram import (
    Ack,
    Beacon,
    ClockQuery,
    ClockReply,
    Datagram,
    Flag,
    GoalReport,
    Latches,
    MemberList,
    Message,
    Place,
    RunLease,
    Solicit,
    Stop,
    Swarm,
    only_names,
)
from swarmd.network.members.beacon_freshness import BeaconFreshness
from swarmd.network.members.membership import Membership
from swarmd.network.signature import Author, Flaw
from swarmd.network.stops.stop_freshness import StopFreshness
from swarmd.security.roster import Role

_ROBOTS = frozenset({Role.ROBOT})
_OPERATORS = frozenset({Role.OPERATOR})
_ALL = frozenset(Role)
SIGNERS: Mapping[type[Datagram], frozenset[Role]] = {
    Beacon: _ROBOTS,
    Solicit: _ALL,
    MemberList: _ROBOTS,
    Stop: frozenset({Role.ROBOT, Role.OPERATOR}),
    Ack: _ROBOTS,
    Latches: _ROBOTS,
    Message: _ROBOTS,
    Swarm: frozenset(),
    Place: _ROBOTS,
    ClockQuery: _ALL,
    ClockReply: _ROBOTS,
    GoalReport: _ROBOTS,
    RunLease: _OPERATORS,
}
"""The roles that may send each kind; `Swarm` is for readers without keys, and never signed."""


class Admission:
    """The datagrams that the robot `own` takes; `names`: the robots on the roster.

    `echoes` gives numbers that were never used before, `counters` those that `StopFreshness` kept.
    """

    def __init__(
        self,
        own: str,
        names: Collection[str],
        lease: float,
        echoes: Callable[[], int],
        counters: Mapping[bytes, int] | None = None,
    ) -> None:
        self._own = own
        self.names = frozenset(names)
        self.freshness = BeaconFreshness(lease, echoes)
        self.stops = StopFreshness(counters)

    def admit(
        self,
        body: Datagram,
        author: Author,
        now: float,
        membership: Membership,
        *,
        is_claiming: bool,
    ) -> Datagram | Flaw:
        """The part of the datagram that counts, or the flaw.

        `is_claiming`: this robot does not own its id yet, so that rivals matter.
        """
        if author.role not in SIGNERS[type(body)]:
            return Flaw.ROLE
        is_fresh = True
        match body:
            case Beacon():
                return self._beacon(body, now, is_claiming=is_claiming)
            case Stop():
                return body if _is_in_its_name(body, author) else Flaw.FORGED
            case RunLease():
                return body if body.operator == author.name else Flaw.FORGED
            case Solicit() | ClockQuery() | Swarm():
                return body
            case MemberList():
                is_fresh = self.freshness.is_own_echo(body.echo, now)
                is_fresh &= membership.is_present(body.robot, body.instance)
                body = only_names(body, self.names)
            case Message():
                is_fresh = membership.is_present(body.robot, body.instance)
                is_fresh &= self.freshness.is_new_message(body.robot, body.instance, body.sequence)
            case Place():
                is_fresh = membership.is_present(body.robot, body.instance)
                is_fresh = is_fresh and self.freshness.is_new_place(
                    body.robot, body.instance, body.sent
                )
            case Latches():
                is_fresh = membership.latches_of(body.robot, body.instance) == body.digest
            case GoalReport():
                is_fresh = membership.is_present(body.robot, body.instance)
            case Ack() | ClockReply():
                pass  # of stops and clocks that are under way
        return body if is_fresh else Flaw.REPEATED

    def _beacon(self, beacon: Beacon, now: float, *, is_claiming: bool) -> Datagram | Flaw:
        if beacon.robot not in self.names:
            return Flaw.FORGED
        if beacon.flags & Flag.JOINING and not (is_claiming and beacon.robot == self._own):
            return beacon  # the owner of the id answers the claim; others ignore it
        return self.freshness.on_beacon(beacon, now) or beacon


def _is_in_its_name(stop: Stop, author: Author) -> bool:
    """True if the operator signed the stop, or a robot that hands the stop on."""
    if author.role is Role.ROBOT:
        return stop.hops > 0
    return stop.hops == 0 and stop.operator == author.name

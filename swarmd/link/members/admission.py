"""Which datagrams a robot of a secured swarm accepts, and which are forged or replayed. Pure.

Datagrams come in with verified signatures. A signature shows the role of the signer. A datagram is
accepted if its signer's role may send this kind, the robot in the datagram is on the roster, and
the datagram is fresh. An *instance* is one life (start to end) of a robot's daemon. A datagram is
fresh if it is

- a beacon by the rules of `beacon_freshness.py`; the sender of an unproven beacon, which may be
  replayed, is asked for a new beacon,
- a message, place, kin report or goal from the instance that is the member now,
- latches from the instance that is the member now, with the digest of its newest beacon,
- a member list that answers a question of this robot,
- a stop by the rules of `stop_freshness.py`. A stop names the operator that signed it. A robot that
  relays a stop keeps the operator's name and signs with its own key.

A command of a hand is admitted from the name that it names, which may have a permit: the robot took
this name's request, and drops what it has heard before (`robot/hand.py`).

A run lease is admitted from the operator that it names. It prolongs a run only as far as the rules
of `lease_freshness.py` permit: a lease that may be replayed is handed to the robot, which says why
its run ends, and prolongs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from swarmd.core.names import owner_of
from swarmd.link.datagram import (
    Ack,
    Beacon,
    ClockQuery,
    ClockReply,
    Datagram,
    Drive,
    Flag,
    GoalReport,
    KinReport,
    Latches,
    MemberList,
    Message,
    Place,
    RunLease,
    Solicit,
    StatusPart,
    Stop,
    Swarm,
    only_names,
)
from swarmd.link.keys.roster import Role
from swarmd.link.members.beacon_freshness import BeaconFreshness
from swarmd.link.members.membership import Membership
from swarmd.link.signature import Author, Flaw
from swarmd.link.stops.stop_freshness import StopFreshness

_ROBOTS = frozenset({Role.ROBOT})
_OPERATORS = frozenset({Role.OPERATOR})
_ALL = frozenset(Role)
SIGNERS: Mapping[type[Datagram], frozenset[Role]] = {
    Beacon: _ROBOTS,
    Solicit: _ALL,
    MemberList: _ROBOTS,
    Stop: frozenset({Role.ROBOT, Role.OPERATOR, Role.PERMIT}),
    Ack: _ROBOTS,
    Latches: _ROBOTS,
    Message: _ROBOTS,
    Swarm: frozenset(),
    Place: _ROBOTS,
    ClockQuery: _ALL,
    ClockReply: _ROBOTS,
    GoalReport: _ROBOTS,
    RunLease: _OPERATORS,
    KinReport: _ROBOTS,
    StatusPart: frozenset(),
    Drive: frozenset({Role.OPERATOR, Role.PERMIT}),
}
"""The roles that may send each kind.

`Swarm` is for readers without keys, and never signed. No `StatusPart` is sent in a secured swarm,
where a status is read on encrypted links alone.
"""


class Admission:
    """The checks of the robot `own`.

    `names`: the robots on the roster. `lease`: s of silence after which a robot has failed.
    `echoes` returns the number of the next question, a number that was never used before.
    `counters`: by origin (random bytes that mark an operator's installation) the greatest counter
    of the stops that this robot heard in its earlier life (`StopFreshness`).
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
        """Check a datagram whose signature by `author` is verified; returns it, or its flaw.

        A flaw is a wrong role, a false author, or a datagram that is no longer fresh (a replay). A
        member list comes back without the robots that the roster lacks. Every other datagram comes
        back unchanged. `is_claiming`: this robot still claims its own id.
        """
        if author.role not in SIGNERS[type(body)]:
            return Flaw.ROLE
        match body:
            case Beacon():
                return self._beacon(body, now, is_claiming=is_claiming)
            case Stop():
                return body if _may_send_stop(body, author) else Flaw.FORGED
            case RunLease() | Drive():
                # `PeerProtocol` judges the age of a lease, `Hand` order and age of a command.
                return body if body.operator == author.name else Flaw.FORGED
            case Swarm() | StatusPart():
                return Flaw.ROLE  # no role may sign these
            case Solicit() | ClockQuery():
                return body  # a repeated question costs an answer, which is limited
            case Ack() | ClockReply():
                return body  # the caller drops an answer for which this robot does not wait
        if not self._is_fresh(body, now, membership):
            return Flaw.REPEATED
        return only_names(body, self.names) if isinstance(body, MemberList) else body

    def _is_fresh(
        self,
        body: MemberList | Message | Place | KinReport | Latches | GoalReport,
        now: float,
        membership: Membership,
    ) -> bool:
        """True if the datagram is of the instance that is the member now, and is no replay."""
        if not membership.is_present(body.robot, body.instance):
            return False
        match body:
            case MemberList():
                return self.freshness.is_own_echo(body.echo, now)
            case Message():
                return self.freshness.is_new_message(body.robot, body.instance, body.sequence)
            case Place():
                return self.freshness.is_later(body.robot, body.instance, Place, body.sent)
            case KinReport():
                sent = body.message.stamp
                return self.freshness.is_later(body.robot, body.instance, KinReport, sent)
            case Latches():  # must be those of the sender's newest beacon
                return membership.latches_of(body.robot, body.instance) == body.digest
            case GoalReport():
                return True

    def _beacon(self, beacon: Beacon, now: float, *, is_claiming: bool) -> Datagram | Flaw:
        """The beacon, or its flaw: the robot is not on the roster, or the beacon may be replayed.

        The beacon of a robot that claims its id need not be fresh: the owner of the id answers the
        claim, and other robots ignore the beacon. While this robot claims the same id, the beacon
        must be fresh, since the beacon decides which robot gets the id.
        """
        if beacon.robot not in self.names:
            return Flaw.FORGED
        is_rival = is_claiming and beacon.robot == self._own
        if beacon.flags & Flag.JOINING and not is_rival:
            return beacon
        return self.freshness.on_beacon(beacon, now) or beacon


def _may_send_stop(stop: Stop, author: Author) -> bool:
    """True if the author is the operator of the stop, or a robot that relays the stop."""
    if author.role is Role.ROBOT:
        return stop.hops > 0
    return stop.hops == 0 and owner_of(stop.operator) == author.name

"""The swarm as one operator sees it: the result of a look. Values only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.bounds import Word
from swarmd.core.messages import Epoch, Latch, Member, Presence, StatusHeader


class Contact(StrEnum):
    """How far an operator reached a member."""

    ANSWERED = "answered"
    NO_ANSWER = "no answer"  # heard, but without a status
    OTHER_VERSION = "other version"  # heard; its beacon has the state
    UNREACHABLE = "unreachable"  # another robot reports it as alive
    GONE = "gone"  # it failed or left


class SeenMember(Member, frozen=True, kw_only=True):
    """A member as one operator sees it.

    `age`: seconds since the member sent its figures, or was heard last, or failed, or left.
    """

    contact: Contact = Contact.ANSWERED
    by: Annotated[str, Meta(max_length=63)] = ""  # the robot that reported a member not heard here
    state: Word = ""  # the state that the last beacon showed
    wire: int | None = None  # the version of the member's requests
    version: Word = ""
    header: StatusHeader | None = None  # the readable part of the status of another version
    epoch: Epoch | None = None  # the epoch of the status or, without a status, of the newest beacon

    def __repr__(self) -> str:
        return f"SeenMember({self.robot!r}, {self.presence.value}, {self.contact.value})"


class MembersView(Struct, frozen=True):
    """The swarm as one operator sees it."""

    members: Mapping[str, SeenMember]  # all robots by id
    answered: frozenset[str] = frozenset()  # robots that answered this operator themselves
    roster: frozenset[str] = frozenset()
    duplicates: Mapping[str, tuple[str, ...]] = {}  # ids of several instances, with the instances
    round_trip: float = 0.0  # the longest round trip, in s
    loss: float = 0.0  # the largest share of solicits that a robot left unanswered, 0 to 1
    seconds: float = 0.0  # the duration of the look
    goal_generation: int = 0  # the greatest generation of a goal that a robot shows; 0 without
    programs: frozenset[str] = frozenset()  # Zenoh programs whose tokens a robot sees; no members
    # By robot and instance, the s by which its clock is at least ahead of the operator's clock.
    clock_leads: Mapping[tuple[str, str], float] = {}

    @property
    def alive(self) -> tuple[str, ...]:
        """The names of the robots that are alive."""
        members = self.members.items()
        return tuple(name for name, member in members if member.presence is Presence.ALIVE)

    @property
    def absent(self) -> tuple[str, ...]:
        """The names on the roster that no robot mentions."""
        return tuple(sorted(self.roster - self.members.keys()))

    @property
    def expected(self) -> frozenset[str]:
        """The robots that must answer: the roster, and all that did not leave in order."""
        members = self.members.items()
        there = {name for name, member in members if member.presence is not Presence.LEFT}
        return frozenset(there | self.roster)

    @property
    def missing(self) -> tuple[str, ...]:
        """The expected robots that did not answer."""
        return tuple(sorted(self.expected - self.answered))

    def is_in_reach(self, name: str) -> bool:
        """True if this operator hears the robot, or the robot has answered."""
        member = self.members.get(name)
        return member is not None and member.contact not in (Contact.UNREACHABLE, Contact.GONE)

    def of_other_version(self) -> tuple[str, ...]:
        """The robots that speak another version."""
        members = self.members.items()
        return tuple(name for name, member in members if member.contact is Contact.OTHER_VERSION)

    def epochs(self, names: Iterable[str]) -> dict[str, Epoch | None]:
        """The epoch of each robot, to quote in a request; None for a robot that was not heard.

        The epoch counts the changes of a robot (`core/messages.Epoch`): a robot that has changed
        since this view refuses the request.
        """
        members = ((name, self.members.get(name)) for name in names)
        return {name: member.epoch if member else None for name, member in members}

    def issue_times(self, targets: Mapping[str, Epoch | None], issued: float) -> dict[str, float]:
        """When a request was issued at the earliest, in s on the clock of each robot.

        `targets`: the robots, with the epochs that the request quotes. `issued`: s on the clock of
        the operator. Robots whose clock was not heard are left out.
        """
        instances = {(name, epoch.instance) for name, epoch in targets.items() if epoch}
        leads = self.clock_leads.items()
        return {pair[0]: max(issued + lead, 0.0) for pair, lead in leads if pair in instances}

    def latches(self, names: Iterable[str]) -> dict[str, Latch]:
        """The emergency stops that these robots hold, by id."""
        statuses = [self.members[name].status for name in names if name in self.members]
        return {
            key: latch for status in statuses if status for key, latch in status.latches.items()
        }


class Dials(StrEnum):
    """Which robots a look dials."""

    ALL = "all"  # a request follows, or what robots publish is watched
    UNTOLD = "untold"  # those whose status comes by no datagram
    NONE = "none"  # for a look that needs no status

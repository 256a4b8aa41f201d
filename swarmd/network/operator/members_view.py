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

    `age`: seconds since the figures were sent, or since it was heard last, or failed or left.
    `by`: the robot by whose word it is known, if it was not heard here. `state` is that of its
    beacon, `wire` the version of its requests, `header` what is read of another version's status.
    `epoch`: of its status, else of its newest beacon.
    """

    contact: Contact = Contact.ANSWERED
    by: Annotated[str, Meta(max_length=63)] = ""
    state: Word = ""
    wire: int | None = None
    version: Word = ""
    header: StatusHeader | None = None
    epoch: Epoch | None = None


class MembersView(Struct, frozen=True):
    """The swarm as one operator sees it.

    `members`: all robots by id. `answered`: those that answered for themselves, in this version
    with a status. `absent` robots are on the roster and nowhere else. `duplicates`: ids that
    several instances hold, with those instances. `round_trip` in s, the longest; `loss` the largest
    share of solicits that a robot left unanswered. `seconds`: how long the look took.
    `goal_generation`: the greatest one of a goal that a robot shows; 0 without a goal. `programs`:
    the Zenoh programs whose tokens a robot sees; they are no members.
    """

    members: Mapping[str, SeenMember]
    answered: frozenset[str] = frozenset()
    roster: frozenset[str] = frozenset()
    duplicates: Mapping[str, tuple[str, ...]] = {}
    round_trip: float = 0.0
    loss: float = 0.0
    seconds: float = 0.0
    goal_generation: int = 0
    programs: frozenset[str] = frozenset()

    @property
    def alive(self) -> tuple[str, ...]:
        """The names of the robots that are alive."""
        members = self.members.items()
        return tuple(name for name, one in members if one.presence is Presence.ALIVE)

    @property
    def absent(self) -> tuple[str, ...]:
        """The names on the roster that no robot mentions."""
        return tuple(sorted(self.roster - self.members.keys()))

    @property
    def expected(self) -> frozenset[str]:
        """The robots that must answer: the roster, and all that did not leave in order."""
        members = self.members.items()
        there = {name for name, one in members if one.presence is not Presence.LEFT}
        return frozenset(there | self.roster)

    @property
    def missing(self) -> tuple[str, ...]:
        """The expected robots that did not answer."""
        return tuple(sorted(self.expected - self.answered))

    def is_in_reach(self, name: str) -> bool:
        """True if this operator hears the robot, or has its answer."""
        member = self.members.get(name)
        return member is not None and member.contact not in (Contact.UNREACHABLE, Contact.GONE)

    def of_other_version(self) -> tuple[str, ...]:
        """The robots that speak another version."""
        members = self.members.items()
        return tuple(name for name, one in members if one.contact is Contact.OTHER_VERSION)

    def epochs(self, names: Iterable[str]) -> dict[str, Epoch | None]:
        """The epoch seen of each robot, to quote in a request; None if it was not heard."""
        members = ((name, self.members.get(name)) for name in names)
        return {name: one.epoch if one else None for name, one in members}

    def latches(self, names: Iterable[str]) -> dict[str, Latch]:
        """The emergency stops that these robots hold, by id."""
        statuses = [self.members[name].status for name in names if name in self.members]
        return {key: latch for one in statuses if one for key, latch in one.latches.items()}

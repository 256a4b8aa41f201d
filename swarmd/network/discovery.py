"""The members of a swarm as an operator finds them from tokens and daemons' views. Pure.

A fresh session's links are not complete when it opens: of 20 daemons one answers at once, all
after 20 to 40 ms. So `Discovery` collects views and tokens until every robot that any view or
token shows alive has answered for itself, and all views agree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from swarmd.core.messages import Epoch, Member, PeerView, Presence

# With one view, or views that do not agree yet, this long must pass without news, in s.
QUIET_TIME = 0.1
MAX_ROBOTS = 1024

_RANK = {Presence.ALIVE: 0, Presence.LEFT: 1, Presence.FAILED: 2}


@dataclass(frozen=True, slots=True)
class MembersView:
    """The swarm as one operator sees it.

    `members`: all robots by id; those in `answered` with their own status. `silent` robots are
    alive by a token or another robot's view, and did not answer. `absent` robots are on the roster
    and nowhere else. `duplicates`: ids that several instances hold, with those instances.
    """

    members: Mapping[str, Member]
    answered: frozenset[str] = frozenset()
    roster: frozenset[str] = frozenset()
    duplicates: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def alive(self) -> tuple[str, ...]:
        """The names of the robots that are alive."""
        members = self.members.items()
        return tuple(name for name, one in members if one.presence is Presence.ALIVE)

    @property
    def silent(self) -> tuple[str, ...]:
        """The names of the robots that are alive and did not answer."""
        return tuple(name for name in self.alive if name not in self.answered)

    @property
    def absent(self) -> tuple[str, ...]:
        """The names on the roster that no view or token mentions."""
        return tuple(sorted(self.roster - self.members.keys()))

    def epochs(self, names: Iterable[str]) -> dict[str, Epoch | None]:
        """The epoch seen of each robot, to quote in a request; None without an answer."""
        members = ((name, self.members.get(name)) for name in names)
        return {name: one.status.epoch if one and one.status else None for name, one in members}


class Discovery:
    """Collects views; `tokens` (robot -> instances) is what the own links show from the start."""

    def __init__(self, now: float, roster: Iterable[str] = ()) -> None:
        self._news = now
        self._views: dict[str, dict[str, PeerView]] = {}
        self._tokens: dict[str, set[str]] = {}
        self._gone: set[tuple[str, str]] = set()
        self._roster = set(roster)

    def on_token(self, robot: str, instance: str, is_there: bool, now: float) -> None:
        """The own session saw a token come or go."""
        if robot not in self._tokens and len(self._tokens) >= MAX_ROBOTS:
            return
        instances = self._tokens.setdefault(robot, set())
        if is_there:
            instances.add(instance)
            self._gone.discard((robot, instance))
        else:
            instances.discard(instance)
            self._gone.add((robot, instance))
            self._views.get(robot, {}).pop(instance, None)
        self._news = now

    def on_link(self, now: float) -> None:
        """The own session got a link: more may follow."""
        self._news = now

    def on_view(self, view: PeerView, now: float) -> None:
        """A daemon answered; only what is new counts as news."""
        known = self._views.setdefault(view.robot, {})
        if view.status.instance not in known:
            self._news = now
        known[view.status.instance] = view
        self._roster.update(view.roster)

    def holders(self, robot: str) -> frozenset[str]:
        """The instances whose tokens for this id the own links show now."""
        return frozenset(self._tokens.get(robot, ()))

    @property
    def answered(self) -> frozenset[str]:
        """The robots that have answered for themselves."""
        return frozenset(robot for robot, views in self._views.items() if views)

    @property
    def settled(self) -> frozenset[str]:
        """The robots of which every living instance has answered: both, if two hold one id."""
        alive = self._alive()
        return frozenset(
            robot for robot in self.answered if alive[robot] <= self._views[robot].keys()
        )

    @property
    def known(self) -> frozenset[str]:
        """Every name that a token, a view or the roster mentions."""
        said = {member.robot for view in self._all() for member in view.members}
        return frozenset(said | self._tokens.keys() | self.answered | self._roster)

    def is_complete(self, now: float) -> bool:
        """True once all alive robots answered, and the views agree or QUIET_TIME passed."""
        settled = self.settled
        if not settled or not self._alive().keys() <= settled:
            return False
        return self._agree(settled) or now - self._news >= QUIET_TIME

    def result(self) -> MembersView:
        """The members as known so far."""
        members: dict[str, Member] = {}
        for view in self._all():
            for member in view.members:
                known = members.get(member.robot)
                members[member.robot] = member if known is None else _more_certain(known, member)
        alive = self._alive()
        for robot, member in members.items():
            if member.presence is Presence.ALIVE and robot not in alive:
                members[robot] = replace(member, presence=Presence.FAILED, age=0.0)
        for robot in alive:
            members[robot] = self._alive_member(robot, members.get(robot))
        return MembersView(
            members=dict(sorted(members.items())),
            answered=self.answered,
            roster=frozenset(self._roster),
            duplicates={
                robot: tuple(sorted(some)) for robot, some in sorted(alive.items()) if len(some) > 1
            },
        )

    def _alive(self) -> dict[str, set[str]]:
        """The living instances of each robot, by tokens, others' views and own answers."""
        found: dict[str, set[str]] = {}
        for robot, instances in self._tokens.items():
            if instances:
                found[robot] = set(instances)
        for view in self._all():
            found.setdefault(view.robot, set()).add(view.status.instance)
            for member in view.members:
                is_gone = (member.robot, member.instance) in self._gone
                if member.presence is Presence.ALIVE and not is_gone:
                    found.setdefault(member.robot, set()).add(member.instance)
        return found

    def _all(self) -> list[PeerView]:
        return [view for views in self._views.values() for view in views.values()]

    def _agree(self, answered: frozenset[str]) -> bool:
        if len(answered) < 2:
            return False
        return all(answered <= _seen_alive(view) | {view.robot} for view in self._all())

    def _alive_member(self, robot: str, known: Member | None) -> Member:
        views = self._views.get(robot)
        if not views and known is not None and known.presence is Presence.ALIVE:
            return known
        status = next(reversed(views.values())).status if views else None
        instances = [status.instance] if status else sorted(self._tokens.get(robot, ()))
        return Member(
            robot=robot,
            instance=instances[0] if instances else "unknown",
            presence=Presence.ALIVE,
            age=known.age if views and known else 0.0,
            status=status,
        )


def _seen_alive(view: PeerView) -> frozenset[str]:
    return frozenset(member.robot for member in view.members if member.presence is Presence.ALIVE)


def _more_certain(one: Member, other: Member) -> Member:
    """Of two views of a robot: alive first, then `left` of the same instance, then the newer."""
    if Presence.ALIVE in (one.presence, other.presence) or one.instance == other.instance:
        return min(one, other, key=lambda member: (_RANK[member.presence], member.age))
    return min(one, other, key=lambda member: member.age)

"""A session of an operator for one call of a verb: looks and targets, queries, and goals.

`Session` looks at a swarm, and finds the targets of requests. `ask_robots` queries several robots
and changes nothing. `signed_goals` gives the goals of a look that count, `next_goal` the goal that
an operator sets next.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.closing import is_program_on
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, ConfigError, NetworkError, SwarmError, unknown
from swarmd.core.goal import MAX_UNSIGNED, Goal, KnownGoal, encode_goal, signed_part
from swarmd.core.messages import Status
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.spread.goal_sync import is_signed_goal
from swarmd.operator.session.members_view import Dials
from swarmd.operator.session.targets import Targets, named, remember, targets_of, unlabelled

if TYPE_CHECKING:
    from queue import SimpleQueue

    from swarmd.core.verbs import AnyRequest, Verb
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.session.members_view import MembersView, SeenMember
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome


# What a request has at least of `timeout`, in s: it is sent even if the look took too long.
LEAST_REQUEST_TIME = 0.02


class Session(Struct, frozen=True):
    """An operator's session for one verb, such as `run` or `members`.

    `timeout`: the longest time in s that the verb takes. `tell` takes lines for the user.
    `is_cancelled` returns True once the caller no longer waits; a verb that waits then ends.
    `is_owned` returns False once nobody waits for what a lease of this session keeps going: by
    default from the end of the main thread on.
    `began`: when the user typed, clicked or called the verb, in s on the clock since boot. A robot
    that was stopped since then refuses to start a run.
    """

    operator: Operator
    timeout: float | None = None
    tell: Callable[[str], object] = lambda text: None
    is_cancelled: Callable[[], bool] = lambda: False
    began: float = msgspec.field(default_factory=boottime)
    is_owned: Callable[[], bool] = is_program_on

    def look(
        self, *, is_request_next: bool = False, needs_status: bool = True, dials: Dials = Dials.ALL
    ) -> MembersView:
        """Query all members (a look), and tell the user which robots are missing.

        Returns once all expected robots have answered, or after the session's `timeout`.
        `is_request_next`: the look ends after half of `timeout`, so that `time_left` is left for a
        request. `needs_status` False: a robot has also answered if its beacon was heard.
        `dials`: see `Operator.members`; NONE: without statuses.

        NetworkError if no daemon was reached; the text names the swarms that were heard. SwarmError
        if a request is next, and its caller no longer waits.
        """
        timeout = self.timeout
        if timeout is not None and is_request_next:
            timeout /= 2.0
        view = self.operator.members(
            timeout=timeout, needs_status=needs_status and dials is not Dials.NONE, dials=dials
        )
        self.tell_notices()
        remember(self.operator.settings, view)
        if not view.members:
            raise unreachable(self.operator)
        self.tell_gaps(view, view.missing)
        if is_request_next:
            self.check_awaited()
        return view

    def check_awaited(self) -> None:
        """Raise SwarmError if the caller no longer waits or the connection is closed."""
        if self.is_cancelled():
            raise SwarmError(
                "not sent: its caller, its event loop or the main thread has ended, or the"
                " connection was closed"
            )

    def time_left(self, view: MembersView) -> float | None:
        """Seconds of `timeout` that the look has left for a request; None without `timeout`."""
        if self.timeout is None:
            return None
        return max(self.timeout - view.seconds, LEAST_REQUEST_TIME)

    def target(self, targets: Targets, *, needs_status: bool) -> TargetedView:
        """A look, and the targets of requests; RequestError if there are none.

        Half of `timeout` is left for requests. Targets by label need statuses in any case.
        """
        view = self.look(is_request_next=True, needs_status=needs_status or bool(targets.labels))
        names = targets_of(view, targets)
        return TargetedView(self, view, names, unlabelled(view, targets))

    def named_now(self, targets: Targets) -> Targets:
        """The targets with labels replaced by names, by a look now.

        For verbs that follow robots.
        """
        return named(self.look(), targets) if targets.labels else targets

    def tell_awaited(self, view: MembersView, targets: Targets) -> None:
        """Report whom a following verb waits for: any robot, or a name that no robot has."""
        known = view.members.keys() | view.roster
        if not view.members:
            self.tell("no robot is heard yet")
        for glob in targets.names if known else ():
            if not Targets((glob,)).matching(known):
                self.tell(f"{unknown('robot', glob, known)}; waits for it")

    def tell_notices(self) -> None:
        """Report the operator's notices about rosters."""
        for text in self.operator.notices:
            self.tell(text)
        self.operator.notices.clear()

    def tell_gaps(self, view: MembersView, missing: Iterable[str]) -> None:
        """Report the expected robots that did not answer, and what is known of them."""
        lines = [gap(view, name) for name in missing]
        if lines:
            self.tell(f"view not complete: {'; '.join(lines)}")


class TargetedView(Struct, frozen=True):
    """The target robots `names` of a verb's requests, and the look `view` that showed them.

    `unlabelled`: robots whose labels are not known, so that they may be targets of a label.
    """

    session: Session
    view: MembersView
    names: tuple[str, ...]
    unlabelled: tuple[str, ...] = ()

    @property
    def operator(self) -> Operator:
        """The operator of the session."""
        return self.session.operator

    @property
    def time_left(self) -> float | None:
        """Seconds of the timeout that the look has left."""
        return self.session.time_left(self.view)

    def request(
        self, kind: type[AnyRequest], names: Collection[str] | None = None, **fields: Any
    ) -> Outcome:
        """Send a request to all targets, or to `names`, in the time that is left; the outcome."""
        epochs = self.view.epochs(self.names if names is None else names)
        began = self.session.began
        return self.operator.request(kind, epochs, timeout=self.time_left, issued=began, **fields)

    def counted(self, outcome: Outcome) -> Outcome:
        """The outcome with the `unlabelled` robots: its exit code is then PARTIAL at best."""
        return replace(outcome, unlabelled=self.unlabelled)


def unreachable(operator: Operator, sent: str = "") -> NetworkError:
    """The error for a swarm in which no robot was reached; `sent`: what was sent nevertheless."""
    text = f"no daemon of swarm {operator.settings.swarm!r} can be reached{sent}"
    return NetworkError(f"{text}{other_swarms(operator)}")


def other_swarms(operator: Operator) -> str:
    """The other swarms that were heard, in words, when no robot was reached."""
    swarm = operator.settings.swarm
    profile = operator.settings.profile
    found = operator.swarms()
    if swarm in found:
        keys = "has no keys for it (--identity)" if operator.identity is None else "has other keys"
        return f"; there is a swarm of that name, and this swarmctl {keys} or another profile"
    if found:
        return f"; there are the swarms: {', '.join(found)} (see --swarm)"
    start = "swarmd, or `swarmctl sim up` for a simulated swarm" if profile == "dev" else "swarmd"
    return f", nor any other swarm {where(operator)}; start {start}; or see --profile"


def where(operator: Operator) -> str:
    """The network in which an operator looks, in words."""
    settings = operator.settings
    if settings.profile == "routed":
        return f"through {', '.join(settings.routers)}"
    return "on this machine" if settings.profile == "dev" else f"by {settings.interface}"


def gap(view: MembersView, name: str) -> str:
    """What is known of a robot that did not answer, in words."""
    from swarmd.operator.texts.why import absence  # most looks lack no robot

    return f"{name} {absence(view.members.get(name))}"


ASK_TIME = 5.0  # s for an answer, without a timeout
MAX_ANSWER = 512 * 1024  # bytes of an answer, at most


class Answer(Protocol):
    """An answer with the name of its robot."""

    @property
    def robot(self) -> str:
        """The name of the robot in the answer."""
        ...


T = TypeVar("T", bound=Answer)
_status = Decoder(Status)


def ask_robots(
    session: Session, robots: Iterable[str], verb: Verb[Any, T], question: Struct | None = None
) -> dict[str, T]:
    """The answers to a query, by robot. Reports an answer that cannot be read to `session.tell`."""
    decode = Decoder(verb.answer, MAX_ANSWER)
    answers = {}
    payload = b"" if question is None else encode(question)
    timeout = session.timeout or ASK_TIME
    payloads = session.operator.ask_all(robots, verb.name, payload, timeout=timeout)
    for robot, answer in sorted(payloads.items()):
        try:
            read = decode(answer)
        except CodecError as error:
            session.tell(f"{robot}: its answer cannot be read: {error}")
            continue
        if read.robot != robot:
            session.tell(f"{robot}: its answer is in the name of {read.robot}, and is left out")
            continue
        answers[robot] = read
    return answers


@contextmanager
def statuses_of(operator: Operator) -> Iterator[SimpleQueue[Status]]:
    """Subscribe to the statuses of robots within the `with` block; `next_status` reads them."""
    from queue import SimpleQueue

    news: SimpleQueue[Status] = SimpleQueue()

    def on_status(robot: str, payload: bytes) -> None:
        status = _status(payload)
        if status.robot == robot:
            news.put(status)

    operator.watch("status", on_status)
    try:
        yield news
    finally:
        operator.unwatch("status")


def next_status(news: SimpleQueue[Status], seconds: float) -> Status | None:
    """The next status; None if no status comes within `seconds`."""
    from queue import Empty

    try:
        return news.get(timeout=seconds)
    except Empty:
        return None


def in_reach(view: MembersView, robots: Iterable[str]) -> tuple[str, ...]:
    """The robots of a look that can be asked; unreachable robots are not waited for."""
    return tuple(robot for robot in robots if view.is_in_reach(robot))


MAX_GENERATION = 2**32 - 1
_MAX_ISSUER = 63


def next_goal(operator: Operator, view: MembersView, **fields: Any) -> Goal:
    """A goal with these `fields`, of a greater generation than all goals in `view`.

    Raises ConfigError if the goal is too long, or cannot be signed in a secured swarm.
    """
    goal = Goal(
        generation=next_generation(operator, view),
        issuer=operator.name[:_MAX_ISSUER],
        id=os.urandom(6).hex(),
        **fields,
    )
    return signed_again(operator, goal)


def next_generation(operator: Operator, view: MembersView) -> int:
    """The generation for a new goal: the greatest generation of the goals in `view`, plus 1.

    In a secured swarm a generation above MAX_UNSIGNED counts only if its goal is signed: a robot
    that was taken over may show any generation. A generation up to MAX_UNSIGNED always counts: up
    to there, robots also hold unsigned goals that only stop robots (`GoalCheck`). Raises
    ConfigError beyond MAX_GENERATION.
    """
    greatest = view.goal_generation
    if operator.identity is not None and greatest > MAX_UNSIGNED:
        members = signed_goals(view, operator.identity).members.values()
        statuses = [member.status for member in members if member.status is not None]
        goals = [status.goal.held for status in statuses if status.goal is not None]
        signed = (held.goal.generation for held in goals if held is not None)
        greatest = max((MAX_UNSIGNED, *signed))  # a tuple: there may be no signed goal
    if greatest >= MAX_GENERATION:
        raise ConfigError(
            f"a robot shows a goal of the last generation, {MAX_GENERATION}; no goal can follow"
            " it: revoke the operator who set it, or, without keys, remove `goal` from the state"
            " folders of the robots and restart them"
        )
    return greatest + 1


def signed_again(operator: Operator, goal: Goal, **changes: Any) -> Goal:
    """The goal with changes, signed again in a secured swarm. Raises ConfigError as `next_goal`.

    The goal keeps its id, so that `undo` takes both versions as one goal.
    """
    goal = replace(goal, **changes)
    goal = goal if operator.identity is None else sign_goal(goal, operator.identity)
    try:
        encode_goal(goal)
    except CodecError as error:
        raise ConfigError(str(error)) from error
    return goal


def sign_goal(goal: Goal, identity: Identity) -> Goal:
    """The goal with the signature of an operator."""
    from swarmd.link.keys.private_keys import load_private_key

    key = load_private_key(identity.key)
    return replace(goal, signature=sign(key, Purpose.GOAL, signed_part(goal)))


def signed_goals(view: MembersView, identity: Identity | None) -> MembersView:
    """`view` with None for each reported goal whose issuer's signature is false or missing.

    A robot reports its goals in its status: the goal that it holds, its own goal, and the goal
    before. A stolen robot may report false goals. An operator must not show such goals as goals of
    the swarm, and must never sign them. `identity` None: the swarm has no keys, and `view` is
    returned unchanged. Verifying a signature takes some 4 ms, so that each goal is verified once.
    """
    if identity is None:
        return view
    public_key_of = identity.roster.operators.get

    @cache
    def is_signed(encoded: bytes) -> bool:
        return is_signed_goal(msgspec.msgpack.decode(encoded, type=Goal), public_key_of)

    def signed_or_none(goal: Goal | None) -> Goal | None:
        return goal if goal is not None and is_signed(msgspec.msgpack.encode(goal)) else None

    def known_or_none(known: KnownGoal | None) -> KnownGoal | None:
        return known if known is not None and signed_or_none(known.goal) is not None else None

    def with_signed_goals(member: SeenMember) -> SeenMember:
        if member.status is None or member.status.goal is None:
            return member
        reported = member.status.goal
        signed = replace(
            reported,
            held=known_or_none(reported.held),
            own=known_or_none(reported.own),
            before=signed_or_none(reported.before),
        )
        return replace(member, status=replace(member.status, goal=signed))

    members = {name: with_signed_goals(member) for name, member in view.members.items()}
    return replace(view, members=members)

"""Operators of a virtual swarm: the commands of `swarmctl` with its pure code, in virtual time.

A command is a generator that looks at what has come each POLL s, as the loops of `MemberSearch`,
`RequestSender` and `StopSender` do. Its `Outcome` is what `swarmctl` would print.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Collection, Generator, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from swarmd.core.codec import MAX_CONTROL, VERSION, Decoder, encode
from swarmd.core.errors import ConfigError
from swarmd.core.goal import Goal
from swarmd.core.messages import Epoch, Reply
from swarmd.core.verbs import (
    AnyRequest,
    GoalRequest,
    LabelRequest,
    MarkRequest,
    ResetRequest,
    ResumeRequest,
    RunRequest,
    starts_motion,
)
from swarmd.link.datagram import (
    Ack,
    Address,
    Beacon,
    Datagram,
    MemberList,
    RunLease,
    Solicit,
    Stop,
)
from swarmd.link.keys.roster import Role
from swarmd.link.signature import Author
from swarmd.operator.session.clocks import SOLICIT_PACE, LoopWatch, RepeatTimer, RobotClocks
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import CLOCK_PERIOD
from swarmd.operator.session.outcome import Acks, Outcome, joined
from swarmd.operator.session.senders import REPEAT_PERIOD, STOP_PACE, PendingStop, request_timeout
from swarmd.operator.session.session import next_goal
from swarmd.operator.verbs.goal.words import content_of, present_goals, set_apart
from tests.histories.swarm import Node, VirtualSwarm

POLL = 0.1  # s
WAKE_TIME = 0.02  # s after a standstill in which threads take what waits in sockets
FIRST_SHIFT = 1e5  # s: no clock is set back to before its boot
LEASE_PARTS = 3.0
PROGRAM_TIME = 5.0  # s for which a Zenoh program repeats a stop
_reply = Decoder(Reply, MAX_CONTROL)
Command = Generator[None, None, Outcome | None]


@dataclass(eq=False)
class Done:
    """A command that has ended: when it was typed, and its outcome."""

    operator: str
    verb: str
    began: float
    ended: float
    outcome: Outcome | None


class VirtualOperator(Node):
    """An operator with a laptop; each command is a process of its own.

    Its clock has the id `clock` and is `shift` s ahead of the true time. Clones of one image have
    one id and different shifts; a computer that is set back to a snapshot keeps its id.
    """

    def __init__(
        self, swarm: VirtualSwarm, name: str, number: int, parent: VirtualOperator | None = None
    ) -> None:
        """`parent`: the program of which this one is a fork, on its computer and by its key."""
        self.name = name
        self.user: str = name if parent is None else parent.user
        self._parent = parent
        self.address: Address = (f"10.0.1.{number}", 5000)
        self.swarm = swarm
        self.done: list[Done] = []
        self.under_way = 0
        self._random = random.Random(name)
        self._echo = 0
        self.wall = 0.0  # s beside the true time
        self.clock, self.shift = name, FIRST_SHIFT
        if parent is not None:
            self.clock, self.shift = parent.clock, parent.shift
        self._life = 0  # counts the deaths of its processes
        self._loop = 0  # counts the ends of its loops, and so of its leases
        self._wakes_at = 0.0
        self._sleeps: list[tuple[float, float]] = []
        self._notices = True
        self._watch = LoopWatch(dict)  # of the command that goes on now
        self._origin, self._counter = self._random.randbytes(4), 0
        self._discoveries: list[Discovery] = []
        self._pending: list[PendingStop] = []
        self._clocks = RobotClocks()
        self._clocks_asked_at = -math.inf
        self._instances: dict[str, bytes] = {}  # by robot, of its newest beacon
        self._program_stop: dict[str, Any] = {}
        swarm.add(self)

    def begin(self, verb: str, command: Command) -> None:
        """Type a command."""
        began, life = self.swarm.now, self._life
        watch = LoopWatch(dict)
        watch.begin(began)
        self.under_way += 1

        def go_on() -> None:
            if life != self._life:
                command.close()
                self.under_way -= 1
                return
            if self.swarm.now < self._wakes_at:
                self.swarm.at(self._wakes_at + WAKE_TIME, go_on)
                return
            watch.turn(self.swarm.now, POLL)
            self._watch = watch
            try:
                next(command)
            except StopIteration as end:
                self.under_way -= 1
                self.done.append(Done(self.name, verb, began, self.swarm.now, end.value))
            else:
                self.swarm.at(self.swarm.now + POLL, go_on)

        go_on()

    def sleep(self, seconds: float, *, is_noticed: bool) -> None:
        """The computer is suspended, or its processes are stopped; its clock goes on.

        `is_noticed` False: of programs that state their age and do not watch their loops.
        """
        end = self.swarm.now + seconds
        if end > self._wakes_at:
            self._sleeps.append((max(self._wakes_at, self.swarm.now), end))
            self._wakes_at, self._notices = end, is_noticed

    def _asleep_since(self, begin: float) -> float:
        """The s of sleep since then."""
        return sum(max(0.0, end - max(since, begin)) for since, end in self._sleeps)

    def die(self) -> None:
        """All processes of the operator end at once."""
        self._life += 1
        self._discoveries.clear()
        self._pending.clear()

    def end_loop(self) -> None:
        """The loop of a program ends, by an error; its processes wait for threads."""
        self._loop += 1

    @property
    def author(self) -> Author:
        permits = {} if self.swarm.identity is None else self.swarm.identity.roster.permits
        return Author(Role.PERMIT if self.user in permits else Role.OPERATOR, self.user)

    def receive(self, body: Datagram, sender: Node) -> None:
        if self.swarm.now < self._wakes_at:
            self.swarm.at(self._wakes_at, partial(self.receive, body, sender))
            return
        now, source = self.swarm.now, sender.address
        if isinstance(body, Ack):
            for pending in self._pending:
                pending.on_ack(body, now)
        elif isinstance(body, Beacon):
            self._clocks.on_beacon(body, now + self.shift)
            self._instances[body.robot] = body.instance
            for discovery in self._discoveries:
                discovery.on_beacon(body, source, now)
        elif isinstance(body, MemberList):
            for discovery in self._discoveries:
                discovery.on_member_list(body, now)

    # Commands

    def run(
        self,
        pattern: str,
        targets: tuple[str, ...] = (),
        *,
        has_goal: bool = True,
        ahead: float | None = None,
        here: float = 0.0,
        params: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> Command:
        """`ahead`: seconds until all start. `here`: s for which a run lease is renewed."""
        typed = self.swarm.now
        view = yield from self._look(needs_status=False)
        names = _chosen(view, targets)
        fields |= {"pattern": pattern, "params": params or {}, "targets": targets}
        goal = self._next_goal(view, typed, **fields)
        if not names or goal is None:
            return None
        at = {} if ahead is None else dict.fromkeys(names, self.swarm.now + ahead)
        run = {"goal": goal, "at": at, **_run_fields(goal)}
        if not has_goal:
            run["goal"] = None
        outcome = yield from self._request(
            RunRequest, view, names, typed, ahead=ahead or 0.0, **run
        )
        if goal.lease is not None:
            self._keep(goal, names, 1, self.swarm.now + here, (self._life, self._loop))
        return outcome

    def stop(self, verb: Literal["stop", "estop"], targets: tuple[str, ...] = ()) -> Command:
        """All robots, without targets."""
        now = self.swarm.now
        discovery = Discovery(now)
        stop = Stop(
            id=self._new_id(),
            verb=verb,
            operator=self.user,
            scope="robots" if targets else "swarm",
            clock=self.clock,
            issued=now + self.shift,
        )
        renew = None
        if self.swarm.is_secured:
            origin, counter = self._next_origin()
            stop = replace(stop, origin=origin, counter=counter)
            renew = partial(self._next_origin, is_new=True)
        select: Callable[[Collection[str]], Collection[str]] = set(targets).intersection
        pending = PendingStop(
            stop, discovery, now, select=select if targets else None, names=targets, renew=renew
        )
        self._discoveries.append(discovery)
        self._pending.append(pending)
        solicit, repeat = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, STOP_PACE)
        while not pending.is_over(now) and not pending.is_done(now):
            if repeat.is_due(now):
                for one, addresses in pending.datagrams(now):
                    self._send(one, None)
                    for address in addresses:
                        self._send(one, address)
            self._solicit(discovery, solicit)
            yield
            now = self.swarm.now
        self._discoveries.remove(discovery)
        self._pending.remove(pending)
        return pending.outcome(now)

    def program_stop(
        self,
        verb: Literal["stop", "estop"],
        targets: tuple[str, ...] = (),
        *,
        is_repeat: bool = False,
    ) -> Command:
        """As examples/zenoh/stop.py: the same query until each robot has answered and rests.

        `is_repeat`: of the last one once more, with its id and its age.
        """
        swarm, began = self.swarm, self.swarm.now
        if not (is_repeat and self._program_stop):
            fields = {"verb": verb, "id": self._new_id(), "operator": self.user}
            named = {"targets": dict.fromkeys(targets)} if targets else {}
            self._program_stop = fields | named
        request = self._program_stop
        acks, repeat = Acks(request["id"]), RepeatTimer(began, ((1e9, REPEAT_PERIOD),))
        asked = [name for name in swarm.robots if name in request.get("targets", swarm.robots)]
        while swarm.now - began < PROGRAM_TIME and (
            acks.missing(asked) or any(map(acks.is_moving, asked))
        ):
            if repeat.is_due(swarm.now):
                age = swarm.now - swarm.issued[request["id"]]
                self._ask(request["verb"], _raw(request | {"age": age}), tuple(swarm.robots), acks)
            yield
        return acks.outcome(dict.fromkeys(asked), seconds=swarm.now - began, reached=len(asked))

    def put(self, sender: str, count: int = 1, payload: bytes | None = None) -> Command:
        """A Zenoh program puts messages of the pattern `drive` in the name `sender`."""
        swarm = self.swarm
        for robot in swarm.robots:
            for number in range(count):
                content = bytes([VERSION, number % 128]) if payload is None else payload
                swarm.ask(self.name, robot, partial(_put, sender=sender, payload=content))
        yield
        return None

    def reset(self, targets: tuple[str, ...] = ()) -> Command:
        typed = self.swarm.now
        view = yield from self._look()
        names = _chosen(view, targets)
        ids = tuple(sorted(view.latches(names)))
        return (yield from self._request(ResetRequest, view, names, typed, ids=ids))

    def set_goal(self, pattern: str | None, targets: tuple[str, ...] = ()) -> Command:
        """A goal without a run: robots stand, or are offered it."""
        typed = self.swarm.now
        view = yield from self._look()
        names = _chosen(view, targets)
        goal = self._next_goal(view, typed, pattern=pattern, targets=targets)
        if goal is None:
            return None
        return (yield from self._request(GoalRequest, view, names, typed, goal=goal))

    def undo(self) -> Command:
        typed = self.swarm.now
        view = yield from self._look()
        present, before = present_goals(view)
        if present is None or before is None or before.lease is not None:
            return None
        goal = self._next_goal(view, typed, **content_of(before), undoes=present.id)
        if goal is None:
            return None
        run, stand = set_apart(view, present, before)
        outcomes = []
        if stand:
            outcome = yield from self.stop("stop", tuple(stand))
            assert outcome is not None
            outcomes.append(outcome)
        if run and goal.pattern is None:
            outcomes.append((yield from self._request(GoalRequest, view, run, typed, goal=goal)))
        elif run:
            fields = {"goal": goal, **_run_fields(goal)}
            outcomes.append((yield from self._request(RunRequest, view, run, typed, **fields)))
        return joined(outcomes)

    def resume(self, targets: tuple[str, ...] = ()) -> Command:
        typed = self.swarm.now
        view = yield from self._look()
        outcomes = []
        by_digest: dict[str, list[str]] = {}
        for name in _chosen(view, targets):
            status = view.members[name].status
            own = status.goal.own if status is not None and status.goal is not None else None
            by_digest.setdefault("" if own is None else own.digest, []).append(name)
        for digest, names in by_digest.items():
            request = self._request(ResumeRequest, view, names, typed, digest=digest)
            outcomes.append((yield from request))
        return joined(outcomes)

    def label(self, targets: tuple[str, ...], labels: tuple[str, ...]) -> Command:
        typed = self.swarm.now
        view = yield from self._look()
        names = _chosen(view, targets)
        return (yield from self._request(LabelRequest, view, names, typed, labels=labels))

    def mark(self, targets: tuple[str, ...] = ()) -> Command:
        """As `swarmctl incident mark`."""
        typed = self.swarm.now
        view = yield from self._look(needs_status=False)
        names, id = _chosen(view, targets), self._new_id()
        return (yield from self._request(MarkRequest, view, names, typed, words="hm", incident=id))

    def push(self, pattern: str, targets: tuple[str, ...] = ()) -> Command:
        """Reduced: the pieces arrive at once, and no reply is waited for."""
        view = yield from self._look(needs_status=False)
        for name in _chosen(view, targets):
            request = self._new_id()
            call = partial(_push, pattern=pattern, request=request, operator=self.user)
            self.swarm.ask(self.name, name, call)
        return None

    # Parts

    def _look(self, *, needs_status: bool = True) -> Generator[None, None, MembersView]:
        swarm = self.swarm
        now = swarm.now
        discovery = Discovery(now, needs_status=needs_status)
        self._discoveries.append(discovery)
        solicit, poll = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now + POLL, ((1e9, 0.5),))
        while not discovery.is_complete(now) and not discovery.is_over(now):
            self._solicit(discovery, solicit)
            if needs_status and poll.is_due(now):
                for robot in swarm.robots:
                    swarm.ask(self.name, robot, partial(_view, asker=self.name, found=discovery))
            yield
            now = swarm.now
        self._discoveries.remove(discovery)
        return discovery.result(now)

    def _request(
        self,
        kind: type[AnyRequest],
        view: MembersView,
        names: Iterable[str],
        typed: float,
        *,
        ahead: float = 0.0,
        **fields: Any,
    ) -> Generator[None, None, Outcome]:
        """`typed`: when the command began, to which its request is dated. `ahead`: s until a start.

        As `Operator.request`: a start is not sent after a standstill that is noticed.
        """
        swarm, targets, watch = self.swarm, view.epochs(names), self._watch
        asked: dict[str, Epoch | None] = {
            name: epoch for name, epoch in targets.items() if view.is_in_reach(name)
        }
        request: Any = kind(
            id=self._new_id(typed),
            operator=self.user,
            targets=asked,
            planned=watch.worked(typed) + ahead,
            clock=self.clock,
            issued=typed + self.shift,
            issued_at=view.issue_times(asked, typed),
            **fields,
        )
        acks = Acks(request.id)
        began, timeout = swarm.now, request_timeout(view, 5.0 + ahead)
        repeat = RepeatTimer(began, ((1e9, REPEAT_PERIOD),))
        swarm.worked[request.id] = began - typed - self._asleep_since(typed) + ahead
        while (robots := acks.missing(asked)) and swarm.now - began < timeout:
            if starts_motion(request) and self._notices and watch.stood(typed):
                break
            if repeat.is_due(swarm.now):
                age = swarm.now - typed + view.round_trip
                self._ask(request.verb, encode(replace(request, age=age)), robots, acks)
            yield
        return acks.outcome(targets, seconds=swarm.now - began, reached=len(asked))

    def _ask(self, verb: str, payload: bytes, robots: Iterable[str], acks: Acks) -> None:
        for robot in robots:
            if robot in self.swarm.robots:
                answer = partial(_take_reply, robot, acks)
                call = partial(_hand, verb=verb, payload=payload, asker=self.user, take=answer)
                self.swarm.ask(self.name, robot, call)

    def _solicit(self, discovery: Discovery, timer: RepeatTimer) -> None:
        now = self.swarm.now
        if not timer.is_due(now):
            return
        echo = self._new_echo()
        discovery.on_solicit(echo, now)
        wants_members = discovery.begin_list_request(now)
        for address in (None, *discovery.to_solicit()):
            self._send(Solicit(echo=echo, wants_members=wants_members), address)

    def _new_echo(self) -> int:
        self._echo += 1
        self._clocks.on_solicit(self._echo, self.swarm.now + self.shift)
        return self._echo

    def _keep(
        self, goal: Goal, names: tuple[str, ...], count: int, until: float, life: tuple[int, int]
    ) -> None:
        """Renew a run lease."""
        assert goal.lease is not None
        if self.swarm.now > until or life != (self._life, self._loop):
            return
        if self.swarm.now < self._wakes_at:
            again = partial(self._keep, goal, names, count, until, life)
            self.swarm.at(self._wakes_at, again)
            return
        self.swarm.renewed[goal.id] = now = self.swarm.now
        if self.swarm.is_secured and now - self._clocks_asked_at >= CLOCK_PERIOD:
            self._clocks_asked_at = now
            self._send(Solicit(echo=self._new_echo()), None)
        for name in names:
            self._send(self._lease(goal, name, count), self.swarm.nodes[name].address)
        again = partial(self._keep, goal, names, count + 1, until, life)
        self.swarm.at(self.swarm.now + goal.lease / LEASE_PARTS, again)

    def _lease(self, goal: Goal, robot: str, count: int) -> RunLease:
        """As `Operator._lease`."""
        lease, now = RunLease(id=goal.id, operator=self.user, count=count), self.swarm.now
        instance = self._instances.get(robot, b"")
        clock = self._clocks.reading(robot, instance, now + self.shift)
        if clock is None or not self.swarm.is_secured:
            return lease
        return replace(lease, instance=instance, clock=clock)

    def _next_goal(self, view: MembersView, typed: float, **fields: Any) -> Goal | None:
        asker: Any = SimpleNamespace(name=self.user, identity=None)
        try:
            return replace(next_goal(asker, view, **fields), id=self._new_id(typed))
        except ConfigError:
            return None

    def _next_origin(self, *, is_new: bool = False) -> tuple[bytes, int]:
        """As `StopOrigin`, whose file outlives jumps of the wall clock, and which forks share."""
        if self._parent is not None:
            return self._parent._next_origin(is_new=is_new)
        least = round(1000.0 * (self.swarm.wall + self.wall + self.swarm.now))
        if is_new:
            self._origin, self._counter = self._random.randbytes(4), 0
        self._counter = max(self._counter + 1, least)
        return self._origin, self._counter

    def _send(self, body: Datagram, to: Address | None) -> None:
        self.swarm.send(self, body, to)

    def _new_id(self, typed: float | None = None) -> str:
        """An id; what has it was typed at `typed`, or now."""
        id = self._random.getrandbits(48).to_bytes(6, "big").hex()
        self.swarm.issued[id] = self.swarm.now if typed is None else typed
        return id


def _chosen(view: MembersView, targets: tuple[str, ...]) -> tuple[str, ...]:
    expected = view.expected & view.members.keys()
    return tuple(name for name in sorted(expected) if not targets or name in targets)


def _run_fields(goal: Goal) -> dict[str, Any]:
    return {
        "pattern": goal.pattern,
        "params": goal.params,
        "seconds": goal.seconds,
        "until": goal.conditions,
    }


def _view(daemon: Any, *, asker: str, found: Discovery) -> None:
    view = daemon.view()
    if view is not None:
        swarm = daemon.swarm
        swarm.answer(daemon.name, asker, lambda: found.on_view(view, swarm.now))


def _hand(daemon: Any, *, verb: str, payload: bytes, asker: str, take: Any) -> None:
    daemon.on_request(verb, payload, asker, take)


def _take_reply(robot: str, acks: Acks, payload: bytes) -> None:
    acks.on_reply(robot, _reply(payload))


def _put(daemon: Any, *, sender: str, payload: bytes) -> None:
    daemon.put(sender, payload)


def _raw(fields: Mapping[str, Any]) -> bytes:
    """A request as a program packs it, without the structs."""
    return bytes([VERSION]) + msgspec.msgpack.encode(fields)


def _push(daemon: Any, *, pattern: str, request: str, operator: str) -> None:
    daemon.push(pattern, request, operator)

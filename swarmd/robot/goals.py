"""The goals that one robot knows, and what it does about its own one. Pure.

The robot holds the greatest goal that it has seen, and its own one: the greatest that targets it.
Goals are ordered by generation, issuer and signed bytes, so that all robots that have seen the same
goals hold the same one. The age of a goal is handed on from robot to robot without wall clocks:
after a restart it is unknown until a peer reports it.

A goal that is found, and was not asked for by a request to this robot, does not start a run: it is
offered. The exception is a goal with `on_join: run` of a known age below its `valid`, while the
robot may join: it was idle when the goal came, or ran for a lesser goal, and nothing ended a run
since. If it lacks the pattern of the goal, it joins once more when the pattern is pushed to it. A
goal with a lease is joined only while its operator is heard.
No goal that was set before the last stop, emergency stop or reset of the robot is joined.

A stop or emergency stop of all robots makes a goal without a pattern that follows the held one,
unless the held one is newer. While that is not known, since the age of the held goal is not, the
stop is remembered until a peer tells the age or a greater goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from swarmd.core.errors import CodecError
from swarmd.core.goal import (
    MAX_UNSIGNED,
    Goal,
    GoalRecord,
    GoalState,
    GoalStatus,
    HeldGoal,
    KnownGoal,
)
from swarmd.core.messages import Refusal
from swarmd.core.verbs import RunRequest

MAX_STOPS = 64  # ids of stops that are remembered
MAX_ISSUER = 63
OFFERED = "offered: resume takes it"
OFFERED_WITH_LEASE = "offered: resume takes it while {} is heard"


class Found(Enum):
    """What a goal that came is to a robot."""

    OLD = "old"  # it is held already, or lesser than the held one
    AGED = "aged"  # the held goal, whose age was not known until now
    OTHER = "other"  # the greatest one, for other robots
    OWN = "own"  # the greatest one for this robot


class _Undecided(NamedTuple):
    """A stop of all robots that may be older than the held goal, issued at a time in s."""

    operator: str
    issued: float


class Goals:
    """The goals of `robot`; `labels` are those of the swarm file, `record` that of its disk.

    `now`: when the robot starts.
    """

    def __init__(
        self, robot: str, labels: tuple[str, ...], record: GoalRecord | None, now: float
    ) -> None:
        record = record or GoalRecord()
        self._robot = robot
        self._file_labels = labels
        self._set_labels = record.labels
        self.held = None if record.held is None else HeldGoal.of(record.held, None)
        self.own = None if record.own is None else HeldGoal.of(record.own, None)
        self.before = record.before
        self.state: GoalState | None = None
        self.superseded = ""
        self._reason = ""
        self._may_join = False
        self.lease_until: float | None = None
        self._lease_count = -1
        self._stops: dict[str, None] = {}
        self._undecided: dict[str, _Undecided] = {}
        self._held_since = now  # the held goal is not newer than this
        # When the robot was stopped, emergency-stopped or reset last, on the own clock.
        self._stood = -math.inf if record.stood is None else record.stood
        self._ran = record.ran  # the own goal was run when the robot was restarted
        self._stopped = b""  # the held goal after which a stop of all came, and made no goal
        self.is_changed = False
        # The load that failed since the robot has no such pattern, and whether it was repeated.
        self._awaits_code: int | None = None
        self._has_retried = False
        if self.own is not None:
            self._offer(record.ended, may_join=record.may_join)

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the robot: those that an operator set, else those of the file."""
        return self._file_labels if self._set_labels is None else self._set_labels

    @property
    def lease_ends(self) -> float | None:
        """When the run of the own goal ends unless its operator is heard, in s."""
        return self.lease_until if self.state is GoalState.RUNNING else None

    def forget(self, counts: Callable[[Goal], bool]) -> None:
        """Drop the goals that do not count any more, such as those of a revoked operator."""
        held, own, before = self.held, self.own, self.before
        self.held = None if held is None or not counts(held.goal) else held
        self.own = None if own is None or not counts(own.goal) else own
        self.before = None if before is None or not counts(before) else before
        if self.held is None:
            self.held = self.own
        if own is not None and self.own is None:
            self.state, self._reason, self._may_join, self.lease_until = None, "", False, None
        self.is_changed |= (held, own, before) != (self.held, self.own, self.before)

    def take_record(self) -> GoalRecord | None:
        """The record for the disk, if it has changed since it was taken last."""
        if not self.is_changed:
            return None
        self.is_changed = False
        return self.record()

    def record(self) -> GoalRecord:
        """The record for the disk."""
        is_run = self.state in (GoalState.LOADING, GoalState.RUNNING)
        return GoalRecord(
            held=None if self.held is None else self.held.goal,
            own=None if self.own is None else self.own.goal,
            before=self.before,
            ended=self._reason if self.state is GoalState.ENDED else "",
            may_join=self._may_join or is_run,
            ran=is_run or (self._ran and self._may_join),
            stood=None if self._stood == -math.inf else self._stood,
            labels=self._set_labels,
        )

    def status(self, now: float) -> GoalStatus | None:
        """The goals for the status; None before there is one."""
        if self.held is None:
            return None
        lease_ends = self.lease_ends
        return GoalStatus(
            held=_known(self.held, now),
            before=self.before,
            own=None if self.own is None else _known(self.own, now),
            state=self.state,
            reason=self._reason,
            superseded=self.superseded,
            lease_left=None if lease_ends is None else max(lease_ends - now, 0.0),
        )

    # Goals that come

    def judge(self, goal: Goal) -> Found:
        """What a goal is to this robot; nothing changes."""
        new, held, own = HeldGoal.of(goal, None), self.held, self.own
        if held is not None and new.content == held.content:
            return Found.AGED if held.issued is None else Found.OLD
        is_own = goal.is_for(self._robot, self.labels)
        if is_own and (own is None or new.order > own.order):
            return Found.OWN
        return Found.OTHER if held is None or new.order > held.order else Found.OLD

    def judge_held(self) -> Found:
        """What the held goal is to this robot, whose labels have changed."""
        held, own = self.held, self.own
        if held is None or not held.goal.is_for(self._robot, self.labels):
            return Found.OLD
        return Found.OWN if own is None or held.order > own.order else Found.OLD

    def is_held(self, goal: Goal) -> bool:
        """True if it is the held goal."""
        return self.held is not None and HeldGoal.of(goal, None).content == self.held.content

    def adopt(self, goal: Goal, age: float | None, now: float, *, may_join: bool) -> None:
        """Take over a greater goal; an own one is offered, or the robot stands."""
        is_own = goal.is_for(self._robot, self.labels)
        new = HeldGoal.of(goal, None if age is None else now - age)
        if self.held is None or new.order > self.held.order:
            before = None if self.held is None else self.held.goal
            # Of two stops the second keeps what `undo` sets again.
            are_stops = before is not None and before.pattern is None and goal.pattern is None
            if before is not None and before.id != goal.id and not are_stops:
                self.before = before
            self.held, self._held_since = new, now
        if is_own and (self.own is None or new.order > self.own.order):
            self.own = new
            self._lease_count, self.lease_until = -1, None
            self._has_retried = self._ran = False
            self._offer("", may_join=may_join)
        self.is_changed = True
        self._decide_stops(now)

    def learn_age(self, age: float | None, now: float) -> None:
        """A peer reports the age of the held goal: the greatest age counts."""
        held = self.held
        if held is None or age is None or held.content == self._stopped:
            return
        issued = now - age if held.issued is None else min(held.issued, now - age)
        self.held = held._replace(issued=issued)
        if self.own is not None and self.own.content == held.content:
            self.own = self.own._replace(issued=issued)
        self._decide_stops(now)

    def refusal_of(self, request: RunRequest) -> tuple[Refusal, str] | None:
        """Why a run is refused because of its goal."""
        goal = request.goal
        if goal is None:
            return None
        wanted = (goal.pattern, goal.params, goal.seconds, goal.conditions)
        if wanted != (request.pattern, request.params, request.seconds, request.until):
            return Refusal.INVALID_GOAL, f"{goal.text} is of another run than the request"
        if not goal.is_for(self._robot, self.labels):
            return Refusal.INVALID_GOAL, f"{goal.text} does not target {self._robot}"
        return self.overtaken_by(goal)

    def overtaken_by(self, goal: Goal) -> tuple[Refusal, str] | None:
        """Why a goal does not count: it is too long, or a greater one is held."""
        try:
            new = HeldGoal.of(goal, None)
        except CodecError as error:
            return Refusal.INVALID_GOAL, str(error)
        if self.held is None or new.order >= self.held.order:
            return None
        return Refusal.OVERTAKEN, f"{self.held.goal.text} came first"

    def stand(self, stop: str, operator: str, age: float, now: float) -> bool:
        """A stop of all robots makes a goal without a pattern; False if it makes no goal now.

        `stop`: its id, `age` in s since it was issued. All robots that hold the same goal make the
        same one. A repeat makes no goal, nor does a stop that is older than the held goal.
        """
        if stop in self._stops:
            return False
        self._stops[stop] = None
        while len(self._stops) > MAX_STOPS:
            del self._stops[next(iter(self._stops))]
        return self._stand_since(stop, _Undecided(operator, now - age), now)

    def _decide_stops(self, now: float) -> None:
        undecided, self._undecided = self._undecided, {}
        for stop, one in undecided.items():
            self._stand_since(stop, one, now)

    def _stand_since(self, stop: str, one: _Undecided, now: float) -> bool:
        """Make the goal of a stop, if the stop is known to be newer than the held goal."""
        held, generation = self.held, 1
        if held is not None:
            is_newer = held.issued is not None and held.issued > one.issued
            if is_newer or held.goal.id == stop:
                return False
            if held.issued is None and self._held_since > one.issued:
                self._undecided[stop] = one
                while len(self._undecided) > MAX_STOPS:
                    del self._undecided[next(iter(self._undecided))]
                return False
            if held.goal.generation >= MAX_UNSIGNED:  # no goal without a signature can follow it
                self._stopped = held.content
                self.held = held._replace(issued=None)  # without an age no robot joins its run
                return False
            generation = held.goal.generation + 1
        goal = Goal(generation=generation, issuer=one.operator[:MAX_ISSUER], id=stop)
        self.adopt(goal, now - one.issued, now, may_join=False)
        return True

    # The robot's runs

    def joins(self, now: float) -> bool:
        """True if the robot is to run its own goal, which it found, without being asked."""
        own = self.own
        if own is None or not self._may_join or self.state is not GoalState.OFFERED:
            return False
        goal, age = own.goal, own.age(now)
        if goal.on_join != "run" or goal.valid is None or age is None or age >= goal.valid:
            return False
        if not self._ran and now - age <= self._stood:
            return False
        if self.refusal_to_resume(now):  # the operator of its run lease is not heard
            return False
        return goal.seconds is None or age < goal.seconds

    def on_loading(self) -> None:
        """The run of the own goal is being loaded."""
        self.state, self._reason, self._may_join = GoalState.LOADING, "", False
        self._undecided.clear()

    def await_code(self, generation: int) -> None:
        """The load `generation` of the own goal has failed: the robot has no such pattern yet."""
        if self.state is GoalState.ENDED and not self._has_retried:
            self._awaits_code = generation

    def offer_again(self, generation: int) -> None:
        """The awaited pattern has come: the robot may join once more, if nothing happened since.

        `generation`: of the last load.
        """
        if self._awaits_code == generation:
            self._has_retried = True
            self._offer("", may_join=True)
            self.is_changed = True

    def refusal_to_resume(self, now: float) -> str:
        """Why the run of the own goal is not resumed: its lease has ended; empty if it may be."""
        own = self.own
        if own is None or own.goal.lease is None:
            return ""
        if self.lease_until is not None and now < self.lease_until:
            return ""
        return f"the operator of its run lease was not heard for {own.goal.lease:g} s"

    def on_running(
        self, goal: Goal | None, what: str, age: float, now: float, *, is_resumed: bool = False
    ) -> None:
        """A run began, for `goal`, asked for `age` s ago, or without one. `what`: in words.

        `is_resumed`: no request set the goal now, so that its lease is not renewed.
        """
        self._may_join, self._awaits_code = False, None
        self._undecided.clear()  # the run was asked for later
        if goal is None:
            if self.own is not None:
                self._end(f"runs {what}, without a goal")
            return
        if self.judge(goal) is Found.OWN:
            self.adopt(goal, age, now, may_join=False)
        self.state, self._reason, self.superseded = GoalState.RUNNING, "", ""
        if not is_resumed:
            self.lease_until = None if goal.lease is None else now + goal.lease
        self.is_changed = True

    def on_lease(self, goal: str, count: int, now: float) -> None:
        """The operator of the goal with this id was heard; old and repeated counts are ignored."""
        own = self.own
        if own is None or own.goal.id != goal or own.goal.lease is None:
            return
        if count > self._lease_count:
            self._lease_count = count
            self.lease_until = now + own.goal.lease

    def bar(self, now: float) -> None:
        """The robot was stopped or reset: it joins no goal that was set before."""
        self._stood, self._ran, self.is_changed = now, False, True

    def on_end(self, why: str) -> None:
        """A run ended, or an event came after which no found goal may start one."""
        self.is_changed |= self._may_join
        self._may_join, self._awaits_code = False, None
        own = self.own
        if own is None:
            return
        if own.goal.pattern is None:
            self.state, self._reason = GoalState.STANDING, ""
        elif self.state in (GoalState.RUNNING, GoalState.LOADING):
            self._end(why)

    def note(self, text: str) -> None:
        """The robot differs from its own goal, which it runs, for this reason."""
        if self.state is GoalState.RUNNING:
            self._reason = text

    def set_labels(self, labels: tuple[str, ...] | None) -> None:
        """Set the labels; None: those of the file."""
        self._set_labels = labels
        self._awaits_code = None
        self.is_changed = True

    def _offer(self, ended: str, *, may_join: bool) -> None:
        own = self.own
        assert own is not None
        self._may_join, self._awaits_code = may_join, None
        if own.goal.pattern is None:
            self.state, self._reason = GoalState.STANDING, ""
        elif ended:
            self.state, self._reason = GoalState.ENDED, ended
        else:
            is_leased = own.goal.lease is not None
            text = OFFERED_WITH_LEASE.format(own.goal.issuer) if is_leased else OFFERED
            self.state, self._reason = GoalState.OFFERED, text

    def _end(self, why: str) -> None:
        self.state, self._reason, self.is_changed = GoalState.ENDED, why, True


def _known(held: HeldGoal, now: float) -> KnownGoal:
    return KnownGoal(goal=held.goal, digest=held.digest.hex(), age=held.age(now))

"""The goals that one robot knows: which goal counts, and whether the robot may run it. Pure.

The robot keeps two goals. The held goal is the greatest goal that the robot has seen. The own goal
is the greatest goal that targets this robot. Goals are ordered by generation, issuer and signed
bytes, so that all robots that have seen the same goals hold the same goal. Robots hand on the age
of a goal, without wall clocks. After a restart the age is unknown until a peer reports it.

1. A goal that comes from a peer, without a request to this robot, starts no run: the goal is
   offered.
2. Exception: the robot joins (runs without a request) a goal with `on_join: run` whose age is known
   and below `valid`. The robot must have been idle, or must have run for a lesser goal, when the
   goal came, and no run may have ended since.
3. If a load failed because the robot lacks the pattern of the goal, the robot may join again, once,
   after the pattern has come by a push or from a peer, and has passed its trial.
4. The robot joins a goal with a lease only while the operator of that goal is heard. Once the goals
   of all peers are known, it waits for the operator for the time of the lease.
5. The robot joins no goal that was set before its last stop, emergency stop or reset.
6. A stop or emergency stop of all robots makes a goal without a pattern, one generation greater
   than the held goal, so that no robot joins the held goal later. Two exceptions:
   a. The held goal was set after the stop: no goal is made.
   b. The age of the held goal is unknown, and the held goal arrived after the stop. The held goal
      may have been set before or after the stop. Until a peer reports its age, no goal is made.
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
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import RunRequest
from swarmd.robot.issue_time import MAX_WAY

MAX_STOPS = 64  # ids of stops that are remembered
MAX_ISSUER = 63
OFFERED = "offered: resume takes it"
OFFERED_WITH_LEASE = "offered: resume takes it while {} is heard"


class Found(Enum):
    """The relation of a received goal to the goals that a robot knows."""

    OLD = "old"  # the held goal itself, or a lesser goal
    AGED = "aged"  # the held goal, whose age the robot does not know yet
    OTHER = "other"  # greater than the held goal; targets other robots
    OWN = "own"  # greater than the own goal; targets this robot


class _Undecided(NamedTuple):
    """A stop of all robots that may be older than the held goal; `issued` in s, own clock."""

    operator: str
    issued: float


class Goals:
    """The goals of one robot, and the rules (see the module) for running them.

    `robot`: its name. `labels`: its labels in the swarm file. `record`: the goals from disk, None
    without a file. `now`: the time at which the robot starts, in s on the own clock.
    """

    def __init__(
        self, robot: str, labels: tuple[str, ...], record: GoalRecord | None, now: float
    ) -> None:
        """Take the goals from disk. The own goal is offered, or has ended, as the record says."""
        record = record or GoalRecord()
        self._robot = robot  # the name of this robot
        self._file_labels = labels
        # Labels that an operator has set; None: the labels of the swarm file count.
        self._set_labels = record.labels
        # The age of a goal from disk is unknown (None) until a peer reports the age.
        self.held = None if record.held is None else HeldGoal.of(record.held, None)
        self.own = None if record.own is None else HeldGoal.of(record.own, None)
        self.before = record.before  # the goal that `swarmctl undo` restores
        self.state: GoalState | None = None  # the state of the own goal; None without an own goal
        self.superseded = ""  # the goal, as text, that ended the last run
        self._reason = ""  # text that explains `state`
        self._may_join = False  # True if the robot may run the own goal without a request
        # A run lease ends the run once its operator is not heard any more. Time in s on the own
        # clock; None without a run lease.
        self.lease_until: float | None = None
        self._lease_count = -1  # the sequence number of the operator's newest lease message
        # When a lease message came last that was too old, or may have been replayed; s, own clock.
        self._old_lease_at = -math.inf
        # By id, the last stops of all robots that this robot has carried out, oldest first: when
        # each was issued, in s on the own clock, by the age that its first copy stated.
        self._stops: dict[str, float] = {}
        # By id: stops that may be older than the held goal (rule 6b).
        self._undecided: dict[str, _Undecided] = {}
        self._held_since = now  # s, own clock: when the held goal arrived or was read from disk
        # Time of the last stop, emergency stop or reset of the robot, in s on the own clock.
        self._last_stop_at = -math.inf if record.stood is None else record.stood
        # True if the last daemon ended during a run of the own goal.
        self._ended_during_run = record.ran
        # The bytes of a held goal that a stop has barred (`_bar_greatest_goal`); empty without.
        self._stopped_content = b""
        self.is_changed = False  # True if the record has changed since it was last written to disk
        # The number of the load that failed for lack of the pattern; None without such a load, and
        # after a later load, run or label.
        self._awaits_code: int | None = None
        self._has_retried = False  # True if the robot has repeated a failed load
        self._is_in_hand = False  # True while a hand drives the robot, or holds its run
        if self.own is not None:
            self._offer(record.ended, may_join=record.may_join)

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels that an operator set, else the labels of the swarm file."""
        return self._file_labels if self._set_labels is None else self._set_labels

    @property
    def lease_ends(self) -> float | None:
        """When the run of the own goal ends unless the operator is heard, in s; None without."""
        return self.lease_until if self.state is GoalState.RUNNING else None

    def forget(self, counts: Callable[[Goal], bool]) -> None:
        """Drop each goal for which `counts` is False, such as the goals of a revoked operator."""
        held = self.held
        own = self.own
        before = self.before
        self.held = None if held is None or not counts(held.goal) else held
        self.own = None if own is None or not counts(own.goal) else own
        self.before = None if before is None or not counts(before) else before
        if self.held is None:
            self.held = self.own
        if own is not None and self.own is None:
            self.state = None
            self._reason = ""
            self._may_join = False
            self.lease_until = None
        self.is_changed |= (held, own, before) != (self.held, self.own, self.before)

    def take_record(self) -> GoalRecord | None:
        """The record for the disk; None if nothing has changed since the last call."""
        if not self.is_changed:
            return None
        self.is_changed = False
        return self.record()

    def record(self) -> GoalRecord:
        """The record for the disk."""
        # A run in a hand goes on by a word alone: no restart of the daemon stands for it.
        is_run = self.state in (GoalState.LOADING, GoalState.RUNNING) and not self._is_in_hand
        return GoalRecord(
            held=None if self.held is None else self.held.goal,
            own=None if self.own is None else self.own.goal,
            before=self.before,
            ended=self._reason if self.state is GoalState.ENDED else "",
            may_join=is_run or (self._may_join and not self._is_in_hand),
            ran=is_run or (self._ended_during_run and self._may_join),
            stood=None if self._last_stop_at == -math.inf else self._last_stop_at,
            labels=self._set_labels,
        )

    def status(self, now: float) -> GoalStatus | None:
        """The goals for the status; None while the robot knows no goal."""
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

    # Received goals

    def judge(self, goal: Goal) -> Found:
        """The relation of `goal` to the known goals; nothing changes."""
        new = HeldGoal.of(goal, None)
        held = self.held
        own = self.own
        if held is not None and new.content == held.content:
            return Found.AGED if held.issued is None else Found.OLD
        is_own = goal.is_for(self._robot, self.labels)
        if is_own and (own is None or new.order > own.order):
            return Found.OWN
        return Found.OTHER if held is None or new.order > held.order else Found.OLD

    def judge_held(self) -> Found:
        """After a change of labels: OWN if the held goal becomes the own goal, else OLD."""
        held = self.held
        own = self.own
        if held is None or not held.goal.is_for(self._robot, self.labels):
            return Found.OLD
        return Found.OWN if own is None or held.order > own.order else Found.OLD

    def is_held(self, goal: Goal) -> bool:
        """True if `goal` is the held goal."""
        return self.held is not None and HeldGoal.of(goal, None).content == self.held.content

    def has_made(self, goal: Goal, issued: float) -> bool:
        """True if `goal` is the held goal, and of a stop that this robot has carried out.

        `issued`: s, own clock: when the goal was set, as a peer tells it. False if that is more
        than MAX_WAY after the stop: a relay may have stated too great an age of the stop.
        """
        stop = self._stops.get(goal.id)
        return stop is not None and issued - stop <= MAX_WAY and self.is_held(goal)

    def adopt(self, goal: Goal, age: float | None, now: float, *, may_join: bool) -> None:
        """Replace the held goal by `goal` if `goal` is greater, and so the own goal.

        The own goal is replaced only by a goal that targets this robot. A new own goal is offered:
        the goal waits for a request `resume`. `may_join`: the robot may also run the new own goal
        without a request. `age`: s since the goal was set, None if unknown.
        """
        is_own = goal.is_for(self._robot, self.labels)
        new = HeldGoal.of(goal, None if age is None else now - age)
        if self.held is None or new.order > self.held.order:
            before = None if self.held is None else self.held.goal
            # After two stops in a row, `undo` restores the goal before the first stop.
            are_stops = before is not None and before.pattern is None and goal.pattern is None
            if before is not None and before.id != goal.id and not are_stops:
                self.before = before
            self.held = new
            self._held_since = now
        if is_own and (self.own is None or new.order > self.own.order):
            self.own = new
            self._lease_count = -1
            self.lease_until = None
            self._old_lease_at = -math.inf
            self._has_retried = False
            self._ended_during_run = False
            self._offer("", may_join=may_join)
        self.is_changed = True
        self._decide_stops(now)

    def learn_age(self, age: float | None, now: float) -> None:
        """Take in the age of the held goal that a peer reports; the greatest report counts."""
        held = self.held
        if held is None or age is None or held.content == self._stopped_content:
            return
        issued = now - age if held.issued is None else min(held.issued, now - age)
        self.held = held._replace(issued=issued)
        if self.own is not None and self.own.content == held.content:
            self.own = self.own._replace(issued=issued)
        self._decide_stops(now)

    def refusal_of(self, request: RunRequest) -> tuple[Refusal, str] | None:
        """Why a run request is refused because of its goal; None if it is not."""
        goal = request.goal
        if goal is None:
            return None
        run_of_goal = (goal.pattern, goal.params, goal.seconds, goal.conditions)
        if run_of_goal != (request.pattern, request.params, request.seconds, request.until):
            return Refusal.INVALID_GOAL, f"{goal.text} is of another run than the request"
        if not goal.is_for(self._robot, self.labels):
            return Refusal.INVALID_GOAL, f"{goal.text} does not target {self._robot}"
        return self.overtaken_by(goal)

    def overtaken_by(self, goal: Goal) -> tuple[Refusal, str] | None:
        """Why `goal` does not count: too long, or the held goal is greater. None if it counts."""
        try:
            new = HeldGoal.of(goal, None)
        except CodecError as error:
            return Refusal.INVALID_GOAL, str(error)
        if self.held is None or new.order >= self.held.order:
            return None
        return Refusal.OVERTAKEN, f"{self.held.goal.text} came first"

    def stand(self, stop: str, operator: str, age: float, now: float) -> bool:
        """Make a goal without a pattern, greater than the held goal, after a stop of all robots.

        So no robot that joins later runs the held goal (rule 6 of the file). All robots that hold
        the same goal make the same new goal. `stop`: the id of the stop. `age`: s since the stop
        was issued. Returns True if the goal is made now. False for a repeated stop, for the
        exceptions of rule 6, and if no goal can exceed the held goal.
        """
        if stop in self._stops:
            return False
        self._stops[stop] = now - age
        while len(self._stops) > MAX_STOPS:
            del self._stops[next(iter(self._stops))]
        return self._stand_since(stop, _Undecided(operator, now - age), now)

    def _decide_stops(self, now: float) -> None:
        undecided = self._undecided
        self._undecided = {}
        for stop, details in undecided.items():
            self._stand_since(stop, details, now)

    def _stand_since(self, stop: str, details: _Undecided, now: float) -> bool:
        """Make the goal of a stop that is newer than the held goal; True if the goal is made."""
        held = self.held
        generation = 1
        if held is not None:
            is_held_newer = held.issued is not None and held.issued > details.issued
            is_made_already = held.goal.id == stop
            if is_held_newer or is_made_already:
                return False
            if held.issued is None and self._held_since > details.issued:
                self._keep_undecided(stop, details)
                return False
            if held.goal.generation >= MAX_UNSIGNED:
                self._bar_greatest_goal(held)
                return False
            generation = held.goal.generation + 1
        goal = Goal(generation=generation, issuer=details.operator[:MAX_ISSUER], id=stop)
        self.adopt(goal, now - details.issued, now, may_join=False)
        return True

    def _keep_undecided(self, stop: str, details: _Undecided) -> None:
        self._undecided[stop] = details
        while len(self._undecided) > MAX_STOPS:
            del self._undecided[next(iter(self._undecided))]

    def _bar_greatest_goal(self, held: HeldGoal) -> None:
        """Forget the age of the held goal, so that this robot does not join it after a stop.

        Used if the goal of a stop cannot exceed the held goal: the goal of a stop is not signed,
        and an unsigned goal has at most the generation MAX_UNSIGNED. From now on `learn_age`
        ignores the age that a peer reports for the held goal (`_stopped_content`).
        """
        self._stopped_content = held.content
        self.held = held._replace(issued=None)

    # The robot's runs

    def joins(self, now: float) -> bool:
        """True if the robot is to run its own goal without a request (rules 2 to 5 of the file)."""
        own = self.own
        if own is None or not self._may_join or self.state is not GoalState.OFFERED:
            return False
        goal = own.goal
        age = own.age(now)
        if goal.on_join != "run" or goal.valid is None or age is None or age >= goal.valid:
            return False
        if not self._ended_during_run and now - age <= self._last_stop_at:
            return False
        if self.refusal_to_resume(now):  # the operator of the run lease is not heard
            return False
        return goal.seconds is None or age < goal.seconds

    def on_loading(self) -> None:
        """Note that the pattern of the own goal is being loaded for a run."""
        self.state = GoalState.LOADING
        self._reason = ""
        self._may_join = False
        self._undecided.clear()

    def await_code(self, generation: int) -> None:
        """Note that load `generation` of the own goal failed for lack of the pattern."""
        if self.state is GoalState.ENDED and not self._has_retried:
            self._awaits_code = generation

    def offer_again(self, generation: int) -> None:
        """Offer the own goal again, since its pattern, which the robot lacked, has been pushed.

        `generation`: the number of the last pattern load of the robot. Nothing is offered if a
        later load followed the load that failed for lack of the pattern.
        """
        if self._awaits_code == generation:
            self._has_retried = True
            self._offer("", may_join=True)
            self.is_changed = True

    def refusal_to_resume(self, now: float) -> str:
        """Why the own goal may not be resumed (its lease has ended); empty if it may be resumed."""
        own = self.own
        if own is None or own.goal.lease is None:
            return ""
        if self.is_heard(now):
            return ""
        silence = f"the operator of its run lease was not heard for {own.goal.lease:g} s"
        return silence + self.old_leases(now)

    def on_running(
        self, goal: Goal | None, what: str, age: float, now: float, *, is_resumed: bool = False
    ) -> None:
        """Note that a run begins; `goal`: the goal of the run, None without a goal.

        `what`: the name of the pattern, for the status. `age`: s since the run was requested.
        `is_resumed`: the run resumes or joins a goal that was set before, or follows a reload of
        the pattern. Such a run does not renew the lease.
        """
        self._may_join = False
        self._awaits_code = None
        self._undecided.clear()  # the run was requested after the stops that are still undecided
        if goal is None:
            if self.own is not None:
                self._end(f"runs {what}, without a goal")
            return
        if self.judge(goal) is Found.OWN:
            self.adopt(goal, age, now, may_join=False)
        self.state = GoalState.RUNNING
        self._reason = ""
        self.superseded = ""
        if not is_resumed:
            self.lease_until = None if goal.lease is None else now + goal.lease
        self.is_changed = True

    def on_lease(self, goal: str, count: int, now: float, age: float | None = 0.0) -> None:
        """Renew the run lease: a message of the operator of the goal with id `goal` came at `now`.

        A run lease ends the run once the operator is silent for longer than the lease. `count`
        rises with each message of the operator; an old or repeated count is ignored. `age`: s since
        the operator sent the message, at most: the lease counts from then. A message with the age
        None may be a replayed one, and renews nothing.
        """
        own = self.own
        if own is None or own.goal.id != goal or own.goal.lease is None:
            return
        if age is None or age >= own.goal.lease:
            self._old_lease_at = now
        elif count > self._lease_count:
            self._lease_count = count
            renewed = now - age + own.goal.lease
            self.lease_until = max(renewed, self.lease_until or renewed)

    def old_leases(self, now: float) -> str:
        """What to add to "was not heard for the lease": lease messages that did not count."""
        own = self.own
        lease = 0.0 if own is None else own.goal.lease or 0.0
        if now - self._old_lease_at > lease:
            return ""
        return "; leases in that name came, but were old, replayed, or of an older swarmctl"

    def is_heard(self, now: float) -> bool:
        """True while the own goal has a lease, and the operator of the lease is heard."""
        return self.lease_until is not None and now < self.lease_until

    def on_hand(self, *, is_there: bool) -> None:
        """Note whether a hand drives the robot, or holds its run."""
        self.is_changed |= is_there is not self._is_in_hand
        self._is_in_hand = is_there

    def bar(self, now: float) -> None:
        """After a stop, a reset or the loss of a hand: join no goal that was set before `now`."""
        self._last_stop_at = now
        self._ended_during_run = False
        self.is_changed = True

    def on_end(self, why: str) -> None:
        """End the run of the own goal with the reason `why`; no known goal is joined any more."""
        self.is_changed |= self._may_join
        self._may_join = False
        self._awaits_code = None
        own = self.own
        if own is None:
            return
        if own.goal.pattern is None:
            self.state = GoalState.STANDING
            self._reason = ""
        elif self.state in (GoalState.RUNNING, GoalState.LOADING):
            self._end(why)

    def note(self, text: str) -> None:
        """Set the reason why the robot, which runs its own goal, differs from that goal."""
        if self.state is GoalState.RUNNING:
            self._reason = text

    def set_labels(self, labels: tuple[str, ...] | None) -> None:
        """Set the labels; None: take the labels of the swarm file."""
        self._set_labels = labels
        self._awaits_code = None
        self.is_changed = True

    def _offer(self, ended: str, *, may_join: bool) -> None:
        own = self.own
        assert own is not None
        self._may_join = may_join
        self._awaits_code = None
        if own.goal.pattern is None:
            self.state = GoalState.STANDING
            self._reason = ""
        elif ended:
            self.state = GoalState.ENDED
            self._reason = ended
        else:
            is_leased = own.goal.lease is not None
            text = OFFERED_WITH_LEASE.format(own.goal.issuer) if is_leased else OFFERED
            self.state = GoalState.OFFERED
            self._reason = text

    def _end(self, why: str) -> None:
        self.state = GoalState.ENDED
        self._reason = why
        self.is_changed = True


def _known(held: HeldGoal, now: float) -> KnownGoal:
    return KnownGoal(goal=held.goal, digest=held.digest.hex(), age=held.age(now))

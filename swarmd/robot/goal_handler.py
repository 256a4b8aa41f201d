"""Applies goals to one robot: goals received from peers, and operators' requests on goals. Pure.

A greater goal that targets this robot ends the present run. Only a request starts a run, with one
exception: a goal with `on_join: run` (the rules are in goals.py).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core import verbs
from swarmd.core.errors import ConfigError
from swarmd.core.goal import Goal, GoalState, HeldGoal
from swarmd.core.messages import Epoch, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.kit.conditions import parse_conditions
from swarmd.robot.goals import Found
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.pattern_load import Loading, Wish
from swarmd.robot.state import Lifecycle

if TYPE_CHECKING:
    from swarmd.core.events import LeaseInput
    from swarmd.robot.effects import Effects


class _PeerGoal(NamedTuple):
    """The last goal for this robot that came from a peer.

    `epoch_before`: the epoch (count of the robot's changes) before the robot took the goal over.
    `revision_after`: the count of changes (`Epoch.revision`) afterwards.
    """

    goal: Goal
    epoch_before: Epoch
    revision_after: int


class GoalHandler:
    """Applies goals to the lifecycle of one robot."""

    def __init__(self, lifecycle: Lifecycle) -> None:
        self._lifecycle = lifecycle
        self._goals = lifecycle.goals
        self._peer_goal: _PeerGoal | None = None
        # True once the goals of all other peers are known, after the own goal came from a peer.
        self._is_settled = False
        self._settled_at = -math.inf  # s, own clock

    def on_goal(self, goal: Goal, age: float | None, effects: Effects, *, may_join: bool) -> None:
        """Take in a goal that a peer holds.

        `age`: s since an operator set the goal, None if unknown. `may_join`: the goals of all peers
        are known now, so that the robot may join its own goal. To join is to run a goal without a
        request of an operator.
        """
        goals = self._goals
        now = effects.now
        if (
            goal.pattern is None
            and age is not None
            and goal.is_for(self._lifecycle.identity.robot, goals.labels)
            and not goals.has_made(goal, now - age)
        ):
            # A stop of all robots, or an operator, has made this goal: the robot is to stand. A
            # robot that has carried out this stop itself knows its time better: the age lacks the
            # time of the message on its way, of MAX_WAY at most.
            self._lifecycle.stops.note(IssueTime(now - age), goal.issuer)
        relation = goals.judge(goal)
        if relation is Found.OWN:
            epoch_before = self._lifecycle.epoch
            # Joined in `join_if_settled`, once the goals of all other peers are known.
            self._take_over(goal, age, effects, may_join=True)
            self._peer_goal = _PeerGoal(goal, epoch_before, self._lifecycle.revision)
            self._is_settled = False
        elif relation is Found.OTHER:
            goals.adopt(goal, age, now, may_join=False)
        elif relation is Found.AGED or goals.is_held(goal):
            goals.learn_age(age, now)
        if may_join:
            self._is_settled = True
            self._settled_at = now
            self.join_if_settled(effects)

    def on_lease(self, lease: LeaseInput, now: float) -> bool:
        """Take a message of the operator of a run lease; True: call `join_if_settled` for it.

        A robot that has started often hears the goals of its peers before it hears the operator of
        the lease. So it waits for the operator, from the time at which all goals are known, for the
        time of the lease: a run that begins later would surprise people beside the robot.
        """
        goals = self._goals
        was_heard = goals.is_heard(now)
        goals.on_lease(lease.goal, lease.count, now, lease.age)
        own = goals.own
        if own is None or own.goal.lease is None or was_heard or not goals.is_heard(now):
            return False
        return now - self._settled_at <= own.goal.lease

    def has_goal_by_peer(self, request: verbs.Request, quoted: Epoch | None) -> bool:
        """True if the epoch has risen only because a peer handed over the goal of this request.

        The goal of a run or goal request may reach the robot by a peer before the request arrives.
        Then the request must not be refused as stale. `quoted`: the epoch of the robot in the
        request. False if anything else has changed the robot since this epoch.
        """
        known = self._peer_goal
        if known is None or not isinstance(request, verbs.RunRequest | verbs.GoalRequest):
            return False
        is_unchanged_since = self._lifecycle.revision == known.revision_after
        return request.goal == known.goal and quoted == known.epoch_before and is_unchanged_since

    def on_new_code(self, pattern: str, effects: Effects) -> None:
        """Join the own goal if the goal waited for `pattern`, which has passed its trial."""
        own = self._goals.own
        run = self._lifecycle.pattern_run
        if own is not None and own.goal.pattern == pattern and run.loading is None:
            self._goals.offer_again(run.generation)
            self.join_if_settled(effects)

    def on_stop(self, request: verbs.StopRequest | verbs.EstopRequest, effects: Effects) -> None:
        """After a stop or estop: if the request targets all robots, make a goal without pattern."""
        if request.targets is None:
            self._goals.stand(request.id, request.operator, request.age, effects.now)

    def resume(self, request: verbs.ResumeRequest, wish: Wish, effects: Effects) -> None:
        """Run the own goal, or refuse; the caller has checked that the robot may start a run."""
        lifecycle = self._lifecycle
        own = self._goals.own
        if own is None or own.goal.pattern is None:
            text = "there is no goal for it" if own is None else f"{own.goal.text}: nothing to run"
            lifecycle.refuse(effects, request, Refusal.NO_GOAL, text)
        elif request.digest not in ("", own.digest.hex()):
            lifecycle.refuse(effects, request, Refusal.OVERTAKEN, f"it has {own.goal.text}")
        elif self._goals.state in (GoalState.RUNNING, GoalState.LOADING):
            # A late copy of this request must not start a run after the present run has ended.
            lifecycle.raise_revision(f"{request.operator} (resume {own.goal.pattern})")
            lifecycle.applied(effects, request, f"runs {own.goal.pattern} already")
        elif why := self._goals.refusal_to_resume(effects.now):
            text = f"{own.goal.text}: {why}; run it anew"
            lifecycle.refuse(effects, request, Refusal.NO_GOAL, text)
        elif fault := fault_of(own.goal.conditions):
            lifecycle.refuse(effects, request, Refusal.INVALID_CONDITION, fault)
        else:
            lifecycle.raise_revision(f"{request.operator} (resume {own.goal.pattern})")
            self._start(own.goal, effects, wish, own.goal.seconds, request)

    def set_goal(self, request: verbs.GoalRequest, effects: Effects) -> None:
        """Adopt the goal of the request without a run, or refuse."""
        lifecycle = self._lifecycle
        goals = self._goals
        goal = request.goal
        if refusal := goals.overtaken_by(goal):
            lifecycle.refuse(effects, request, *refusal)
            return
        if goal.pattern is None:
            issued = IssueTime.of(request, effects.now - request.age)
            lifecycle.stops.note(issued, request.operator)
        relation = goals.judge(goal)
        if relation is Found.OWN:
            self._take_over(goal, request.age, effects, may_join=False)
        elif relation is Found.OTHER:
            goals.adopt(goal, request.age, effects.now, may_join=False)
        lifecycle.applied(effects, request, f"holds {goal.text}")

    def set_labels(self, request: verbs.LabelRequest, effects: Effects) -> None:
        """Set the labels; adopt the held goal if that goal targets the robot by these labels."""
        lifecycle = self._lifecycle
        goals = self._goals
        lifecycle.raise_revision(f"{request.operator} (label)")
        goals.set_labels(request.labels)
        held = goals.held
        if held is not None and goals.judge_held() is Found.OWN:
            self._take_over(held.goal, held.age(effects.now), effects, may_join=False)
        names = ", ".join(goals.labels) or "no labels"
        lifecycle.applied(effects, request, names)

    def _take_over(
        self, goal: Goal, age: float | None, effects: Effects, *, may_join: bool
    ) -> None:
        """Replace the own goal by the greater `goal`; end the present run and load.

        Only the load of `goal` itself, or of a goal greater than `goal`, continues. The own goal is
        the greatest goal that targets this robot. `age`: s since the goal was set, None if unknown.
        `may_join`: the robot may run `goal` without a request of an operator, if the state of the
        robot permits that.
        """
        lifecycle = self._lifecycle
        goals = self._goals
        now = effects.now
        loading = lifecycle.pattern_run.loading
        if loading is not None and loading.goal == goal:  # the robot loads the pattern of `goal`
            goals.adopt(goal, age, now, may_join=False)
            goals.on_loading()
            return
        loads_greater_goal = _is_for_greater_goal(loading, goal)
        ends_load = loading is not None and not loads_greater_goal
        ends_hand = goal.pattern is None and self._is_after_hand(age, now)
        ends_run_or_load = lifecycle.is_running or ends_load or ends_hand
        was_idle = lifecycle.state_machine.state is State.IDLE
        lifecycle.log(f"found {goal.text}", now)
        if ends_run_or_load:
            lifecycle.raise_revision(goal.text)  # earlier requests become stale
            text = f"by {goal.text}"
            lifecycle.stop(
                Reason.SUPERSEDED,
                text,
                effects,
                keeps_load=loads_greater_goal,
                # A run of the goal waits beneath it; a goal to stand ends the hand.
                keeps_hand=lifecycle.is_driven and goal.pattern is not None,
            )
            goals.superseded = goal.text
        # A stopped, estopped or faulted robot without a run or load waits for an operator.
        waits_for_operator = not (was_idle or ends_run_or_load)
        if waits_for_operator or loads_greater_goal or lifecycle.battery.is_low:
            may_join = False
        goals.adopt(goal, age, now, may_join=may_join)

    def _is_after_hand(self, age: float | None, now: float) -> bool:
        """True if a hand is there, and a goal of this age was set after it, or may have been."""
        hand = self._lifecycle.pattern_run.hand
        if hand is None:
            return False
        return age is None or not IssueTime(now - age).is_surely_before(hand.wish.issued)

    def join_if_settled(self, effects: Effects) -> None:
        """Join the own goal: run it without a request of an operator, if all rules permit that.

        The own goal is the greatest goal that targets this robot. `Goals.joins` has the rules for
        the goal itself, such as its greatest age. During a load or a trial of new code the robot
        does not join: the caller calls again after the end of the load or trial.
        """
        own_goal = self._goals.own
        now = effects.now
        # Until settled, a peer may hold a greater goal that this robot does not know yet.
        if own_goal is None or not self._is_settled or not self._goals.joins(now):
            return
        goal = own_goal.goal
        age = own_goal.age(now)
        if fault_of(goal.conditions) or not self._can_start():
            return
        assert age is not None  # `Goals.joins` demands a known age
        self._raise_revision_to_join(goal)
        self._lifecycle.log(f"joins {goal.text}, set {age:.1f} s ago", now)
        # The time of the run counts from the time at which the goal was set.
        seconds_left = None if goal.seconds is None else goal.seconds - age
        # The run counts as requested when the goal was set: a stop issued since then ends the run.
        wish = Wish(IssueTime(now - age), goal.text)
        self._start(goal, effects, wish, seconds_left, None)

    def _can_start(self) -> bool:
        """True if the present state of the robot permits a run without a request."""
        lifecycle = self._lifecycle
        is_busy = lifecycle.pattern_run.loading is not None or lifecycle.trial is not None
        is_excluded = lifecycle.duplicate is not None or bool(lifecycle.revoked)
        is_blocked = lifecycle.state_machine.state in (State.ESTOPPED, State.FAULTED)
        return not (is_busy or is_excluded or is_blocked or lifecycle.battery.is_low)

    def _raise_revision_to_join(self, goal: Goal) -> None:
        """Make earlier requests stale, except a late request for `goal` itself.

        If a peer handed over `goal`, and nothing else has raised the revision since, then
        `has_goal_by_peer` goes on to accept a late request for `goal`.
        """
        lifecycle = self._lifecycle
        peer_goal = self._peer_goal
        revision_before = lifecycle.revision
        lifecycle.raise_revision(goal.text)
        if peer_goal is None or peer_goal.goal != goal:
            return
        is_only_rise = peer_goal.revision_after == revision_before
        if is_only_rise:
            self._peer_goal = peer_goal._replace(revision_after=lifecycle.revision)

    def _start(
        self,
        goal: Goal,
        effects: Effects,
        wish: Wish,
        seconds: float | None,
        request: verbs.ResumeRequest | None,
    ) -> None:
        assert goal.pattern is not None
        self._goals.on_loading()
        self._lifecycle.start_run(
            goal.pattern,
            goal.params,
            effects,
            wish=wish,
            seconds=seconds,
            until=goal.conditions,
            request=request,
            goal=goal,
        )


def _is_for_greater_goal(loading: Loading | None, goal: Goal) -> bool:
    """True if `loading` loads the pattern of a goal that is greater than `goal`."""
    if loading is None or loading.goal is None:
        return False
    # Only the order of the goals is compared, for which no age is needed (None).
    return HeldGoal.of(loading.goal, None).order > HeldGoal.of(goal, None).order


def fault_of(until: tuple[str, ...]) -> str:
    """The parse error of the conditions that end a run; empty if all are valid."""
    try:
        if until:
            parse_conditions(until)
    except ConfigError as error:
        return str(error)
    return ""

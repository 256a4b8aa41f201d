"""Applies goals to one robot: goals received from peers, and operators' requests on goals. Pure.

A greater goal that targets this robot ends the present run. Only a request starts a run, with one
exception: a goal with `on_join: run` (the rules are in goals.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmd.core import verbs
from swarmd.core.errors import ConfigError
from swarmd.core.goal import Goal, GoalState, HeldGoal
from swarmd.core.messages import Epoch, Reason, Refusal, State
from swarmd.kit.conditions import parse_conditions
from swarmd.robot.goals import Found
from swarmd.robot.pattern_load import Wish
from swarmd.robot.state import Lifecycle

if TYPE_CHECKING:
    from swarmd.robot.effects import Effects


class _PeerGoal(NamedTuple):
    """The last goal for this robot that came from a peer, and the epochs around its adoption."""

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

    def on_goal(self, goal: Goal, age: float | None, effects: Effects, *, may_join: bool) -> None:
        """Take in a goal that a peer holds.

        `age`: s since an operator set the goal, None if unknown. `may_join`: the goals of all other
        peers are known, too, so that the robot may join a run (run without a request of an
        operator).
        """
        goals, now = self._goals, effects.now
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
            self.join_if_settled(effects)

    def is_of_found_goal(self, request: verbs.Request, quoted: Epoch | None) -> bool:
        """True if the epoch has risen only because a peer handed over the goal of this request.

        An operator sends a run or goal request, and the goal may reach the robot by a peer before
        the request. Then the request must not be refused as stale. `quoted`: the epoch of the robot
        in the request. False if anything else has changed the robot since this epoch.
        """
        known = self._peer_goal  # (goal, epoch before the goal came, revision after that)
        if known is None or not isinstance(request, verbs.RunRequest | verbs.GoalRequest):
            return False
        return (request.goal, quoted, self._lifecycle.revision) == known

    def on_new_code(self, pattern: str, effects: Effects) -> None:
        """Join the own goal if the goal waited for `pattern`, which has passed its trial."""
        own, run = self._goals.own, self._lifecycle.pattern_run
        if own is not None and own.goal.pattern == pattern and run.loading is None:
            self._goals.offer_again(run.generation)
            self.join_if_settled(effects)

    def on_stop(self, request: verbs.StopRequest | verbs.EstopRequest, effects: Effects) -> None:
        """After a stop or estop: if the request targets all robots, make a goal without pattern."""
        if request.targets is None:
            self._goals.stand(request.id, request.operator, request.age, effects.now)

    def resume(self, request: verbs.ResumeRequest, wish: Wish, effects: Effects) -> None:
        """Run the own goal, or refuse; the caller has checked that the robot may start a run."""
        lifecycle, own = self._lifecycle, self._goals.own
        if own is None or own.goal.pattern is None:
            text = "there is no goal for it" if own is None else f"{own.goal.text}: nothing to run"
            lifecycle.refuse(effects, request, Refusal.NO_GOAL, text)
        elif request.digest not in ("", own.digest.hex()):
            lifecycle.refuse(effects, request, Refusal.OVERTAKEN, f"it has {own.goal.text}")
        elif self._goals.state in (GoalState.RUNNING, GoalState.LOADING):
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
        lifecycle, goals, goal = self._lifecycle, self._goals, request.goal
        if refusal := goals.overtaken_by(goal):
            lifecycle.refuse(effects, request, *refusal)
            return
        relation = goals.judge(goal)
        if relation is Found.OWN:
            self._take_over(goal, request.age, effects, may_join=False)
        elif relation is Found.OTHER:
            goals.adopt(goal, request.age, effects.now, may_join=False)
        lifecycle.applied(effects, request, f"holds {goal.text}")

    def set_labels(self, request: verbs.LabelRequest, effects: Effects) -> None:
        """Set the labels; adopt the held goal if that goal targets the robot by these labels."""
        lifecycle, goals = self._lifecycle, self._goals
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
        """Replace the own goal by the greater `goal`; end the run, and a load of a lesser goal.

        The own goal is the greatest goal that targets this robot. `age`: s since the goal was set,
        None if unknown. `may_join`: a robot that is idle or running may run `goal` without a
        request of an operator.
        """
        lifecycle, goals, now = self._lifecycle, self._goals, effects.now
        loading = lifecycle.pattern_run.loading
        # 1. The goal of the present load, which was requested or joined, has only become known.
        if loading is not None and loading.goal == goal:
            goals.adopt(goal, age, now, may_join=False)
            goals.on_loading()
            return
        # 2. End the run and the load. A load of a goal that is greater than `goal` continues.
        keeps_load = False
        if loading is not None and loading.goal is not None:
            # `order`: the key by which goals compare, which does not depend on the age (None).
            order_of_load = HeldGoal.of(loading.goal, None).order
            keeps_load = order_of_load > HeldGoal.of(goal, None).order
        ends_load = loading is not None and not keeps_load
        ends_any = lifecycle.is_running or ends_load
        was_idle = lifecycle.state_machine.state is State.IDLE
        lifecycle.log(f"found {goal.text}", now)
        if ends_any:
            lifecycle.raise_revision(goal.text)  # earlier requests become stale
            lifecycle.stop(Reason.SUPERSEDED, f"by {goal.text}", effects, keeps_load=keeps_load)
            goals.superseded = goal.text
        # 3. Take `goal`. A robot that stood for another reason than being idle may not join.
        can_join = (ends_any or was_idle) and not keeps_load and not lifecycle.battery.is_low
        goals.adopt(goal, age, now, may_join=may_join and can_join)

    def join_if_settled(self, effects: Effects) -> None:
        """Join the own goal: run it without a request of an operator, if all rules permit that.

        The own goal is the greatest goal that targets this robot. `Goals.joins` has the rules for
        the goal itself, such as its greatest age. During a load or a trial of new code the robot
        does not join: the caller calls again after the end of the load or trial.
        """
        lifecycle, goals, now = self._lifecycle, self._goals, effects.now
        # 1. Reasons of the goal not to join: another peer may hold a greater goal that is not known
        #    yet, there is no goal to join, or the end conditions of the goal are invalid.
        own_goal = goals.own
        if not self._is_settled or own_goal is None or not goals.joins(now):
            return
        if fault_of(own_goal.goal.conditions):
            return
        # 2. Reasons of the robot not to join: a load or trial, a second robot with the same id, the
        #    swarm has revoked this robot, or its battery is low.
        is_busy = lifecycle.pattern_run.loading is not None or lifecycle.trial is not None
        is_barred = lifecycle.duplicate is not None or bool(lifecycle.revoked)
        if is_busy or is_barred or lifecycle.battery.is_low:
            return
        if lifecycle.state_machine.state in (State.ESTOPPED, State.FAULTED):
            return
        # 3. Raise the revision, so that earlier requests are stale. Exception: a late request for
        #    this same goal stays acceptable if nothing else has changed since the goal came.
        #    (`_PeerGoal.revision_after`: the revision at which such a request is still taken.)
        peer_goal, revision_before = self._peer_goal, lifecycle.revision
        age_s = own_goal.age(now) or 0.0  # an unknown age counts as 0
        lifecycle.raise_revision(own_goal.goal.text)
        lifecycle.log(f"joins {own_goal.goal.text}, set {age_s:.1f} s ago", now)
        if peer_goal is not None and peer_goal.goal == own_goal.goal:
            has_changed_since = peer_goal.revision_after != revision_before
            if not has_changed_since:
                self._peer_goal = peer_goal._replace(revision_after=lifecycle.revision)
        # 4. Run for the rest of the goal's time, which counts from the time the goal was set.
        seconds = own_goal.goal.seconds
        seconds_left = None if seconds is None else seconds - age_s
        # The run counts as requested when the goal was set: a stop issued since then ends the run.
        wish = Wish(now - age_s, own_goal.goal.text)
        self._start(own_goal.goal, effects, wish, seconds_left, None)

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


def fault_of(until: tuple[str, ...]) -> str:
    """The parse error of the conditions that end a run; empty if all are valid."""
    try:
        if until:
            parse_conditions(until)
    except ConfigError as error:
        return str(error)
    return ""

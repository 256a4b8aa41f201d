"""What goals do to a robot: those that peers hand on, and the requests of operators on goals. Pure.

A greater goal for this robot ends its run. Only a request starts a run, but for a goal with
`on_join: run`, see goals.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

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


class GoalHandler:
    """Applies goals to the lifecycle of one robot."""

    def __init__(self, lifecycle: Lifecycle) -> None:
        self._lifecycle = lifecycle
        self._goals = lifecycle.goals
        # The goal that was found last, the epoch before that, and the revision that it led to.
        self._found: tuple[Goal, Epoch, int] | None = None
        self._is_settled = False  # what the other peers hold is known since the own goal was found

    def on_goal(self, goal: Goal, age: float | None, effects: Effects, *, may_join: bool) -> None:
        """A peer holds this goal, set `age` s ago (None: not known).

        `may_join`: what the other peers hold is known, too, so that the robot may join a run.
        """
        goals, now = self._goals, effects.now
        found = goals.judge(goal)
        if found is Found.OWN:
            before = self._lifecycle.epoch
            self._take_over(goal, age, effects, may_join=True)
            self._found = goal, before, self._lifecycle.revision
            self._is_settled = False
        elif found is Found.OTHER:
            goals.adopt(goal, age, now, may_join=False)
        elif found is Found.AGED or goals.is_held(goal):
            goals.learn_age(age, now)
        if may_join:
            self._is_settled = True
            self.join_if_settled(effects)

    def is_of_found_goal(self, request: verbs.Request, quoted: Epoch | None) -> bool:
        """True for a run or a goal that came from a peer sooner than by this request.

        Nothing else has changed the robot since the operator looked at it, at the epoch `quoted`.
        """
        if self._found is None or not isinstance(request, verbs.RunRequest | verbs.GoalRequest):
            return False
        goal, before, after = self._found
        return (request.goal, quoted, self._lifecycle.revision) == (goal, before, after)

    def on_new_code(self, pattern: str, effects: Effects) -> None:
        """A pushed pattern has passed its trial: the robot may join a goal that waited for it."""
        own, run = self._goals.own, self._lifecycle.pattern_run
        if own is not None and own.goal.pattern == pattern and run.loading is None:
            self._goals.offer_again(run.generation)
            self.join_if_settled(effects)

    def on_stop(self, request: verbs.StopRequest | verbs.EstopRequest, effects: Effects) -> None:
        """A stop or estop was carried out: one of all robots makes a goal without a pattern."""
        if request.targets is None:
            self._goals.stand(request.id, request.operator, request.age, effects.now)

    def resume(self, request: verbs.ResumeRequest, wish: Wish, effects: Effects) -> None:
        """Run the own goal; the caller has checked that the robot may run."""
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
        """Take a goal over without a run."""
        lifecycle, goals, goal = self._lifecycle, self._goals, request.goal
        if refusal := goals.overtaken_by(goal):
            lifecycle.refuse(effects, request, *refusal)
            return
        found = goals.judge(goal)
        if found is Found.OWN:
            self._take_over(goal, request.age, effects, may_join=False)
        elif found is Found.OTHER:
            goals.adopt(goal, request.age, effects.now, may_join=False)
        lifecycle.applied(effects, request, f"holds {goal.text}")

    def set_labels(self, request: verbs.LabelRequest, effects: Effects) -> None:
        """Set the labels; the held goal may target the robot by its new labels."""
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
        """Adopt a greater goal for this robot; a run of a lesser one ends.

        A requested run that is being loaded for a goal greater than this one goes on loading.
        """
        lifecycle, goals, now = self._lifecycle, self._goals, effects.now
        loading = lifecycle.pattern_run.loading
        if loading is not None and loading.goal == goal:  # asked for, and heard of from a peer
            goals.adopt(goal, age, now, may_join=False)
            goals.on_loading()
            return
        wanted = None if loading is None else loading.goal
        order = HeldGoal.of(goal, None).order
        keeps_load = wanted is not None and HeldGoal.of(wanted, None).order > order
        is_active = lifecycle.is_running or (loading is not None and not keeps_load)
        is_free = is_active or lifecycle.state_machine.state is State.IDLE
        lifecycle.log(f"found {goal.text}", now)
        if is_active:
            lifecycle.raise_revision(goal.text)
            lifecycle.stop(Reason.SUPERSEDED, f"by {goal.text}", effects, keeps_load=keeps_load)
            goals.superseded = goal.text
        goals.adopt(goal, age, now, may_join=may_join and is_free and not keeps_load)

    def join_if_settled(self, effects: Effects) -> None:
        """Run the own goal, which was found, if it wants that and is young enough.

        A load or a trial that is under way delays the run until its end.
        """
        lifecycle, goals, now = self._lifecycle, self._goals, effects.now
        if not self._is_settled:
            return
        own, trial, found = goals.own, lifecycle.trial, self._found
        if own is None or not goals.joins(now) or lifecycle.pattern_run.loading or trial:
            return
        if lifecycle.duplicate is not None or lifecycle.revoked or fault_of(own.goal.conditions):
            return
        if lifecycle.state_machine.state in (State.ESTOPPED, State.FAULTED):
            return
        is_found = found is not None and found[0] == own.goal
        is_unchanged = found is not None and found[2] == lifecycle.revision
        seconds, age = own.goal.seconds, own.age(now) or 0.0
        lifecycle.raise_revision(own.goal.text)
        lifecycle.log(f"joins {own.goal.text}, set {age:.1f} s ago", now)
        if found is not None and is_found and is_unchanged:
            self._found = found[0], found[1], lifecycle.revision
        left = None if seconds is None else seconds - age
        self._start(own.goal, effects, Wish(now - age, own.goal.text), left, None)

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
    """What is wrong with the conditions that end a run; empty if nothing."""
    try:
        if until:
            parse_conditions(until)
    except ConfigError as error:
        return str(error)
    return ""

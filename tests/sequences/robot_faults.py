"""Faults that are planted in the robot, so that the searches are known to find faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from swarmd.core.events import TickInput
from swarmd.core.goal import GoalState
from swarmd.core.hazard import HazardKind
from swarmd.core.messages import Reason
from swarmd.core.values import Twist
from swarmd.robot import hazard_holds, requests, robot, state
from swarmd.robot.actions import Actions
from swarmd.robot.goals import Goals
from swarmd.robot.hand import Hand
from swarmd.robot.issue_time import KnownStops
from swarmd.robot.latches import Latches
from swarmd.robot.requests import RequestHandler
from swarmd.robot.robot import HANDLERS, Robot
from swarmd.robot.state import Lifecycle

if TYPE_CHECKING:
    from swarmd.robot.effects import Effects

Put = Callable[[Any, str, Any], None]
"""`setattr`, or one that a test undoes."""


@dataclass(frozen=True)
class Fault:
    """A row of `FAULTS`. `plant` breaks the robots of this process in one place.

    `rule`, `shortest`: the rule that it breaks, and the shortest sequence that shows it, by hand.
    """

    name: str
    text: str
    plant: Callable[[Put], None]
    rule: str
    shortest: tuple[str, ...]


def _keep_run(put: Put) -> None:
    stop = Lifecycle.stop

    def faulty(
        one: Lifecycle, reason: Reason, detail: str, effects: Effects, **fields: Any
    ) -> None:
        if reason is not Reason.OPERATOR:
            stop(one, reason, detail, effects, **fields)

    put(Lifecycle, "stop", faulty)


def _resume_ends_latches(put: Put) -> None:
    resume = RequestHandler.on_resume

    def faulty(one: RequestHandler, request: Any, effects: Effects) -> None:
        one._lifecycle.latches.clear(tuple(one._lifecycle.latches.held))
        one._lifecycle.reset("", effects)
        resume(one, request, effects)

    put(RequestHandler, "on_resume", faulty)


def _move_idle(put: Put) -> None:
    def faulty(one: Robot, input: TickInput, now: float) -> Actions:
        actions = one._on_tick(input, now)
        return actions if one.is_running else replace(actions, twist=Twist(0.1))

    put(robot, "HANDLERS", {**HANDLERS, TickInput: faulty})


def _join_any_goal(put: Put) -> None:
    put(Goals, "joins", lambda one, now: one.state is GoalState.OFFERED)


def _forget_lift(put: Put) -> None:
    put(hazard_holds, "ENDS_RUN", frozenset({HazardKind.WHEEL_DROP}))


def _never_lose(put: Put) -> None:
    put(Hand, "due_at", property(lambda one: math.inf))


_ROWS = (
    Fault(
        "keep_hand",
        "a stop is acknowledged, and the hand drives on",
        lambda put: put(Lifecycle, "drop_hand", lambda one, text, effects: None),
        "stopped",
        ("take", "stop"),
    ),
    Fault(
        "never_lose",
        "the last command of a silent driver goes on",
        _never_lose,
        "hand",
        ("take", "silent"),
    ),
    Fault(
        "keep_run",
        "a stop is acknowledged, and the run goes on",
        _keep_run,
        "stopped",
        ("run", "stop"),
    ),
    Fault(
        "older_run",
        "a run counts though it was typed before a stop",
        lambda put: put(KnownStops, "later_than", lambda one, start: ""),
        "later_run",
        ("stop", "old_run"),
    ),
    Fault(
        "any_epoch",
        "the epoch of a request is not compared",
        lambda put: put(RequestHandler, "_refusal_of", lambda one, request: None),
        "late",
        ("run", "copy"),
    ),
    Fault("move_idle", "a robot that does not run commands motion", _move_idle, "zero", ("stop",)),
    Fault(
        "say_rest",
        "the answer to a stop says that the base rests",
        lambda put: put(RequestHandler, "_is_at_rest", lambda one, now: True),
        "answer",
        ("run", "stop"),
    ),
    Fault(
        "resume_ends_latches",
        "a resume ends the latches",
        _resume_ends_latches,
        "latch",
        ("estop", "resume"),
    ),
    Fault(
        "latch_again",
        "another robot's copy latches what was reset",
        lambda put: put(Latches, "is_cleared", lambda one, id: False),
        "latch",
        ("estop", "reset", "copy"),
    ),
    Fault(
        "long_hold",
        "a run waits for its base for a minute",
        lambda put: put(state, "MAX_HOLD_TIME", 60.0),
        "lost_base",
        ("run", "driver", "driver"),
    ),
    Fault(
        "outlive_stall",
        "a run goes on after a stall of the daemon",
        lambda put: put(Lifecycle, "stall", lambda one, late, effects: None),
        "lost_base",
        ("run", "freeze"),
    ),
    Fault("forget_lift", "a lift ends no run", _forget_lift, "hold", ("run", "hazard:lifted")),
    Fault("join_any_goal", "any goal is joined", _join_any_goal, "old_goal", ("peer_goal:old",)),
    Fault(
        "obey_older_stop",
        "a copy of a stop ends a run that was typed after it",
        lambda put: put(requests._StopTime, "is_before", lambda one, wish: False),
        "cause",
        ("stop", "run", "copy"),
    ),
)
FAULTS: Mapping[str, Fault] = {row.name: row for row in _ROWS}

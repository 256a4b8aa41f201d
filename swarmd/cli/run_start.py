"""Starts of runs: at once, at one moment, or a canary first."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import click
from msgspec.structs import replace

from swarmd.cli.canary import watch_canary
from swarmd.cli.options import Failure
from swarmd.cli.output import warn
from swarmd.cli.send import Asked, stop_names, stop_on_interrupt, time_left
from swarmd.cli.targets import Targets
from swarmd.core.clock import TICK, boottime
from swarmd.core.record import LABEL
from swarmd.core.verbs import GoalRequest, RunRequest
from swarmd.network.exit_codes import FAILED, PARTIAL
from swarmd.network.operator.clock_query import read_clocks, start_times
from swarmd.network.operator.outcome import Outcome
from swarmd.network.operator.request_sender import REQUEST_WAIT
from swarmd.network.spread.operator_goals import next_generation, resigned
from swarmd.texts.values import seconds as in_short

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch
    from swarmd.network.operator.operator import Operator


def goal_targets(targets: Targets, names: Collection[str]) -> tuple[str, ...]:
    """The targets of a goal: as they were typed, so that robots that join later are among them.

    With excluded robots, the names that are left.
    """
    if targets.exclude:
        return tuple(sorted(names))
    return (*targets.names, *(f"{LABEL}{label}" for label in targets.labels))


def send_goal(
    operator: Operator, epochs: Mapping[str, Epoch | None], goal: Goal, **fields: Any
) -> Outcome:
    """Send a goal: its run, or the goal alone if it has no pattern."""
    if goal.pattern is None:
        return operator.request(GoalRequest, epochs, goal=goal, **fields)
    return operator.request(
        RunRequest,
        epochs,
        pattern=goal.pattern,
        params=goal.params,
        seconds=goal.seconds,
        until=goal.conditions,
        goal=goal,
        **fields,
    )


def start(asked: Asked, goal: Goal) -> Outcome:
    """Send the run of a goal to all targets."""
    epochs, wait = asked.view.epochs(asked.names), time_left(asked.options, asked.view)
    return send_goal(asked.operator, epochs, goal, timeout=wait)


def start_at(asked: Asked, goal: Goal, at: float) -> NoReturn:
    """Send the run of a goal, let all targets start at one moment, in `at` s, and report.

    A robot whose clock is not known is not asked, and counts as missing.
    """
    operator, wait = asked.operator, time_left(asked.options, asked.view)
    if wait is not None and wait <= at:
        raise click.UsageError(f"--timeout is too short for a start in {in_short(at)}")
    offsets = read_clocks(operator, asked.names)
    starts, skew = start_times(offsets, boottime() + at)
    epochs = {name: one for name, one in asked.view.epochs(asked.names).items() if name in starts}
    unknown = tuple(sorted(set(asked.names) - epochs.keys()))
    if unknown:
        warn(f"not asked, since their clocks did not answer: {', '.join(unknown)}")
    if len(starts) > 1:
        warn(
            f"start in {in_short(at)}: robots start at most {1e3 * (skew + TICK):.0f} ms apart,"
            f" {1e3 * skew:.1f} ms of it by their clocks"
        )
    try:
        least = REQUEST_WAIT + at
        outcome = send_goal(operator, epochs, goal, timeout=wait, least=least, at=starts)
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(operator, epochs)  # they would start without an operator who wants it
        raise
    errors = {name: round(one.error, 6) for name, one in offsets.items()}
    notes = {"start": {"in": at, "skew": round(skew, 6), "clocks": errors}}
    asked.report(replace(outcome, missing=tuple(sorted((*outcome.missing, *unknown)))), notes)


def run_with_canary(
    asked: Asked, goal: Goal, canaries: tuple[str, ...], seconds: float
) -> NoReturn:
    """Run a goal on canaries, then on all; report, and stop the canaries if one fails.

    The goal of the canaries is one for them alone, so that it ends no run of another robot.
    """
    options, operator, view = asked.options, asked.operator, asked.view
    own, wait = resigned(operator, goal, targets=canaries), time_left(options, view)
    outcome = send_goal(operator, view.epochs(canaries), own, timeout=wait)
    if len(outcome.applied) < len(canaries):
        stop_names(operator, canaries)
        warn(f"canary: {', '.join(canaries)} did not start; nothing was sent to the others")
        asked.report(outcome)
    warn(f"canary: {', '.join(canaries)} for {in_short(seconds)}")
    before = {name: view.members[name].status for name in canaries if name in view.members}
    try:
        faults = watch_canary(operator, canaries, seconds, before)
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(operator, canaries)
        raise
    if faults:
        _fail(operator, canaries, faults, len(asked.names))
    others = tuple(name for name in asked.names if name not in canaries)
    later = operator.members(timeout=options.timeout)
    goal = resigned(operator, goal, generation=next_generation(operator, later))
    # A robot that was stopped, or changed otherwise, while the canaries ran refuses.
    epochs = view.epochs(others) | {name: outcome.replies[name].epoch for name in canaries}
    outcome = send_goal(operator, epochs, goal, timeout=options.timeout)
    asked.report(outcome, {"canary": list(canaries), "others": list(others)})


def _fail(
    operator: Operator, canaries: tuple[str, ...], faults: Mapping[str, str], targeted: int
) -> NoReturn:
    stopped = stop_names(operator, canaries)
    why = "; ".join(f"{name}: {fault}" for name, fault in faults.items())
    missing = ", ".join(stopped.missing)
    end = f"{missing} DID NOT ACKNOWLEDGE THE STOP" if missing else "it was stopped"
    others = targeted - len(canaries)
    rest = f"the other {others} robots" if others > 1 else "the other robot"
    text = f"canary failed: {why}; {end}; nothing was sent to {rest}"
    raise Failure(text, PARTIAL if missing else FAILED)

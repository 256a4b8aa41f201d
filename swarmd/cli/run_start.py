"""Starts of runs: at once, at one moment, or a canary first."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import click
from msgspec.structs import replace

from swarmd.cli.arguments import Failure, Targets
from swarmd.cli.canary import watch_canary
from swarmd.cli.output import warn
from swarmd.cli.send import report, stop_names, stop_on_interrupt, time_left
from swarmd.core.clock import TICK, boottime
from swarmd.core.record import LABEL
from swarmd.core.verbs import RunRequest
from swarmd.network.exit_codes import FAILED, PARTIAL
from swarmd.network.operator.clock_query import read_clocks, start_times
from swarmd.network.operator.outcome import Outcome
from swarmd.network.operator.request_sender import REQUEST_WAIT
from swarmd.network.spread.next_goal import next_generation, resigned
from swarmd.texts.values import seconds as in_short

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions
    from swarmd.core.bounds import ParamValues
    from swarmd.core.goal import Goal
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator


@dataclass(frozen=True, slots=True)
class RunPlan:
    """What is to run, how it ends, and what robots do that join later."""

    pattern: str
    params: ParamValues
    seconds: float | None = None
    until: tuple[str, ...] = ()
    on_join: str = "offer"
    valid: float | None = None
    lease: float | None = None

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of its goal."""
        return {
            "pattern": self.pattern,
            "params": self.params,
            "seconds": self.seconds,
            "conditions": self.until,
            "on_join": self.on_join,
            "valid": self.valid,
            "lease": self.lease,
        }


def goal_targets(targets: Targets, names: Collection[str]) -> tuple[str, ...]:
    """The targets of a goal: as they were typed, so that robots that join later are among them.

    With excluded robots, the names that are left.
    """
    if targets.exclude:
        return tuple(sorted(names))
    return (*targets.names, *(f"{LABEL}{label}" for label in targets.labels))


def start(
    options: CommonOptions,
    operator: Operator,
    view: MembersView,
    goal: Goal,
    names: Collection[str],
    *,
    at: float | None = None,
    timeout: float | None = None,
) -> tuple[Outcome, dict[str, Any]]:
    """Send the run of a goal to robots; returns the outcome, and what is to be said of the start.

    `at`: seconds from now until they start at one moment. A robot whose clock is not known is not
    asked, and counts as missing.
    """
    wait = time_left(options, view) if timeout is None else timeout
    epochs = view.epochs(names)
    fields = run_fields(goal)
    if at is None:
        return operator.request(RunRequest, epochs, timeout=wait, **fields), {}
    if wait is not None and wait <= at:
        raise click.UsageError(f"--timeout is too short for a start in {in_short(at)}")
    offsets = read_clocks(operator, names)
    starts, skew = start_times(offsets, boottime() + at)
    known = {name: epoch for name, epoch in epochs.items() if name in starts}
    unknown = tuple(sorted(epochs.keys() - known.keys()))
    if unknown:
        warn(f"not asked, since their clocks did not answer: {', '.join(unknown)}")
    if len(starts) > 1:
        warn(
            f"start in {in_short(at)}: robots start at most {1e3 * (skew + TICK):.0f} ms apart,"
            f" {1e3 * skew:.1f} ms of it by their clocks"
        )
    try:
        outcome = operator.request(
            RunRequest, known, timeout=wait, least=REQUEST_WAIT + at, at=starts, **fields
        )
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(operator, known)  # they would start without an operator who wants it
        raise
    notes = {"start": {"in": at, "skew": round(skew, 6), "clocks": _errors(offsets)}}
    return replace(outcome, missing=tuple(sorted((*outcome.missing, *unknown)))), notes


def run_fields(goal: Goal) -> dict[str, Any]:
    """The fields of the request that runs a goal."""
    return {
        "pattern": goal.pattern,
        "params": goal.params,
        "seconds": goal.seconds,
        "until": goal.conditions,
        "goal": goal,
    }


def run_with_canary(
    options: CommonOptions,
    operator: Operator,
    view: MembersView,
    goal: Goal,
    names: Collection[str],
    canaries: tuple[str, ...],
    seconds: float,
    unlabelled: tuple[str, ...] = (),
) -> NoReturn:
    """Run a goal on canaries, then on all; report, and stop the canaries if one fails.

    The goal of the canaries is one for them alone, so that it ends no run of another robot.
    """
    own = resigned(operator, goal, targets=canaries)
    outcome, _ = start(options, operator, view, own, canaries)
    if len(outcome.applied) < len(canaries):
        stop_names(operator, canaries)
        warn(f"canary: {', '.join(canaries)} did not start; nothing was sent to the others")
        report(options, outcome)
    warn(f"canary: {', '.join(canaries)} for {in_short(seconds)}")
    before = {name: view.members[name].status for name in canaries if name in view.members}
    try:
        faults = watch_canary(operator, canaries, seconds, before)
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(operator, canaries)
        raise
    if faults:
        _fail(operator, canaries, faults, len(names))
    others = tuple(name for name in names if name not in canaries)
    later = operator.members(timeout=options.timeout)
    goal = resigned(operator, goal, generation=next_generation(operator, later))
    # A robot that was stopped, or changed otherwise, while the canaries ran refuses.
    epochs = view.epochs(others) | {name: outcome.replies[name].epoch for name in canaries}
    fields, wait = run_fields(goal), options.timeout
    outcome = operator.request(RunRequest, epochs, timeout=wait, **fields)
    outcome = replace(outcome, unlabelled=unlabelled)
    report(options, outcome, {"canary": list(canaries), "others": list(others)})


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


def _errors(offsets: Mapping[str, Any]) -> dict[str, float]:
    return {name: round(one.error, 6) for name, one in offsets.items()}

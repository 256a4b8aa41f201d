"""Starts a run on all robots at one moment, by the clock of each robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec.structs import replace

from swarmd.core.clock import TICK, boottime
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.operator.session.clocks import read_clocks, start_times
from swarmd.operator.session.senders import REQUEST_WAIT
from swarmd.operator.texts.values import seconds
from swarmd.operator.verbs.run import words
from swarmd.operator.verbs.run.send_goal import send_goal
from swarmd.operator.verbs.stop.ask import stop_on_interrupt

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import TargetedView


class _Start(NamedTuple):
    """The moment at which all robots start."""

    delay: float  # s from the call of `start_at`
    here: float  # s on the clock of this machine
    by_robot: Mapping[str, float]  # s on the clock of each robot whose clock has answered


def start_at(
    targeted: TargetedView, goal: Goal, at: float
) -> tuple[Outcome, Mapping[str, Mapping[str, Any]]]:
    """Send the run of a goal, so that all robots start at one moment, in `at` s.

    Each robot gets the moment of the start on its own clock, whose offset is measured. A robot
    whose clock does not answer gets no request, and counts as missing. Returns the outcome, and
    notes on the start: `in` and `skew` (between robots) in s, and the error of each clock in s.

    Raises ConfigError if the timeout ends before the start. Raises SwarmError if the session is
    cancelled before the start; robots that have accepted the run are then stopped.
    """

    session = targeted.session
    timeout = targeted.time_left
    if timeout is not None and timeout <= at:
        raise ConfigError(f"the timeout is too short for a start in {seconds(at)}")

    offsets = read_clocks(targeted.operator, targeted.names)
    here = boottime() + at
    by_robot, skew = start_times(offsets, here)
    without_clock = sorted(name for name in targeted.names if name not in by_robot)
    if without_clock:
        session.tell(words.without_clock(without_clock))
    if len(by_robot) > 1:  # a robot starts at its first tick after the moment: up to TICK later
        session.tell(words.start(at, skew + TICK, skew))
    session.check_awaited()
    outcome = _send_start(targeted, goal, _Start(at, here, by_robot))
    errors = {name: round(offset.error, 6) for name, offset in offsets.items()}
    notes = {"start": {"in": at, "skew": round(skew, 6), "clocks": errors}}
    return replace(outcome, missing=tuple(sorted((*outcome.missing, *without_clock)))), notes


def _send_start(targeted: TargetedView, goal: Goal, start: _Start) -> Outcome:
    """Send the run of a goal to the robots of `start`, and wait until all robots have replied.

    If the session is cancelled before the start, robots that have accepted the run are stopped, and
    SwarmError is raised.
    """
    session = targeted.session
    # A robot that has changed since the look (by its epoch, a count of changes) refuses the run.
    epochs = targeted.view.epochs(name for name in targeted.names if name in start.by_robot)
    is_withdrawn = False  # the last result of `is_cancelled_before_start`

    def is_cancelled_before_start() -> bool:
        """True ends the wait for replies."""
        nonlocal is_withdrawn
        is_withdrawn = session.is_cancelled() and boottime() < start.here
        return is_withdrawn

    try:
        outcome = send_goal(
            session,
            epochs,
            goal,
            timeout=targeted.time_left,
            least_timeout=REQUEST_WAIT + start.delay,  # robots reply when they start
            is_ended=is_cancelled_before_start,
            at=start.by_robot,
            ahead=start.delay,
        )
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(session, epochs)  # else the robots would start without their operator
        raise

    # A robot replies when it starts, or at once if it refuses. So each reply before the start is a
    # refusal, and a robot without a reply would start.
    would_start = epochs.keys() - outcome.replies.keys()
    # A wait that ends since this process stood still has not asked for a cancellation.
    if would_start and (is_withdrawn or is_cancelled_before_start()):
        raise SwarmError(stop_on_interrupt(session, would_start, "start cancelled"))
    return outcome

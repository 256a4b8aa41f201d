"""Starts runs: at once, at one moment, with canaries first, or under a lease."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.clock import TICK, boottime
from swarmd.core.errors import ConfigError, RequestError, SwarmError, unknown
from swarmd.core.keys import is_id
from swarmd.core.record import LABEL
from swarmd.core.verbs import MAX_AHEAD, MAX_PLANNED, GoalRequest, RunRequest
from swarmd.link.keys.roster import Role
from swarmd.operator.session.arguments import check_time
from swarmd.operator.session.clock_query import read_clocks, start_times
from swarmd.operator.session.exit_codes import FAILED, PARTIAL
from swarmd.operator.session.operator_goals import next_generation, next_goal, signed_again
from swarmd.operator.session.request_sender import REQUEST_WAIT
from swarmd.operator.texts.values import seconds as in_short
from swarmd.operator.verbs.stop.ask import stop_names, stop_on_interrupt
from swarmd.plugins import is_pattern_path

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch, Status
    from swarmd.operator.client.run_lease import LeaseKeeper
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import Session, TargetedView
    from swarmd.operator.session.targets import Targets
    from swarmd.operator.texts.assignments import Value

ON_JOIN = ("offer", "run")
# s
MIN_LEASE = 1.0
MAX_LEASE = 3600.0


class Run(Struct, frozen=True, kw_only=True):
    """The options of a run, as `swarmctl run`, `Swarm.run` and the page give them.

    Call `check` before robots are asked, and then `carry_out`. Times are in s.
    """

    pattern: str
    params: Mapping[str, Value] = {}
    seconds: float | None = None  # duration of the run; None: until a stop
    conditions: tuple[str, ...] = ()  # conditions of `--until`: the first that is met ends the run
    on_join: str = "offer"  # what robots that join do; "run": they run the goal within `valid`
    valid: float | None = None  # s from now on
    lease: float | None = None  # s without a renewal after which robots stop
    at: float | None = None  # s from now at which all robots start
    canary: int | str | None = None  # the number, or the name, of robots that run first
    canary_time: float | None = None  # s for which only canaries run; None: CANARY_TIME

    def check(self, option: Callable[[str], str] = str) -> None:
        """Raise ConfigError for values that are not valid, or do not go together.

        `option` returns the name of an option as the user writes it.
        """
        if isinstance(self.pattern, str) and is_pattern_path(self.pattern):
            raise ConfigError(
                f"{self.pattern!r} is a path, and robots run what they have: send the file by"
                f" `swarmctl plugin push {self.pattern} ..`, then run it by its name"
            )
        if not isinstance(self.pattern, str) or not is_id(self.pattern):
            raise ConfigError(f"{self.pattern!r} is no pattern name; expected a-z, 0-9, _ and -")
        if self.on_join not in ON_JOIN:
            raise ConfigError(unknown(option("on_join"), str(self.on_join), ON_JOIN))
        for name in ("seconds", "at", "lease", "valid", "canary_time"):
            check_time(option(name), getattr(self, name))
        if self.conditions:
            from swarmd.kit.conditions import parse_conditions

            parse_conditions(self.conditions)
        self._check_together(option)

    def _check_together(self, option: Callable[[str], str]) -> None:
        if self.on_join == "run" and self.valid is None:
            raise ConfigError(
                f"{option('on_join')} run needs {option('valid')}: how long robots that join may"
                " start by themselves"
            )
        if self.valid is not None and self.on_join != "run":
            add = f"add {option('on_join')} run"
            raise ConfigError(f"{option('valid')} is how long robots that join run it: {add}")
        if self.lease is not None and not MIN_LEASE <= self.lease <= MAX_LEASE:
            raise ConfigError(
                f"{option('lease')}: expected at least {MIN_LEASE:.0f}s, at most {MAX_LEASE:.0f}s"
            )
        if self.at is not None and not 0.0 < self.at <= MAX_AHEAD:
            raise ConfigError(f"{option('at')}: expected at most {MAX_AHEAD:.0f} s from now on")
        if self.canary_time is not None and self.canary_time > MAX_PLANNED:
            raise ConfigError(f"{option('canary_time')}: expected at most {MAX_PLANNED:.0f} s")
        if self.canary is None and self.canary_time is not None:
            raise ConfigError(f"{option('canary_time')}: expected {option('canary')}, too")
        if sum(value is not None for value in (self.at, self.canary, self.lease)) > 1:
            names = f"{option('at')}, {option('canary')} and {option('lease')}"
            raise ConfigError(f"{names} do not go together; take one of them")

    def goal(self, targeted: TargetedView, targets: Collection[str]) -> Goal:
        """The goal of this run, greater than all goals that the look has shown."""
        return next_goal(
            targeted.operator,
            targeted.view,
            targets=tuple(targets),
            pattern=self.pattern,
            params=self.params,
            seconds=self.seconds,
            conditions=self.conditions,
            on_join=self.on_join,
            valid=self.valid,
            lease=self.lease,
        )


class StartedRun(NamedTuple):
    """A run that was started."""

    goal: Goal
    outcome: Outcome
    notes: Mapping[str, Any] = {}  # further fields of the JSON answer
    keeper: LeaseKeeper | None = None  # renews the lease of the run; None without a lease


def carry_out(
    run: Run,
    targeted: TargetedView,
    targets: Collection[str],
    opened: ExitStack,
    option: Callable[[str], str] = str,
) -> StartedRun:
    """Start a run, whose options `Run.check` has checked, on the robots of `targeted`.

    `targets`: the targets of the goal, which may be globs and labels. `opened`: until the end of
    this stack a thread renews the lease of the run. `option` returns the name of an option as the
    user writes it. Raises the errors of `choose_canaries`, `start_at` and `run_with_canary`.
    """
    canaries: tuple[str, ...] = ()
    if run.canary is not None:
        from swarmd.operator.client.canary import choose_canaries

        canaries = choose_canaries(run.canary, targeted.names, option("canary"))
    if has_permit(targeted.operator):
        _check_for_permit(run, option)
    goal = run.goal(targeted, targets)

    # `Run.check` permits only one of canary, `at` and lease.
    if canaries:
        return StartedRun(goal, *run_with_canary(targeted, goal, canaries, run.canary_time))
    if run.at is not None:
        return StartedRun(goal, *start_at(targeted, goal, run.at))
    keeper = None
    if run.lease is not None:
        from swarmd.operator.client.run_lease import LeaseKeeper

        keeper = LeaseKeeper(
            targeted.operator,
            goal.id,
            run.lease,
            targeted.names,
            is_owned=targeted.session.is_owned,
        )
        keeper.start()
        opened.callback(keeper.close)
    # A robot that has changed since the look (by its epoch, a count of changes) refuses the run.
    epochs = targeted.view.epochs(targeted.names)
    outcome = send_goal(targeted.session, epochs, goal, timeout=targeted.time_left)
    return StartedRun(goal, outcome, keeper=keeper)


def has_permit(operator: Operator) -> bool:
    """True if the key of this operator has a permit, which lets it set no goal."""
    return operator.identity is not None and operator.identity.role is Role.PERMIT


def check_sets_goals(operator: Operator, verb: str) -> None:
    """Raise ConfigError for a key that may set no goal. `verb`: what the user asked for."""
    if has_permit(operator):
        raise ConfigError(
            f"{verb} sets a goal, and a key with a permit ({operator.name}) sets none"
        )


def _check_for_permit(run: Run, option: Callable[[str], str]) -> None:
    """Raise ConfigError for options of a goal, which no permit permits."""
    if run.on_join != "offer" or run.lease is not None:
        name = "lease" if run.lease is not None else "on_join"
        raise ConfigError(
            f"{option(name)} is of a goal, and a key with a permit sets none; bound the run by"
            f" {option('seconds')}"
        )


def goal_targets(targets: Targets, names: Collection[str]) -> tuple[str, ...]:
    """The targets of a goal: globs and labels as typed, so that robots that join later match.

    With excluded robots: the names of the remaining robots.
    """
    if targets.exclude:
        return tuple(sorted(names))
    return (*targets.names, *(f"{LABEL}{label}" for label in targets.labels))


def send_goal(
    session: Session, epochs: Mapping[str, Epoch | None], goal: Goal, **fields: Any
) -> Outcome:
    """Send a goal to robots: as a run request, or as a goal request if it has no pattern.

    The request counts as issued when the verb of `session` began. A key with a permit sends the run
    without the goal: such a run is of the asked robots alone, and nothing spreads.
    """
    request = session.operator.request
    began = session.began
    if goal.pattern is None:
        return request(GoalRequest, epochs, issued=began, goal=goal, **fields)
    return request(
        RunRequest,
        epochs,
        issued=began,
        pattern=goal.pattern,
        params=goal.params,
        seconds=goal.seconds,
        until=goal.conditions,
        goal=None if has_permit(session.operator) else goal,
        **fields,
    )


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
        raise ConfigError(f"the timeout is too short for a start in {in_short(at)}")

    offsets = read_clocks(targeted.operator, targeted.names)
    here = boottime() + at
    by_robot, skew = start_times(offsets, here)
    without_clock = sorted(name for name in targeted.names if name not in by_robot)
    if without_clock:
        session.tell(f"not asked, since their clocks did not answer: {', '.join(without_clock)}")
    if len(by_robot) > 1:  # a robot starts at its first tick after the moment: up to TICK later
        session.tell(
            f"start in {in_short(at)}: robots start at most {1e3 * (skew + TICK):.0f} ms apart,"
            f" {1e3 * skew:.1f} ms of it by their clocks"
        )
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


def run_with_canary(
    targeted: TargetedView, goal: Goal, canaries: tuple[str, ...], seconds: float | None
) -> tuple[Outcome, Mapping[str, list[str]]]:
    """Run a goal on canaries for `seconds`, then on all robots of `targeted`.

    `seconds` None: CANARY_TIME. Returns the outcome, and the names of the canaries and of the other
    robots. If a canary does not start, the canaries are stopped, and the outcome of their start is
    returned without names. If a canary fails later, all canaries are stopped, and RequestError is
    raised.
    """
    from swarmd.operator.client.canary import CANARY_TIME

    session = targeted.session
    operator = targeted.operator
    view = targeted.view
    # This goal targets only the canaries, so that it ends no run of another robot.
    canary_goal = signed_again(operator, goal, targets=canaries)
    canary_epochs = view.epochs(canaries)
    outcome = send_goal(session, canary_epochs, canary_goal, timeout=targeted.time_left)
    if len(outcome.applied) < len(canaries):
        stop_names(operator, canaries)
        names = ", ".join(canaries)
        session.tell(f"canary: {names} did not start; nothing was sent to the others")
        return outcome, {}
    before = {name: view.members[name].status for name in canaries if name in view.members}
    faults = _canary_faults(session, canaries, seconds or CANARY_TIME, before)
    others = tuple(name for name in targeted.names if name not in canaries)
    if faults:
        stopped = stop_names(operator, canaries)
        raise _canary_failure(faults, stopped.missing, len(others))

    # A robot that was stopped or changed while the canaries ran has another epoch, and refuses.
    epochs = view.epochs(others) | {name: outcome.replies[name].epoch for name in canaries}
    present_view = operator.members(timeout=session.timeout)
    # Newer than any goal that was issued meanwhile.
    goal = signed_again(operator, goal, generation=next_generation(operator, present_view))
    try:
        outcome = send_goal(session, epochs, goal, timeout=session.timeout)
    except RequestError as error:  # a standstill: a stop might end what its user ordered meanwhile
        names = ", ".join(canaries)
        raise RequestError(
            f"{error}; {names} started before, and may run", error.exit_code
        ) from error
    return outcome, {"canary": list(canaries), "others": list(others)}


def _canary_faults(
    session: Session,
    canaries: tuple[str, ...],
    seconds: float,
    before: Mapping[str, Status | None],
) -> Mapping[str, str]:
    """Watch running canaries for `seconds`; the fault of each canary that does not run well.

    `before`: the status of each canary before its run. If the session is cancelled, each canary
    gets the cancellation as its fault. After Ctrl-C the canaries are stopped.
    """
    from swarmd.operator.client.canary import watch_canary

    session.tell(f"canary: {', '.join(canaries)} for {in_short(seconds)}")
    try:
        faults = watch_canary(session, canaries, seconds, before)
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(session, canaries)
        raise
    if session.is_cancelled():
        return dict.fromkeys(canaries, "the run was cancelled")
    return faults


def _canary_failure(
    faults: Mapping[str, str], missing: Collection[str], other_count: int
) -> RequestError:
    """The error after failed canaries were stopped.

    `faults`: by canary. `missing`: canaries that have not acknowledged the stop. `other_count`: how
    many targets are no canaries.
    """
    reasons = "; ".join(f"{name}: {fault}" for name, fault in faults.items())
    stop_text = "it was stopped"
    if missing:
        stop_text = f"{', '.join(missing)} DID NOT ACKNOWLEDGE THE STOP"
    rest = f"the other {other_count} robots" if other_count > 1 else "the other robot"
    text = f"canary failed: {reasons}; {stop_text}; nothing was sent to {rest}"
    return RequestError(text, PARTIAL if missing else FAILED)

"""Starts runs: at once, at one moment, with canaries first, or under a lease."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec import Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import is_id
from swarmd.core.record import LABEL
from swarmd.core.verbs import MAX_AHEAD, MAX_PLANNED
from swarmd.operator.session.session import next_goal
from swarmd.operator.session.targets import check_time
from swarmd.operator.verbs.run.send_goal import has_permit, send_goal

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import TargetedView
    from swarmd.operator.session.targets import Targets
    from swarmd.operator.texts.assignments import Value
    from swarmd.operator.verbs.run.lease import LeaseKeeper

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
        if not isinstance(self.pattern, str) or not is_id(self.pattern):
            raise ConfigError(_no_pattern(self.pattern))
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

    @property
    def needs_status(self) -> bool:
        """True if the look before this run needs statuses: a canary is judged by its own, too."""
        return self.canary is not None

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


def _no_pattern(name: object) -> str:
    """Why this is no name of a pattern."""
    from swarmd.plugins import is_pattern_path  # 3 ms of the start, and nearly all runs have a name

    if isinstance(name, str) and is_pattern_path(name):
        return (
            f"{name!r} is a path, and robots run what they have: send the file by"
            f" `swarmctl plugin push {name} ..`, then run it by its name"
        )
    return f"{name!r} is no pattern name; expected a-z, 0-9, _ and -"


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
        from swarmd.operator.verbs.run.canary import choose_canaries

        canaries = choose_canaries(run.canary, targeted.names, option("canary"))
    if has_permit(targeted.operator):
        _check_for_permit(run, option)
    goal = run.goal(targeted, targets)

    # `Run.check` permits only one of canary, `at` and lease.
    if canaries:
        from swarmd.operator.verbs.run.canary import run_with_canary

        return StartedRun(goal, *run_with_canary(targeted, goal, canaries, run.canary_time))
    if run.at is not None:
        from swarmd.operator.verbs.run.start_at import start_at

        return StartedRun(goal, *start_at(targeted, goal, run.at))
    keeper = None
    if run.lease is not None:
        from swarmd.operator.verbs.run.lease import LeaseKeeper

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


def goal_targets_of_names(view: MembersView, names: Collection[str]) -> tuple[str, ...]:
    """The targets of a goal for robots that were chosen one by one, as on the page.

    If these are all expected robots, the goal names none: it then also targets robots that join
    later.
    """
    return () if view.expected <= set(names) else tuple(names)

"""Waits until robots meet conditions."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from swarmd.core.clock import boottime
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.session import Session, signed_goals, unreachable
from swarmd.operator.session.targets import Targets, labels_of
from swarmd.operator.verbs.wait.words import Awaited, meeting, unmet

TIME = 30.0  # s of a wait without a timeout
PERIOD = 0.3  # s between looks


@dataclass(frozen=True, slots=True)
class Waited:
    """The result of a wait."""

    names: tuple[str, ...]  # the targets
    met: tuple[str, ...]  # targets that meet the conditions
    missing: Mapping[str, str]  # the state of targets that do not; empty if the wait succeeded
    limit: float  # s

    @property
    def text(self) -> str:
        """The targets that do not meet the conditions, in one line."""
        why = "; ".join(f"{name} {text}".strip() for name, text in self.missing.items())
        return f"after {self.limit:g} s still not: {why}"


def wait_for(session: Session, targets: Targets, conditions: Awaited) -> Waited:
    """Wait until the targets meet the conditions, at most for the session's timeout (else TIME).

    Robots of the roster, and robots that `targets` names, must meet the conditions even if they
    were not heard so far. NetworkError if no daemon was reached by the end. The wait ends early if
    the session is cancelled.
    """
    limit = TIME if session.timeout is None else session.timeout
    operator = session.operator
    until = boottime() + limit
    while True:
        view = operator.members(cap=max(until - boottime(), 0.05))
        view = signed_goals(view, operator.identity) if conditions.goal else view
        names = _names(view, targets)
        missing = unmet(view, names, conditions)
        met = meeting(view, names, conditions)
        if not missing or boottime() >= until or session.is_cancelled():
            break
        time.sleep(min(PERIOD, max(until - boottime(), 0.0)))
    if missing and not view.members:
        raise unreachable(operator)
    return Waited(names, met, missing, limit)


def _names(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The names of the targets so far.

    A glob or label that matches no robot is returned itself, as if it were the name of a robot that
    is not heard: no condition is met, so the wait goes on.
    """
    known = view.expected | set(targets.full_names)
    by_name = Targets(targets.names, targets.exclude)
    names = set(by_name.matching(known)) if targets.names or not targets.labels else set[str]()
    for label in targets.labels:
        with_label = [name for name, labels in labels_of(view).items() if label in labels]
        names |= {*Targets((), targets.exclude).matching(with_label)} or {f"label {label}"}
    lacking = [
        glob for glob in targets.names if not Targets((glob,)).matching(known) and glob not in known
    ]
    return tuple(sorted(names | set(lacking)))

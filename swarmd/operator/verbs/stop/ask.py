"""Stops and emergency stops of robots: sent at once, repeated, and counted; and their reset."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from swarmd.core.errors import unknown
from swarmd.core.verbs import ResetRequest
from swarmd.operator.session.session import Session, gap, unreachable
from swarmd.operator.session.targets import (
    STOP_LOOK,
    Targets,
    no_target,
    robots_of,
    stop_targets,
    unlabelled,
)
from swarmd.operator.verbs.stop import words

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import TargetedView


def send_stop(
    session: Session,
    verb: Literal["stop", "estop"],
    targets: Targets,
    reason: str = "",
    *,
    until_all: bool = False,
    on_progress: Callable[[tuple[str, ...]], None] | None = None,
) -> Outcome:
    """Stop the targets at once ("stop"), or stop them until a reset ("estop", with `reason`).

    `on_progress` gets the robots without an acknowledgement whenever these change; by default the
    user is told. With `until_all` sending ends only once all robots have acknowledged, or when the
    session is cancelled. Returns the outcome, in which a target name that no robot has counts as
    missing. Raises NetworkError if no daemon was reached, RequestError if no robot is targeted.
    """
    operator = session.operator
    if targets.labels:
        targets = _without_labels(session, targets)

    def tell_missing(missing: tuple[str, ...]) -> None:
        """Tell the user which robots have not acknowledged; none: no robot was heard so far."""
        view = operator.seen()
        session.tell(words.waiting_for([gap(view, name) for name in missing]))

    def send() -> Outcome:
        return operator.send_stop(
            verb,
            select=None if targets.is_whole_swarm else targets.matching,
            names=targets.full_names,
            reason=reason,
            timeout=session.timeout,
            until_all=until_all,
            on_progress=on_progress or tell_missing,
            is_ended=session.is_cancelled,
        )

    identity_before = operator.identity
    outcome = send()
    if outcome.missing or not outcome.replies:
        # The missing robots may have a newer roster, with whose keys the stop must be signed.
        operator.update_roster()
        has_new_keys = operator.identity is not identity_before
        if has_new_keys:
            outcome = send()
    session.tell_notices()
    return _reported(session, verb, targets, outcome)


def _without_labels(session: Session, targets: Targets) -> Targets:
    """The targets with labels replaced by robots; tells of robots whose labels are not known."""
    timeout = session.timeout
    search_time = STOP_LOOK if timeout is None else min(timeout / 2, STOP_LOOK)
    view = session.operator.members(timeout=search_time)
    without_labels = unlabelled(view, targets)
    stopped = stop_targets(view, targets)
    if without_labels:
        session.tell(words.without_labels(without_labels))
    return stopped


def _reported(session: Session, verb: str, targets: Targets, outcome: Outcome) -> Outcome:
    """The outcome of a stop with a warning for each name that no robot has.

    Tells the user which robots did not answer. NetworkError if no robot was heard at all.
    RequestError if no robot is targeted: all names are unknown, or all robots have left.
    """
    operator = session.operator
    view = operator.seen()
    is_none_heard = not outcome.reached and not outcome.replies
    if is_none_heard and not view.roster:
        raise unreachable(operator, words.sent_in_vain(operator, verb, outcome.seconds))
    known = view.members.keys() | view.roster | outcome.replies.keys()
    unknown_names = [name for name in outcome.missing if name not in known]
    are_all_unknown = len(unknown_names) == outcome.targeted
    if not outcome.targeted or are_all_unknown:
        raise no_target(*map(words.left, robots_of(view, targets)))
    if is_none_heard:
        session.tell(words.none_heard(operator))
    session.tell_gaps(view, [name for name in outcome.missing if name not in unknown_names])
    warnings = (unknown("robot", name, view.members) for name in unknown_names)
    return replace(outcome, warnings=(*outcome.warnings, *warnings))


def stop_on_interrupt(session: Session, names: Collection[str], reason: str = "interrupted") -> str:
    """Stop these robots when a verb is interrupted; tells the user, and returns that line."""
    text = words.interrupted(reason, stop_names(session.operator, names))
    session.tell(text)
    return text


def stop_names(operator: Operator, names: Collection[str]) -> Outcome:
    """Stop these robots, within 5 s."""
    chosen = set(names)
    return operator.send_stop(
        "stop", select=lambda found: tuple(chosen & set(found)), names=tuple(names), timeout=5.0
    )


def reset(targeted: TargetedView, *, reason: str = "", findings: bool = False) -> Outcome:
    """Clear the emergency stops and faults of robots, as their statuses in `targeted` show them.

    An emergency stop that came after these statuses stays. With `findings`, also clear the violated
    assumptions of protection that the statuses show; until then such a robot drives slower.
    """
    ids = tuple(sorted(targeted.view.latches(targeted.names)))
    shown_findings = findings_of(targeted.view, targeted.names) if findings else ()
    ended = tuple(dict.fromkeys(text for _, text in shown_findings))
    return targeted.request(ResetRequest, ids=ids, findings=ended, reason=reason)


def findings_of(view: MembersView, names: Iterable[str]) -> list[tuple[str, str]]:
    """The findings of the assumption monitors, each with its robot."""
    statuses = ((name, view.members[name].status) for name in names if name in view.members)
    return [(name, text) for name, status in statuses if status for text in status.findings]

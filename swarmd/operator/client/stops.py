"""Stops and emergency stops of robots: sent at once, repeated, and counted."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from swarmd.core.errors import unknown
from swarmd.operator.client.session import Session, gap, other_swarms, unreachable, where
from swarmd.operator.client.targets import (
    STOP_LOOK,
    Targets,
    no_target,
    robots_of,
    stop_targets,
    unlabelled,
)
from swarmd.operator.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome


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
        lines = [gap(view, name) for name in missing] or ["a robot to be heard"]
        session.tell(f"waiting for {'; '.join(lines)}")

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
        text = ", ".join(without_labels)
        session.tell(f"labels are not known, a stop is sent to them, too: {text}")
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
        how = f"`{verb}` was sent {where(operator)} for {seconds(outcome.seconds)}"
        raise unreachable(operator, f"; {how} and no robot answered")
    known = view.members.keys() | view.roster | outcome.replies.keys()
    unknown_names = [name for name in outcome.missing if name not in known]
    are_all_unknown = len(unknown_names) == outcome.targeted
    if not outcome.targeted or are_all_unknown:
        names = robots_of(view, targets)
        raise no_target(*(f"{name} has left" for name in names))
    if is_none_heard:
        session.tell(f"no robot was heard{other_swarms(operator)}")
    session.tell_gaps(view, [name for name in outcome.missing if name not in unknown_names])
    warnings = (unknown("robot", name, view.members) for name in unknown_names)
    return replace(outcome, warnings=(*outcome.warnings, *warnings))


def stop_on_interrupt(session: Session, names: Collection[str], reason: str = "interrupted") -> str:
    """Stop these robots when a verb is interrupted; tells the user, and returns that line."""
    text = f"{reason}: stop sent: {stop_names(session.operator, names).line}"
    session.tell(text)
    return text


def stop_names(operator: Operator, names: Collection[str]) -> Outcome:
    """Stop these robots, within 5 s."""
    chosen = set(names)
    return operator.send_stop(
        "stop", select=lambda found: tuple(chosen & set(found)), names=tuple(names), timeout=5.0
    )

"""Stops and emergency stops of robots: sent at once, repeated, and counted."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from swarmd.client.session import Session, gap, instead, unreachable, where
from swarmd.client.targets import STOP_LOOK, Targets, no_target, robots_of, stopped, unlabelled
from swarmd.core.errors import unknown
from swarmd.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.network.operator.operator import Operator
    from swarmd.network.operator.outcome import Outcome


def send_stop(
    session: Session,
    verb: Literal["stop", "estop"],
    targets: Targets,
    reason: str = "",
    *,
    until_all: bool = False,
    on_progress: Callable[[tuple[str, ...]], None] | None = None,
) -> Outcome:
    """Stop the targets at once; a full name that no robot has counts as not answering.

    `on_progress` gets the robots without an acknowledgement whenever they change; by default they
    are reported to the user. With `until_all` the stop ends once all robots have acknowledged, or
    when the session is cancelled. NetworkError if no daemon was reached, RequestError if no robot
    is targeted.
    """
    operator = session.operator
    if targets.labels:
        timeout = session.timeout
        look = STOP_LOOK if timeout is None else min(timeout / 2, STOP_LOOK)
        view = operator.members(timeout=look)
        unclear = unlabelled(view, targets)
        targets = stopped(view, targets)
        if unclear:
            text = ", ".join(unclear)
            session.tell(f"labels are not known, a stop is sent to them, too: {text}")

    def tell_missing(missing: tuple[str, ...]) -> None:
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

    before = operator.identity
    outcome = send()
    if outcome.missing or not outcome.replies:
        operator.update_roster()
        if operator.identity is not before:  # robots may have heard nothing of it
            outcome = send()
    session.tell_notices()
    view = operator.seen()
    if not outcome.reached and not outcome.replies and not view.roster:
        how = f"`{verb}` was sent {where(operator)} for {seconds(outcome.seconds)}"
        raise unreachable(operator, f"; {how} and no robot answered")
    known = view.members.keys() | view.roster | outcome.replies.keys()
    lost = [name for name in outcome.missing if name not in known]
    if not outcome.targeted or len(lost) == outcome.targeted:
        names = robots_of(view, targets)
        raise no_target(*(f"{name} has left" for name in names))
    if not outcome.reached and not outcome.replies:
        session.tell(f"no robot was heard{instead(operator)}")
    session.tell_gaps(view, [name for name in outcome.missing if name not in lost])
    warnings = (unknown("robot", name, view.members) for name in lost)
    return replace(outcome, warnings=(*outcome.warnings, *warnings))


def stop_on_interrupt(session: Session, names: Collection[str], why: str = "interrupted") -> str:
    """Stop these robots when a verb is interrupted; reports and returns which of them stopped."""
    text = f"{why}: stop sent: {stop_names(session.operator, names).line}"
    session.tell(text)
    return text


def stop_names(operator: Operator, names: Collection[str]) -> Outcome:
    """Stop these robots, within 5 s."""
    chosen = set(names)
    return operator.send_stop(
        "stop", select=lambda found: tuple(chosen & set(found)), names=tuple(names), timeout=5.0
    )

"""The goals of robots (what they are to do): resumed, and set again."""

from __future__ import annotations

from collections import defaultdict

from swarmd.core.errors import RequestError
from swarmd.core.messages import Epoch
from swarmd.core.verbs import ResumeRequest
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome, joined
from swarmd.operator.session.session import Session, next_goal, signed_goals
from swarmd.operator.verbs.goal.words import content_of, describe_goal, present_goals, set_apart
from swarmd.operator.verbs.run.send_goal import check_sets_goals, send_goal
from swarmd.operator.verbs.stop.ask import stop_names


def resume_on(
    session: Session, view: MembersView, names: tuple[str, ...], *, timeout: float | None
) -> Outcome:
    """Ask each robot to run its own goal, as `view` shows it."""
    # By digest of a goal: the robots with this own goal, each with the epoch to quote.
    by_digest: dict[str, dict[str, Epoch | None]] = defaultdict(dict)
    for name, epoch in view.epochs(names).items():
        status = view.members[name].status if name in view.members else None
        own = status.goal.own if status is not None and status.goal is not None else None
        by_digest[own.digest if own is not None else ""][name] = epoch
    request = session.operator.request
    began = session.began
    return joined(
        request(ResumeRequest, epoch_by_robot, timeout=timeout, issued=began, digest=digest)
        for digest, epoch_by_robot in by_digest.items()
    )


def undo(session: Session) -> Outcome:
    """Set the goal before the present goal again. Robots of only the present goal are stopped.

    RequestError if there is no goal before, or if the goal before had a run lease.
    """
    operator = session.operator
    check_sets_goals(operator, "undo")
    view = signed_goals(session.look(is_request_next=True), operator.identity)
    present, before = present_goals(view)
    if present is None or before is None:
        what = "no goal is set" if present is None else f"no goal precedes {present.text}"
        raise RequestError(f"nothing to undo: {what}", NO_TARGET)
    if before.lease is not None:
        text = f"nothing to undo: {before.text} had a run lease, which undo cannot renew"
        raise RequestError(text, NO_TARGET)
    goal = next_goal(operator, view, **content_of(before), undoes=present.id)
    run, stand = set_apart(view, present, before)
    session.tell(f"sends {describe_goal(goal)}, in place of {present.text}")
    outcomes = []
    if stand:
        outcomes.append(stop_names(operator, stand))
    if run:
        wait = session.time_left(view)
        outcomes.append(send_goal(session, view.epochs(run), goal, timeout=wait))
    return joined(outcomes)

"""Requests that start no motion: parameters, labels, and forgetting members."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import RequestError
from swarmd.core.messages import Member, Param, Presence
from swarmd.core.verbs import ForgetRequest, LabelRequest, ParamRequest
from swarmd.operator.session.exit_codes import REFUSED
from swarmd.operator.session.outcome import Outcome, joined
from swarmd.operator.session.targets import labels_of
from swarmd.operator.texts.labels import changed

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.session import Session, TargetedView


def set_params(targeted: TargetedView, values: Mapping[str, Any]) -> Outcome:
    """Change parameters of the running pattern, until the next run."""
    return targeted.request(ParamRequest, params=dict(values))


def params_of(member: Member) -> dict[str, Param]:
    """The parameters in force on a robot, with the source of each; empty if no pattern runs."""
    return member.status.params if member.status is not None else {}


def change_labels(
    targeted: TargetedView, added: Collection[str], removed: Collection[str]
) -> Outcome:
    """Add and remove labels of robots; a robot whose labels are not known counts as missing."""
    known = labels_of(targeted.view)
    wanted: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name in targeted.names:
        if name in known:
            wanted[changed(known[name], added, removed)].append(name)
    outcomes = [targeted.request(LabelRequest, some, labels=to) for to, some in wanted.items()]
    unseen = tuple(name for name in targeted.names if name not in known)
    return joined([*outcomes, Outcome({}, missing=unseen)])


def forget(session: Session, view: MembersView, name: str) -> Outcome:
    """Remove a robot that failed or left from the member lists of all robots.

    RequestError if the robot is alive.
    """
    if view.members[name].presence is Presence.ALIVE:
        text = f"{name} is alive; only robots that failed or left can be forgotten"
        raise RequestError(text, REFUSED)
    epochs = view.epochs(view.alive)
    wait = session.time_left(view)
    return session.operator.request(ForgetRequest, epochs, timeout=wait, name=name)

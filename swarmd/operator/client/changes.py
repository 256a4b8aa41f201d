"""Requests that start no motion: reset, parameters, labels, and forgetting members."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import RequestError
from swarmd.core.messages import Member, Param, Presence
from swarmd.core.verbs import ForgetRequest, LabelRequest, ParamRequest, ResetRequest
from swarmd.operator.client.targets import labels_of
from swarmd.operator.session.exit_codes import REFUSED
from swarmd.operator.session.outcome import Outcome, joined
from swarmd.operator.texts.labels import changed

if TYPE_CHECKING:
    from swarmd.operator.client.session import Session, TargetedView
    from swarmd.operator.session.members_view import MembersView


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

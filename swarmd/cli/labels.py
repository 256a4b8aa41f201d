"""Targets by label: which robots have a label, as their statuses show it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmd.cli.options import Failure, Targets
from swarmd.core.errors import unknown
from swarmd.network.exit_codes import NO_TARGET

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView

STOP_LOOK = 1.0
"""How long a stop by label looks for labels at most, in s. It stops robots without an answer."""


def labels_of(view: MembersView) -> dict[str, tuple[str, ...]]:
    """The labels of each robot whose status is known."""
    members = view.members.items()
    return {name: one.status.labels for name, one in members if one.status is not None}


def unlabelled(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """Expected robots that may be targets by a label: their labels are not known."""
    if not targets.labels:
        return ()
    lacking = view.expected - labels_of(view).keys()
    by_name = Targets(targets.names).matching(lacking) if targets.names else ()
    return Targets(("*",), (*targets.exclude, *by_name)).matching(lacking)


def named(view: MembersView, targets: Targets) -> Targets:
    """The targets by name alone; Failure, with the nearest label, if no robot has a label."""
    if not targets.labels:
        return targets
    found = labels_of(view)
    _check(targets.labels, found.values())
    robots = (name for name, labels in sorted(found.items()) if {*labels} & {*targets.labels})
    return replace(targets, names=(*targets.names, *robots), labels=())


def stopped(view: MembersView, targets: Targets) -> Targets:
    """The targets of a stop: all robots except those whose known labels match no label.

    Failure if all robots have answered and no robot has such a label. All robots if none was heard.
    """
    found = labels_of(view)
    if view.expected and view.expected <= found.keys():
        _check(targets.labels, found.values())
    by_name = set(Targets(targets.names).matching(found)) if targets.names else set[str]()
    others = {name for name, labels in found.items() if not {*labels} & {*targets.labels}}
    return Targets(("*",), (*targets.exclude, *sorted(others - by_name)))


def robots_of(
    view: MembersView, targets: Targets, known: Collection[str] | None = None
) -> tuple[str, ...]:
    """The targets among `known`, by default all members and the roster. Failure as of `named`."""
    known = view.members.keys() | view.roster if known is None else known
    return named(view, targets).select(known)


def _check(labels: Collection[str], of_robots: Collection[Collection[str]]) -> None:
    known = {label for some in of_robots for label in some}
    for label in labels:
        if label not in known:
            raise Failure(unknown("robot with label", label, known), NO_TARGET)

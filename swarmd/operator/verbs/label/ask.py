"""Gives labels to robots, and takes them away; it moves nothing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from typing import TYPE_CHECKING

from swarmd.core.verbs import LabelRequest
from swarmd.operator.session.outcome import Outcome, joined
from swarmd.operator.session.targets import labels_of
from swarmd.operator.verbs.label.words import changed

if TYPE_CHECKING:
    from swarmd.operator.session.session import TargetedView


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

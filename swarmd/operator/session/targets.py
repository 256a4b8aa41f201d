"""The targets of an operator's request: names, globs and labels, and the robots that they match.

`targets_of` gives the robots that must answer. Labels are known only from statuses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from swarmd.core.errors import ConfigError, RequestError, unknown
from swarmd.core.keys import is_id
from swarmd.core.names import expand_globs
from swarmd.operator.session.exit_codes import NO_TARGET, USAGE

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView

STOP_LOOK = 1.0
"""How long a stop by label looks for labels at most, in s.

The stop is sent to robots that have not answered by then, too.
"""


@dataclass(frozen=True, slots=True)
class Targets:
    """The robots that a request is for: by names and globs, and by labels.

    A robot with any of the `labels` is a target, too. Without names and labels all robots are
    targets. Robots in `exclude` are no targets. Labels are known only from statuses of robots:
    `named` replaces labels by names.
    """

    names: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    @property
    def is_whole_swarm(self) -> bool:
        """True if no robot is named, labelled or excluded."""
        return not self.names and not self.exclude and not self.labels

    @property
    def full_names(self) -> tuple[str, ...]:
        """The targets without wildcards; each is a target even if no robot has that name."""
        return tuple(name for name in self.names if is_id(name) and not self._is_excluded(name))

    def select(self, known: Collection[str], roster: Collection[str] = ()) -> tuple[str, ...]:
        """The targets among the robot names in `known`; `roster`: of the swarm, see `check_known`.

        RequestError if a name or glob, also of `exclude`, matches no robot. RequestError if there
        are labels, since names do not show labels.
        """
        if self.labels:
            raise RequestError("this verb takes names, not labels; see `swarmctl members`", USAGE)
        for glob in (*self.names, *self.exclude):
            if not any(fnmatchcase(name, glob) for name in known):
                check_known(glob, known, roster)
        return self.matching(known)

    def matching(self, known: Iterable[str]) -> tuple[str, ...]:
        """The targets among `known`; names and globs that match no robot are ignored."""
        return tuple(
            name
            for name in sorted(known)
            if (self._is_open or any(fnmatchcase(name, glob) for glob in self.names))
            and not self._is_excluded(name)
        )

    @property
    def _is_open(self) -> bool:
        return not self.names and not self.labels

    def _is_excluded(self, name: str) -> bool:
        return any(fnmatchcase(name, glob) for glob in self.exclude)


def make_targets(
    names: Iterable[str] = (), exclude: Iterable[str] = (), labels: Iterable[str] = ()
) -> Targets:
    """The targets of words; ConfigError for a wrong word.

    Ranges such as `tb3-[01-07]` are expanded: requests contain only names and globs.
    """
    wanted = _expanded(names)
    excluded = _expanded(exclude)
    labels = tuple(labels)
    for label in labels:
        if not is_id(label):
            raise ConfigError(f"{label!r} is no label; expected a-z, 0-9, _ and -")
    return Targets(wanted, excluded, labels)


def _expanded(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for word in words for name in expand_globs(word)))


def check_known(name: str, known: Collection[str], roster: Collection[str] = ()) -> None:
    """RequestError unless the robot is known, with the nearest name.

    With a `roster` the name may be that of a revoked robot, which another name would hide.
    """
    if name in known:
        return
    text = f"{unknown('robot', name, known)}; see `swarmctl members`"
    if name in roster:
        text = f"{name} is on the roster, but is not heard; see `swarmctl members`"
    elif roster and is_id(name):
        text = (
            f"{name} is not on the roster: it was revoked, or never added (`swarmctl keys list`);"
            " what a revoked robot has recorded and logged is on its own disk alone"
        )
    raise RequestError(text, NO_TARGET)


def labels_of(view: MembersView) -> dict[str, tuple[str, ...]]:
    """The labels of each robot whose status is known."""
    members = view.members.items()
    return {name: one.status.labels for name, one in members if one.status is not None}


def unlabelled(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The expected robots whose labels are not known, so that they may be targets of a label."""
    if not targets.labels:
        return ()
    lacking = view.expected - labels_of(view).keys()
    by_name = Targets(targets.names).matching(lacking) if targets.names else ()
    return Targets(("*",), (*targets.exclude, *by_name)).matching(lacking)


def named(view: MembersView, targets: Targets) -> Targets:
    """The targets with labels replaced by names.

    RequestError, with the nearest label, if no robot has a label.
    """
    if not targets.labels:
        return targets
    labels_by_robot = labels_of(view)
    _check(targets.labels, labels_by_robot.values())
    robots = (
        name for name, labels in sorted(labels_by_robot.items()) if {*labels} & {*targets.labels}
    )
    return replace(targets, names=(*targets.names, *robots), labels=())


def stop_targets(view: MembersView, targets: Targets) -> Targets:
    """The targets of a stop, with labels replaced by the names of the robots that have them.

    The targets are robots that `targets` names, robots with one of the labels, and robots whose
    labels are not known: in doubt a robot is stopped. Excluded robots are no targets. RequestError
    if the labels of all expected robots are known, and no robot has one of the labels in `targets`.
    """
    labels_by_robot = labels_of(view)
    if view.expected and view.expected <= labels_by_robot.keys():
        _check(targets.labels, labels_by_robot.values())
    named = set(Targets(targets.names).matching(labels_by_robot)) if targets.names else set[str]()
    unlabelled = {
        name for name, labels in labels_by_robot.items() if not {*labels} & {*targets.labels}
    }
    return Targets(("*",), (*targets.exclude, *sorted(unlabelled - named)))


def robots_of(
    view: MembersView, targets: Targets, known: Collection[str] | None = None
) -> tuple[str, ...]:
    """The targets among `known`, by default all members and the roster; RequestError as `named`."""
    known = view.members.keys() | view.roster if known is None else known
    return named(view, targets).select(known, view.roster)


def targets_of(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The robots that must answer a request to `targets`; RequestError if there are none."""
    expected = view.expected
    names = robots_of(view, targets)
    chosen = tuple(name for name in names if name in expected)
    if not chosen:
        raise no_target(*(f"{name} has left" for name in names))
    return chosen


def no_target(*reasons: str) -> RequestError:
    """The error of a request without a target; `reasons`: why each named robot is no target."""
    text = "; ".join(reasons) or "all robots are excluded"
    return RequestError(f"no robot is targeted: {text}", NO_TARGET)


def _check(labels: Collection[str], of_robots: Collection[Collection[str]]) -> None:
    known = {label for some in of_robots for label in some}
    for label in labels:
        if label not in known:
            raise RequestError(unknown("robot with label", label, known), NO_TARGET)

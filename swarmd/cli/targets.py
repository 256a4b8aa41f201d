"""The targets of a verb: words of the command line, and the robots that they name.

`takes_targets` reads names, globs and labels into `Targets`; `targets_of` gives the robots that
must answer. Labels are known by statuses alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, TypeVar

import click

from swarmd.cli import completion
from swarmd.cli.options import Failure
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import is_id
from swarmd.core.names import expand_globs
from swarmd.network.exit_codes import NO_TARGET, USAGE

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView

R = TypeVar("R")
Function = TypeVar("Function", bound=Callable[..., Any])

STOP_LOOK = 1.0
"""How long a stop by label looks for labels at most, in s.

The stop is sent to robots that have not answered by then, too.
"""


@dataclass(frozen=True, slots=True)
class Targets:
    """Names and globs of robots, and labels, less the robots in `exclude`.

    A robot with any of the `labels` is a target. Without names and labels all robots are. Labels
    are known by statuses alone: `named` puts names in their place.
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

    def select(self, known: Collection[str]) -> tuple[str, ...]:
        """The targets among `known`; Failure if a name or glob, excluded or not, matches no robot.

        Also Failure if there are labels, which names alone do not show.
        """
        if self.labels:
            raise Failure("this verb takes names, not labels; see `swarmctl members`", USAGE)
        for glob in (*self.names, *self.exclude):
            if not any(fnmatchcase(name, glob) for name in known):
                check_known(glob, known)
        return self.matching(known)

    def matching(self, known: Iterable[str]) -> tuple[str, ...]:
        """The targets among `known`; names that match none are ignored."""
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


def read_targets(
    verb: str,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    labels: tuple[str, ...] = (),
    *,
    is_required: bool,
) -> Targets:
    """The targets of a verb; UsageError if a word is wrong or missing.

    Ranges are expanded, so that robots see names and globs alone.
    """
    names, exclude = _expanded(names), _expanded(exclude)
    for label in labels:
        if not is_id(label):
            raise click.UsageError(f"{label!r} is no label; expected a-z, 0-9, _ and -")
    if (names or labels) and is_all:
        raise click.UsageError(f"{verb} takes names and labels, or --all, not both")
    if is_required and not names and not labels and not is_all:
        raise click.UsageError(
            f"{verb} needs targets; add robot names, a glob such as 'tb3-*', -l LABEL, or --all"
        )
    return Targets(names, exclude, labels)


def _expanded(words: Iterable[str]) -> tuple[str, ...]:
    try:
        return tuple(dict.fromkeys(name for word in words for name in expand_globs(word)))
    except ConfigError as error:
        raise click.UsageError(str(error)) from error


def target_options(function: Function) -> Function:
    """Give a verb the parameters `names`, `is_all`, `exclude` and `labels`."""
    for option in (
        click.option(
            "-l",
            "--label",
            "labels",
            multiple=True,
            metavar="LABEL",
            help="Robots with this label; repeated, with any of them.",
            shell_complete=completion.labels,
        ),
        click.option(
            "--exclude",
            multiple=True,
            metavar="GLOB",
            help="Exclude robots; repeatable.",
            shell_complete=completion.robots,
        ),
        click.option("--all", "is_all", is_flag=True, help="All robots of the swarm."),
        click.argument("names", nargs=-1, metavar="[TARGET]...", shell_complete=completion.robots),
    ):
        function = option(function)
    return function


def takes_targets(*, is_required: bool) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Give a verb the parameter `targets`."""

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        @functools.wraps(function)
        def wrapper(
            names: tuple[str, ...],
            is_all: bool,
            exclude: tuple[str, ...],
            labels: tuple[str, ...],
            **kwargs: Any,
        ) -> R:
            verb = click.get_current_context().command_path.partition(" ")[2]
            targets = read_targets(verb, names, is_all, exclude, labels, is_required=is_required)
            return function(targets=targets, **kwargs)

        return target_options(wrapper)

    return decorate


def check_known(name: str, known: Collection[str]) -> None:
    """Failure, with the nearest name, unless the robot is known."""
    if name not in known:
        text = f"{unknown('robot', name, known)}; see `swarmctl members`"
        raise Failure(text, NO_TARGET)


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


def targets_of(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The robots that must answer a request to `targets`; Failure if there are none."""
    expected = view.expected
    names = robots_of(view, targets)
    chosen = tuple(name for name in names if name in expected)
    if not chosen:
        raise no_target(*(f"{name} has left" for name in names))
    return chosen


def no_target(*reasons: str) -> Failure:
    """The error of a request without a target; `reasons`: why each named robot is no target."""
    text = "; ".join(reasons) or "all robots are excluded"
    return Failure(f"no robot is targeted: {text}", NO_TARGET)


def _check(labels: Collection[str], of_robots: Collection[Collection[str]]) -> None:
    known = {label for some in of_robots for label in some}
    for label in labels:
        if label not in known:
            raise Failure(unknown("robot with label", label, known), NO_TARGET)

"""Values on the command line: durations (`60s`) and targets (`tb3-*`)."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, TypeVar

import click

from swarmd.cli import completion
from swarmd.core.errors import unknown
from swarmd.core.keys import is_id
from swarmd.network.exit_codes import NO_TARGET, USAGE

Function = TypeVar("Function", bound=Callable[..., Any])
R = TypeVar("R")

_GLOB = re.compile(r"[a-z0-9_*?\[\]!-]{1,63}")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)(ms|s|m|h)?")
_UNITS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, None: 1.0}
_MAX_DURATION = 1e7  # s


class Failure(click.ClickException):
    """An error with its exit code (see `swarmd.network.exit_codes`)."""

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = exit_code  # type: ignore[misc]  # click declares it for the class


class Duration(click.ParamType[float]):
    """Seconds from `60`, `60s`, `1.5m`, `500ms`, `2h`."""

    name = "duration"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The duration in s, above 0."""
        if isinstance(value, int | float):
            return float(value)
        match = _DURATION.fullmatch(str(value).strip().lower())
        seconds = float(match[1]) * _UNITS[match[2]] if match else 0.0
        if not 0.0 < seconds <= _MAX_DURATION:
            self.fail(
                f"{value!r} is no duration; expected a value such as 60s, 2m or 500ms", param, ctx
            )
        return seconds


@dataclass(frozen=True, slots=True)
class Targets:
    """Names and globs of robots, and labels, less the robots in `exclude`.

    A robot with any of the `labels` is a target. Without names and labels all robots are. Labels
    are known by statuses alone: `swarmd.cli.labels` puts names in their place.
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
    """The targets of a verb; UsageError if a word is no name or glob, or if they are missing."""
    for glob in (*names, *exclude):
        if not _GLOB.fullmatch(glob):
            raise click.UsageError(
                f"{glob!r} is no robot name; expected a-z, 0-9, _ and -, with * ? [..] as wildcards"
            )
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

"""The targets (robots) of a verb, as words of the command line.

The decorator `takes_targets` reads names, globs and labels into `Targets`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import click

from swarmd.core.errors import ConfigError, R
from swarmd.operator.cli import completion
from swarmd.operator.session.targets import Targets, make_targets

Function = TypeVar("Function", bound=Callable[..., Any])


def read_targets(
    verb: str,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    labels: tuple[str, ...] = (),
    *,
    is_required: bool,
) -> Targets:
    """The targets of a verb; UsageError if a word is wrong or missing."""
    try:
        targets = make_targets(names, exclude, labels)
    except ConfigError as error:
        raise click.UsageError(str(error)) from error
    if (names or labels) and is_all:
        raise click.UsageError(f"{verb} takes names and labels, or --all, not both")
    if is_required and not names and not labels and not is_all:
        raise click.UsageError(
            f"{verb} needs targets; add robot names, a glob such as 'tb3-*', -l LABEL, or --all"
        )
    return targets


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

"""The words that name robots, shared by all verbs that act on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS = (
    click.argument("names", nargs=-1, metavar="[TARGET]..."),
    click.option("--all", "is_all", is_flag=True, help="Every robot of the swarm."),
    click.option(
        "--exclude", multiple=True, metavar="GLOB", help="Leave these out; may be repeated."
    ),
)


def target_options(function: Function) -> Function:
    """Give a verb `names`, `is_all` and `exclude`."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function

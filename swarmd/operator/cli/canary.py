"""The option --canary of `run` and `plugin push`."""

from __future__ import annotations

from collections.abc import Iterable

import click

from swarmd.core.errors import ConfigError
from swarmd.core.keys import is_id
from swarmd.core.numbers import exact_number
from swarmd.operator.verbs.run.canary import choose_canaries


def read_canary(text: str | None) -> int | str | None:
    """A number of robots, or the name of a robot. UsageError for any other text."""
    if text is None:
        return None
    count = exact_number(text)
    if isinstance(count, int) and count > 0:
        return count
    if not is_id(text) or text.isdecimal():  # 010 is both
        raise click.UsageError(f"--canary {text}: expected a number of robots, or a robot's name")
    return text


def canaries_of(text: str, names: Iterable[str]) -> tuple[str, ...]:
    """The canaries, which get a change first; `text`: their number, or the name of one target.

    UsageError if all targets would be canaries. RequestError if the named robot is no target.
    """
    try:
        return choose_canaries(read_canary(text) or text, names, "--canary")
    except ConfigError as error:
        raise click.UsageError(str(error)) from error

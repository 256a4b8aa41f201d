"""What the command line says in its own small languages: `key=value`, `60s`, `tb3-*`.

The words that name robots, shared by all verbs that act on them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, TypeVar

import click

from swarmd.core.errors import unknown
from swarmd.core.keys import is_id

Value = bool | int | float | str | None

_GLOB = re.compile(r"[a-z0-9_*?\[\]!-]{1,63}")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)(ms|s|m|h)?")
_UNITS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, None: 1.0}
_MAX_SECONDS = 1e7
_MAX_INTEGER = 2**53
# What a request takes: characters of a parameter's name and value, bytes of all of them.
_MAX_KEY, _MAX_TEXT, _MAX_ALL = 64, 256, 32 * 1024


class NoTarget(click.ClickException):
    """No robot was meant; exit code 4."""

    exit_code = 4


class Duration(click.ParamType[float]):
    """Seconds from `60`, `60s`, `1.5m`, `500ms`, `2h`."""

    name = "duration"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The seconds; fails for anything else, and for nothing at all."""
        if isinstance(value, int | float):
            return float(value)
        match = _DURATION.fullmatch(str(value).strip().lower())
        seconds = float(match[1]) * _UNITS[match[2]] if match else 0.0
        if not 0.0 < seconds <= _MAX_SECONDS:
            self.fail(f"{value!r} is no duration; wanted such as 60s, 2m or 500ms", param, ctx)
        return seconds


@dataclass(frozen=True, slots=True)
class Targets:
    """Whom the operator means: names and globs, or everyone, without those excluded."""

    names: tuple[str, ...]
    is_all: bool
    exclude: tuple[str, ...]

    @property
    def is_everyone(self) -> bool:
        """True if nobody is named and nobody left out."""
        return not self.names and not self.exclude

    @property
    def unseen(self) -> tuple[str, ...]:
        """The full names among the targets: they are meant even if nobody knows of them."""
        return tuple(name for name in self.names if is_id(name) and not self._is_excluded(name))

    def select(self, known: Collection[str]) -> tuple[str, ...]:
        """Those of `known` that are meant; NoTarget for a name or glob that matches none.

        A mistyped name must not be passed over, least of all one that was to be excluded.
        """
        for glob in (*self.names, *self.exclude):
            if not any(fnmatchcase(name, glob) for name in known):
                raise NoTarget(f"{unknown('robot', glob, known)}; see `swarmctl members`")
        return self.matching(known)

    def matching(self, known: Iterable[str]) -> tuple[str, ...]:
        """Those of `known` that are meant, whatever else was named."""
        return tuple(
            name
            for name in sorted(known)
            if (not self.names or any(fnmatchcase(name, glob) for glob in self.names))
            and not self._is_excluded(name)
        )

    def _is_excluded(self, name: str) -> bool:
        return any(fnmatchcase(name, glob) for glob in self.exclude)


def read_targets(
    verb: str, names: tuple[str, ...], is_all: bool, exclude: tuple[str, ...], *, needed: bool
) -> Targets:
    """The targets, if the words can be ones; UsageError says what to add or change."""
    for glob in (*names, *exclude):
        if not _GLOB.fullmatch(glob):
            raise click.UsageError(
                f"{glob!r} is no robot's name; wanted a-z, 0-9, _ and -, with * ? [..] as wildcards"
            )
    if names and is_all:
        raise click.UsageError(f"{verb} takes names or --all, not both")
    if needed and not names and not is_all:
        raise click.UsageError(
            f"{verb} needs targets; add robot names, a glob such as 'tb3-*', or --all"
        )
    return Targets(names, is_all, exclude)


def check_name(name: str, known: Collection[str]) -> None:
    """NoTarget, with the nearest name, unless the robot is known."""
    if name not in known:
        raise NoTarget(f"{unknown('robot', name, known)}; see `swarmctl members`")


def read_assignments(words: Iterable[str], what: str = "-p") -> dict[str, Value]:
    """`key=value` words as a mapping; numbers as numbers, all else as text."""
    values: dict[str, Value] = {}
    size = 0
    for word in words:
        key, sign, text = word.partition("=")
        if not sign or not key:
            raise click.UsageError(
                f"{what} {_short(word)} is no key=value, such as {what} speed=0.15"
            )
        if not _is_utf8(word):
            raise click.UsageError(f"{what} {_short(word)} is not UTF-8; type it anew")
        if key in values:
            raise click.UsageError(f"{what} {key} is given twice; keep one")
        for part, limit in ((key, _MAX_KEY), (text, _MAX_TEXT)):
            if len(part) > limit:
                raise click.UsageError(f"{what} {_short(word)}: more than {limit} characters")
        size += len(word.encode())
        if size > _MAX_ALL:
            raise click.UsageError(f"{what}: all together are more than {_MAX_ALL} bytes")
        values[key] = _number(text)
    return values


def _is_utf8(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True


def _short(word: str) -> str:
    return repr(word if len(word) <= 40 else f"{word[:37]}...")


def _number(text: str) -> int | float | str:
    """The number that the text is in JSON's way, if it is one that can be sent; else the text."""
    if re.fullmatch(r"-?(0|[1-9]\d*)", text):
        return int(text) if len(text) < 20 and abs(int(text)) <= _MAX_INTEGER else text
    if re.fullmatch(r"-?(0|[1-9]\d*)?(\.\d*)?([eE][-+]?\d+)?", text):
        try:
            number = float(text)
        except ValueError:  # such as "." and "-"
            return text
        return number if math.isfinite(number) else text
    return text


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

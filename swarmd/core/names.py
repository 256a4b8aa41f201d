"""Names as users write them: ranges such as `tb3-[01-40]` and `r[1-3,7]`, globs, and commas. Pure.

`swarmctl keys`, rosters and the targets of verbs use these functions, so that a word means the same
everywhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from itertools import product

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import check_id

MAX_NAMES = 2048
_PARTS = re.compile(r"\[([^\[\]]*)\]")
_COMMA = re.compile(r",(?![^\[]*\])")  # outside of brackets
_NUMBERS = re.compile(r"(\d{1,9})(?:-(\d{1,9}))?")
_GLOB = re.compile(r"[a-z0-9_*?-]{1,63}")
_EXAMPLE = "tb3-[01-40]"


def owner_of(name: str) -> str:
    """The operator whose keys prove a stop in this name, which is the name itself as a rule.

    In version 0.2 a program for agents sends stops as `anna by mcp`, and robots of every version
    obey stops of every version. No name with keys has a space.
    """
    return name.partition(" by ")[0]


def expand_names(text: str) -> tuple[str, ...]:
    """The names in `text`, in its order. ConfigError for a wrong range or name, or a repeated name.

    Numbers are padded to the width of the first number of a range: `[01-40]` gives 01, 02, ... 40.
    """
    return tuple(check_id(name, f"a name of {text!r}") for name in _words(text))


def expand_globs(text: str) -> tuple[str, ...]:
    """As `expand_names`, also with globs: `*` is any number of characters, `?` a single one."""
    words = _words(text)
    for word in words:
        if not _GLOB.fullmatch(word):
            raise ConfigError(
                f"{word!r} is no robot name; expected a-z, 0-9, _ and -, with * and ? for any"
                f" characters, and numbers in brackets such as {_EXAMPLE}"
            )
    return words


def select_names(words: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    """The `known` names that words, ranges and globs select; all without words. ConfigError."""
    chosen: dict[str, None] = {} if words else dict.fromkeys(known)
    for glob in (glob for word in words for glob in expand_globs(word)):
        matching = [name for name in known if fnmatchcase(name, glob)]
        if not matching:
            raise ConfigError(f"{unknown('name', glob, known)}; see `swarmctl keys list`")
        chosen |= dict.fromkeys(matching)
    return tuple(chosen)


def check_distinct(*groups: Iterable[str]) -> None:
    """ConfigError if a name is in two groups: each name has one role."""
    seen: set[str] = set()
    for group in groups:
        for name in group:
            if name in seen:
                raise ConfigError(f"{name} is given two roles; each name has one")
            seen.add(name)


def _words(text: str) -> tuple[str, ...]:
    names: dict[str, None] = {}
    for word in _COMMA.split(text):
        for name in _expanded(word.strip(), text):
            if name in names:
                raise ConfigError(f"{text!r} gives {name} twice; name it once")
            names[name] = None
            if len(names) > MAX_NAMES:
                raise ConfigError(f"{text!r} gives more than {MAX_NAMES} names")
    return tuple(names)


def _expanded(word: str, text: str) -> Iterator[str]:
    pieces = _PARTS.split(word)
    fixed = pieces[::2]
    ranges = pieces[1::2]
    if any("[" in piece or "]" in piece for piece in fixed):
        raise ConfigError(f"{text!r} has a bracket without its pair; expected such as {_EXAMPLE}")
    for numbers in product(*(tuple(_numbers(inside, text)) for inside in ranges)):
        yield "".join(part for pair in zip(fixed, (*numbers, ""), strict=True) for part in pair)


def _numbers(inside: str, text: str) -> Iterator[str]:
    if len(inside) > 1 and inside.isdecimal():  # `[23]` in a shell's glob means 2 or 3
        raise ConfigError(
            f"{text!r} has [{inside}], the number {inside} alone; leave the brackets out, or write"
            f" [{','.join(inside)}] for {' and '.join(inside)}"
        )
    for part in inside.split(","):
        match = _NUMBERS.fullmatch(part.strip())
        if match is None:
            raise ConfigError(f"{text!r} has the range [{inside}]; expected such as {_EXAMPLE}")
        first = match[1]
        last = match[2] or match[1]
        if int(last) < int(first) or int(last) - int(first) >= MAX_NAMES:
            raise ConfigError(
                f"{text!r} has the range {part.strip()}; expected up to {MAX_NAMES} rising numbers"
            )
        for number in range(int(first), int(last) + 1):
            yield str(number).zfill(len(first))

"""Assignments as people type them: `speed=0.1 mode=wide`."""

from __future__ import annotations

from collections.abc import Iterable

from swarmd.core.errors import ConfigError
from swarmd.core.numbers import exact_number

Value = bool | int | float | str | None

_MAX_KEY = 64  # characters of a parameter's name
_MAX_TEXT = 256  # characters of a parameter's value
_MAX_BYTES = 32 * 1024  # of all words of a request together


def read_assignments(words: Iterable[str], option: str = "-p") -> dict[str, Value]:
    """The values of `key=value` words, exact numbers as numbers; ConfigError for a wrong word."""
    values: dict[str, Value] = {}
    size = 0
    for word in words:
        shown = f"{option} {word if len(word) <= 40 else f'{word[:37]}...'!r}"
        key, sign, text = word.partition("=")
        if not sign or not key:
            raise ConfigError(f"{shown} is no key=value, such as {option} speed=0.15")
        try:
            size += len(word.encode())
        except UnicodeEncodeError:
            raise ConfigError(f"{shown} is not UTF-8; type it again") from None
        if key in values:
            raise ConfigError(f"{option} {key} is given twice; keep one")
        for part, limit in ((key, _MAX_KEY), (text, _MAX_TEXT)):
            if len(part) > limit:
                raise ConfigError(f"{shown}: more than {limit} characters")
        if size > _MAX_BYTES:
            raise ConfigError(f"{option}: all together are more than {_MAX_BYTES} bytes")
        values[key] = exact_number(text)
    return values

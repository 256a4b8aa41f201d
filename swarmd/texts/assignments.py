"""Assignments as people type them: `speed=0.1 mode=wide`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from swarmd.core.errors import ConfigError

Value = bool | int | float | str | None

_MAX_INTEGER = 2**53
# The bounds of a request: characters of a parameter's name and value, bytes of all together.
_MAX_KEY, _MAX_TEXT, _MAX_BYTES = 64, 256, 32 * 1024


def read_assignments(words: Iterable[str], option: str = "-p") -> dict[str, Value]:
    """The values of `key=value` words, numbers as numbers; ConfigError for a wrong word."""
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
        values[key] = _number(text)
    return values


def _number(text: str) -> int | float | str:
    """The number, if the text is one in JSON's syntax that can be sent; else the text."""
    if re.fullmatch(r"-?(0|[1-9]\d*)", text):
        return int(text) if len(text) < 20 and abs(int(text)) <= _MAX_INTEGER else text
    if re.fullmatch(r"-?(0|[1-9]\d*)?(\.\d*)?([eE][-+]?\d+)?", text):
        try:
            number = float(text)
        except ValueError:  # such as "." and "-"
            return text
        return number if math.isfinite(number) else text
    return text

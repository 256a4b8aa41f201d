"""Checks and converts arguments of the client's methods: times, words and parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from swarmd.core.errors import ConfigError
from swarmd.core.numbers import python_value

if TYPE_CHECKING:
    from swarmd.operator.texts.assignments import Value

MAX_TIME = 1e7  # s

Words: TypeAlias = str | Iterable[str]
T = TypeVar("T", float, float | None)
"""One word, or several."""


def check_time(name: str, value: T) -> T:
    """The time as a float of Python, or None as it is.

    ConfigError unless a given time is a finite number of seconds above 0.
    """
    plain = python_value(value)
    is_number = isinstance(plain, Real) and not isinstance(plain, bool)
    if plain is not None and not (is_number and 0.0 < plain <= MAX_TIME):
        raise ConfigError(
            f"{name} is {value!r}; expected a number of seconds above 0, at most {MAX_TIME:.0e}"
        )
    return plain if plain is None else float(plain)  # type: ignore[return-value]  # mypy: a union


def check_words(words: Words, what: str) -> tuple[str, ...]:
    """The words as a tuple; ConfigError unless they are a text or several texts."""
    plain = python_value(words)
    some = tuple(plain) if isinstance(plain, Iterable) and not isinstance(plain, str) else (plain,)
    if not all(isinstance(word, str) for word in some):
        raise ConfigError(f"{what} is {words!r}; expected a text, or a list of texts")
    return tuple(map(str, some))  # numpy's texts cannot be sent


def plain_params(values: Mapping[str, Any]) -> dict[str, Value]:
    """Values that can be sent: numpy's values as Python's. ConfigError for any other type."""
    if not isinstance(values, Mapping) or not all(isinstance(key, str) for key in values):
        raise ConfigError(f"parameters are {values!r}; expected a dict, such as {{'speed': 0.15}}")
    plain: dict[str, Value] = {}
    for key, value in python_value(values).items():
        if isinstance(value, bool | str) or value is None:
            plain[key] = value
        elif isinstance(value, Integral) and -(2**63) <= int(value) < 2**63:
            plain[key] = int(value)
        elif isinstance(value, Real) and not isinstance(value, Integral) and math.isfinite(value):
            plain[key] = float(value)
        else:
            wanted = "a finite number of at most 64 bits, a text, True, False or None"
            raise ConfigError(f"parameter {key} is {value!r}; expected {wanted}")
    return plain

"""Numbers of texts, files, options and callers as Python's numbers.

Texts are read by the core schema of YAML 1.2, for files and options alike.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

INTEGER = re.compile(r"[-+]?[0-9]+\Z|0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
FLOAT = re.compile(
    r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z"
    r"|[-+]?\.(?:inf|Inf|INF)\Z|\.(?:nan|NaN|NAN)\Z"
)
_DURATION = re.compile(r"(\d+(?:\.\d+)?)(ms|s|min|m|h|)")
_UNITS = {"ms": 0.001, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "": 1.0}
_BASES = {"0o": 8, "0x": 16}
_MAX_BITS = 14000  # str() refuses more than 4300 digits
_MAX_EXACT = 2**53  # readers of JSON keep integers exact up to here


def python_value(value: Any) -> Any:
    """The value with numbers and arrays of numpy, and of libraries like it, as Python's.

    A path becomes its text.

    Also inside mappings, lists and tuples: `python_value({"speed": np.linspace(0, 1, 2)})` is
    `{"speed": [0.0, 1.0]}`. numpy is not imported: what has a method `tolist` is converted.
    """
    if isinstance(value, Mapping):
        return {key: python_value(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [python_value(inner) for inner in value]
    if isinstance(value, PurePath):
        return str(value)
    convert = None if isinstance(value, type) else getattr(value, "tolist", None)
    return value if convert is None else convert()


def read_number(text: str) -> int | float | None:
    """The number in the text: `010` is 10, `0x10` is 16, `.inf` is infinite.

    None for any other text, such as `1_000`, `1:30`, and for numbers beyond the range of a float.
    """
    try:
        if INTEGER.match(text):
            whole = int(text, _BASES.get(text[:2], 10))
            return None if whole.bit_length() > _MAX_BITS else whole
        if FLOAT.match(text):
            number = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
            return None if math.isinf(number) and text[-1].isdigit() else number
    except ValueError:  # more digits than int() takes
        pass
    return None


def exact_number(text: str) -> int | float | str:
    """The number if the text is its shortest form (`7`, `0.5`), else the text (`010`, `1e3`).

    Either can be converted later without loss, once the type is known: `1e3` may be a name.
    """
    number = read_number(text)
    is_exact = number is not None and str(number) == text and abs(number) <= _MAX_EXACT
    return number if is_exact and number is not None else text


def finite_number(text: str) -> float:
    """The number in the text; NaN if the text is no finite number."""
    number = read_number(text)
    try:
        value = math.nan if number is None else float(number)
    except OverflowError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def read_duration(text: str) -> float | None:
    """The seconds of `60`, `60s`, `1.5m`, `3min`, `500ms`, `2h`; None for any other text."""
    match = _DURATION.fullmatch(text.strip().lower())
    return float(match[1]) * _UNITS[match[2]] if match else None

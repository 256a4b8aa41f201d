"""The fields of ROS messages as rclpy has them: defaults, checks, copies and plain values.

The checks are those of rclpy up to Iron, which a message makes whenever a field is set; later
versions leave them out by default. So a node that passes here passes on every ROS.
"""

from __future__ import annotations

import array
import math
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

_INTEGERS = {
    "int8": ("b", np.int8, -(2**7), 2**7 - 1),
    "uint8": ("B", np.uint8, 0, 2**8 - 1),
    "int16": ("h", np.int16, -(2**15), 2**15 - 1),
    "uint16": ("H", np.uint16, 0, 2**16 - 1),
    "int32": ("i", np.int32, -(2**31), 2**31 - 1),
    "uint32": ("I", np.uint32, 0, 2**32 - 1),
    "int64": ("q", np.int64, -(2**63), 2**63 - 1),
    "uint64": ("Q", np.uint64, 0, 2**64 - 1),
}
"""Type code of `array`, type of numpy, least and greatest value."""
_FLOATS = {"float32": ("f", np.float32), "float64": ("d", np.float64)}
_LARGEST_FLOAT32 = 3.402823466e38
_FLOAT32 = struct.Struct("<f")
_SAME_NAMES = {"char": "uint8", "wstring": "string"}


class FieldType(NamedTuple):
    """What a message does with one of its fields.

    `check(name, value)` gives the value that is kept; AssertionError if the type does not fit.
    `copy` gives what a subscriber gets. `plain` gives a value of MessagePack's types, and `read`
    makes a value for `check` of it.
    """

    text: str
    default: Callable[[], Any]
    check: Callable[[str, Any], Any]
    copy: Callable[[Any], Any]
    plain: Callable[[Any], Any]
    read: Callable[[Any], Any]


def base_type(name: str, *, bound: int = 0, default: Any = None) -> FieldType:
    """The type of a field of a primitive type; `bound`: characters of a bounded string."""
    name = _SAME_NAMES.get(name, name)
    if name == "bool":
        return FieldType(name, lambda: bool(default), _check_bool, _same, _same, _same)
    if name in _FLOATS:
        first = float(default or 0.0)
        is_short = name == "float32"
        check = _check_float32 if is_short else _check_float
        return FieldType(name, lambda: first, check, _rounded if is_short else float, _same, float)
    if name == "string":
        text = "" if default is None else str(default)
        return FieldType(name, lambda: text, _string_check(bound), _same, _same, _same)
    if name in ("byte", "octet"):
        return FieldType("octet", lambda: b"\0", _check_byte, _same, _same, _same)
    _, _, least, most = _INTEGERS[name]
    number = int(default or 0)
    return FieldType(name, lambda: number, _integer_check(name, least, most), int, int, _same)


def message_type(text: str, kind: type) -> FieldType:
    """The type of a field that is a message of the class `kind`."""
    made: Any = kind

    def check(name: str, value: Any) -> Any:
        assert isinstance(value, kind), f"The {name!r} field must be a sub message of type {text!r}"
        return value

    return FieldType(text, made, check, made.copied, made.plain, made.of_plain)


def array_type(item: FieldType, length: int) -> FieldType:
    """The type of a field of exactly `length` items."""
    text = f"{item.text}[{length}]"
    kind = _numpy_kind(item.text)
    if kind is None:
        return _list_type(text, item, length, length)

    def check(name: str, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            assert value.dtype == kind, f"The {name!r} field must have the dtype {kind.__name__}"
            assert value.size == length, f"The {name!r} field must have {length} values"
            return value
        _check_list(name, value, item, length, length)
        return np.array(value, dtype=kind)

    return FieldType(
        text,
        lambda: np.zeros(length, dtype=kind),
        check,
        lambda value: value.copy(),
        lambda value: value.tolist(),
        _same,
    )


def sequence_type(item: FieldType, bound: int) -> FieldType:
    """The type of a field of any number of items, at most `bound` unless that is 0."""
    text = f"sequence<{item.text}, {bound}>" if bound else f"sequence<{item.text}>"
    code = _array_code(item.text)
    most = bound or 2**32
    if code is None:
        return _list_type(text, item, 0, most)

    def check(name: str, value: Any) -> Any:
        if isinstance(value, array.array):
            assert value.typecode == code, f"The {name!r} field must have the type code {code!r}"
            assert len(value) <= most, f"The {name!r} field must have at most {most} values"
            return value
        _check_list(name, value, item, 0, most)
        return array.array(code, value)

    return FieldType(
        text,
        lambda: array.array(code),
        check,
        lambda value: array.array(code, value),
        lambda value: value.tolist(),
        _same,
    )


def _list_type(text: str, item: FieldType, least: int, most: int) -> FieldType:
    def check(name: str, value: Any) -> Any:
        _check_list(name, value, item, least, most)
        return value

    return FieldType(
        text,
        lambda: [item.default() for _ in range(least)],
        check,
        lambda value: [item.copy(one) for one in value],
        lambda value: [item.plain(one) for one in value],
        lambda value: [item.read(one) for one in value],
    )


def _check_list(name: str, value: Any, item: FieldType, least: int, most: int) -> None:
    is_list = isinstance(value, list | tuple | set | frozenset | array.array | bytes | bytearray)
    assert is_list, f"The {name!r} field must be a set or sequence, not a {type(value).__name__}"
    assert least <= len(value) <= most, f"The {name!r} field has {len(value)} values"
    for one in value:
        item.check(name, one)


def _array_code(name: str) -> str | None:
    if name in _INTEGERS:
        return _INTEGERS[name][0]
    return _FLOATS[name][0] if name in _FLOATS else None


def _numpy_kind(name: str) -> type | None:
    if name in _INTEGERS:
        return _INTEGERS[name][1]
    return _FLOATS[name][1] if name in _FLOATS else None


def _same(value: Any) -> Any:
    return value


def _rounded(value: float) -> float:
    """As a subscriber reads it: a message carries it in 32 bits."""
    rounded: float = _FLOAT32.unpack(_FLOAT32.pack(value))[0]
    return rounded


def _check_bool(name: str, value: Any) -> Any:
    assert isinstance(value, bool), f"The {name!r} field must be of type 'bool'"
    return value


def _check_float(name: str, value: Any) -> Any:
    assert isinstance(value, float), f"The {name!r} field must be of type 'float'"
    return value


def _check_float32(name: str, value: Any) -> Any:
    assert isinstance(value, float), f"The {name!r} field must be of type 'float'"
    is_fitting = not math.isfinite(value) or abs(value) <= _LARGEST_FLOAT32
    assert is_fitting, f"The {name!r} field must be a float32"
    return value


def _check_byte(name: str, value: Any) -> Any:
    is_byte = isinstance(value, bytes) and len(value) == 1
    assert is_byte, f"The {name!r} field must be of type 'bytes' and of length 1"
    return value


def _string_check(bound: int) -> Callable[[str, Any], Any]:
    def check(name: str, value: Any) -> Any:
        assert isinstance(value, str), f"The {name!r} field must be of type 'str'"
        is_fitting = not bound or len(value) <= bound
        assert is_fitting, f"The {name!r} field must have at most {bound} characters"
        return value

    return check


def _integer_check(kind: str, least: int, most: int) -> Callable[[str, Any], Any]:
    def check(name: str, value: Any) -> Any:
        assert isinstance(value, int), f"The {name!r} field must be of type 'int'"
        assert least <= value <= most, f"The {name!r} field must be an {kind}"
        return value

    return check

"""Configuration from several sources, merged, typed, and aware of where each key came from.

Every fault is one line: source, key, what stands there, what was wanted, and the nearest valid
key where one is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec import inspect

from swarmd.core.errors import ConfigError, unknown
from swarmd.settings.yamlfile import Data, brief

Keys = tuple[str | int, ...]
Fault = tuple[Keys, str]
T = TypeVar("T")


class Layered:
    """Sources of one mapping, strongest first. Mappings merge by key, lists are replaced.

    What is missing in all of them is told of as `home`, by default the strongest.
    """

    def __init__(self, *sources: tuple[str, Mapping[str, Any]], home: str | None = None) -> None:
        self._sources = sources
        self._home = home or sources[0][0]
        self.data: Data = {}
        for _, data in reversed(sources):
            self.data = _merge(self.data, data)

    def source(self, *keys: str | int) -> str | None:
        """The name of the strongest source that holds the key; None if none does."""
        return next((name for name, data in self._sources if _holds(data, keys)), None)

    def error(self, keys: Sequence[str | int], text: str) -> ConfigError:
        """The error `<source of the key>: <text>`."""
        above = (self.source(*keys[:depth]) for depth in range(len(keys), 0, -1))
        return ConfigError(f"{next((name for name in above if name), self._home)}: {text}")

    def build(self, kind: type[T]) -> T:
        """The struct of type `kind`; ConfigError names the first key that is wrong."""
        try:
            return msgspec.convert(self.data, kind)
        except (msgspec.ValidationError, OverflowError) as error:
            keys, text = _fault(self.data, kind, ()) or ((), str(error))
            raise self.error(keys, text) from error


def dotted(keys: Sequence[str | int]) -> str:
    """A key as errors show it, such as `limits.linear` or `footprint[2]`, always one line."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    text = text.removeprefix(".")
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> Data:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged


def _holds(data: Any, keys: Sequence[str | int]) -> bool:
    for key in keys:
        is_there = key in data if isinstance(data, Mapping) else isinstance(data, list)
        if not is_there:
            return False
        data = data[key]
    return True


def _fault(data: Any, kind: Any, keys: Keys) -> Fault | None:
    """Where `data` first departs from `kind`, and the line that says so; None if nowhere."""
    try:
        msgspec.convert(data, kind)
    except (msgspec.ValidationError, OverflowError):
        pass
    else:
        return None
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and isinstance(data, dict):
        faults = _struct_faults(data, kind, keys)
    else:
        faults = _item_faults(data, kind, keys)
    own = f"{dotted(keys)} is {brief(data)}; wanted {_wanted(kind, data)}"
    return next(faults, (keys, own.strip()))


def _struct_faults(data: Data, kind: type[msgspec.Struct], keys: Keys) -> Iterator[Fault]:
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    for key in data:
        if key not in fields:
            inside = f"{dotted(keys)} has " if keys else ""
            yield (*keys, key), inside + unknown("key", key, fields)
    for name, field in fields.items():
        below = (*keys, name)
        if name in data:
            fault = _fault(data[name], field.type, below)
            if fault is not None:
                yield fault
        elif field.required:
            yield below, f"{dotted(below)} is missing; wanted {_wanted(field.type, None)}"


def _item_faults(data: Any, kind: Any, keys: Keys) -> Iterator[Fault]:
    origin, kinds = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType) and kinds[1:] == (NoneType,) and data is not None:
        inside = _fault(data, kinds[0], keys)
        if inside is not None and inside[0] != keys:
            yield inside
        return
    items: list[tuple[str | int, Any, Any]] = []
    if origin is dict and isinstance(data, dict):
        items = [(key, value, kinds[1]) for key, value in data.items()]
    elif origin in (list, tuple) and isinstance(data, list):
        of_any_length = origin is list or kinds[-1] is Ellipsis
        if of_any_length or len(kinds) == len(data):
            items = [(i, v, kinds[0] if of_any_length else kinds[i]) for i, v in enumerate(data)]
    for key, value, child in items:
        fault = _fault(value, child, (*keys, key))
        if fault is not None:
            yield fault


def _wanted(kind: Any, value: object) -> str:
    text = _described(inspect.type_info(kind))
    if text.startswith("text") and isinstance(value, bool | int | float):
        return f"{text} (put it in quotes)"
    return text


def _described(node: inspect.Type) -> str:
    match node:
        case inspect.FloatType():
            return f"a number{_bounds(node)}"
        case inspect.IntType():
            return f"a whole number{_bounds(node)}"
        case inspect.StrType():
            return "text"
        case inspect.BoolType():
            return "true or false"
        case inspect.NoneType():
            return "null"
        case inspect.LiteralType():
            return " or ".join(map(str, node.values))
        case inspect.UnionType():
            return " or ".join(dict.fromkeys(_described(part) for part in node.types))
        case inspect.TupleType():
            return f"[{', '.join(_described(part) for part in node.item_types)}]"
        case inspect.ListType() | inspect.VarTupleType():
            return f"a list, each {_described(node.item_type)}"
        case inspect.StructType():
            return f"keys and values: {', '.join(field.encode_name for field in node.fields)}"
        case _:
            return "keys and values"


def _bounds(node: inspect.FloatType | inspect.IntType) -> str:
    words = {"gt": "above", "ge": "of at least", "lt": "below", "le": "up to"}
    bounds = ((word, getattr(node, name)) for name, word in words.items())
    return " and".join(f" {word} {bound:g}" for word, bound in bounds if bound is not None)

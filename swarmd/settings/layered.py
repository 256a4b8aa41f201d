"""Merges configuration from several sources and reads it into typed structs.

Each fault is one line with source, key, value and expected value. For an unknown key the line names
the most similar valid key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import UnionType
from typing import Annotated, Any, TypeAlias, TypeVar, Union, cast, get_args, get_origin

import msgspec
from msgspec import Struct, inspect

from swarmd.core.errors import ConfigError, nearest, unknown
from swarmd.settings.yamlfile import Data, brief

Keys: TypeAlias = tuple[str | int, ...]
Fault: TypeAlias = tuple[Keys, str]
Check: TypeAlias = Callable[[Any, Keys], Iterable[Fault]]
"""Yields what the types of a struct cannot express. Called with each valid struct and its place."""
T = TypeVar("T", bound=Struct)


class Layered:
    """Sources of one mapping, strongest first. Mappings merge by key, lists are replaced.

    A missing key is reported as missing in the source `home`, by default the strongest source.
    """

    def __init__(self, *sources: tuple[str, Mapping[str, Any]], home: str | None = None) -> None:
        self._sources = sources
        self._home = home or sources[0][0]
        self.data: Data = {}
        for _, data in reversed(sources):
            self.data = _merge(self.data, data)

    def source(self, *keys: str | int) -> str | None:
        """The name of the strongest source with this key; None without such a source."""
        return next((name for name, data in self._sources if _holds(data, keys)), None)

    def error(self, keys: Sequence[str | int], text: str) -> ConfigError:
        """The error `<source of the key>: <text>`."""
        above = (self.source(*keys[:depth]) for depth in range(len(keys), 0, -1))
        return ConfigError(f"{next((name for name in above if name), self._home)}: {text}")

    def build(self, kind: type[T], check: Check | None = None) -> T:
        """The struct of type `kind`. ConfigError names the first key that is wrong."""
        value, faults = read(self.data, kind, check)
        if faults:
            raise self.error(*faults[0])
        return cast("T", value)


def read(data: Any, kind: Any, check: Check | None = None) -> tuple[Any, list[Fault]]:
    """Convert `data` (from YAML) to the type `kind`; returns the value, and all faults in order.

    For a union of structs, the data is read as the struct whose tag is a key of the data. A faulty
    item of a list or mapping, or a faulty field of the outermost struct, is left out of the value.
    An inner struct with a faulty field is left out as a whole. The value is None if nothing is
    left. `check` yields further faults of a struct.
    """
    reader = _Reader(check)
    is_struct = isinstance(data, dict) and _is_struct(kind)
    value = reader.outermost(data, kind) if is_struct else reader.read(data, kind, ())
    return (None if value is _INVALID else value), reader.faults


def fault_at(keys: Keys, text: str) -> Fault:
    """A fault whose line is the key, then `text`, which starts with a verb."""
    return keys, f"{dotted(keys)} {text}".lstrip()


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


_INVALID: Any = object()
_SCALARS = {inspect.BoolType, inspect.IntType, inspect.FloatType, inspect.StrType}


class _Reader:
    """Converts data to a type piece by piece, so that each fault has its place."""

    def __init__(self, check: Check | None) -> None:
        self.faults: list[Fault] = []
        self._check = check

    def read(self, data: Any, kind: Any, keys: Keys) -> Any:
        """The value without faulty items, adding each fault; _INVALID if nothing is left."""
        arms = [(plain, limits) for plain, limits in _arms(kind) if _is_shaped(plain, data)]
        structs = [plain for plain, _ in arms if _is_struct(plain)]
        if structs:
            return self._struct(data, structs, keys)
        if len(arms) != 1:
            return self._convert(data, kind, keys)
        plain, limits = arms[0]
        if limits:
            self._convert(data, Annotated[(type(data), *limits)], keys, described=kind)
        inner = get_args(plain)
        if isinstance(data, dict):
            read = {key: self.read(value, inner[1], (*keys, key)) for key, value in data.items()}
            return {key: value for key, value in read.items() if value is not _INVALID}
        is_fixed = get_origin(plain) is tuple and inner[-1] is not Ellipsis
        items = [
            self.read(item, inner[i if is_fixed else 0], (*keys, i)) for i, item in enumerate(data)
        ]
        values = [item for item in items if item is not _INVALID]
        return values if get_origin(plain) is list else tuple(values)

    def outermost(self, data: Data, kind: type[Struct]) -> Any:
        """The struct without its faulty fields; _INVALID if a faulty field is required."""
        values = self._fields(data, kind, ())
        return self._made(kind, values, (), is_clean=not self.faults)

    def _struct(self, data: Data, kinds: Sequence[Any], keys: Keys) -> Any:
        before = len(self.faults)
        kind = kinds[0] if len(kinds) == 1 else self._tagged(data, kinds, keys)
        values = {} if kind is None else self._fields(data, kind, keys)
        if len(self.faults) > before:
            return _INVALID
        value = self._made(kind, values, keys, is_clean=True)
        return value if len(self.faults) == before else _INVALID

    def _tagged(self, data: Data, kinds: Sequence[Any], keys: Keys) -> Any:
        tags = {kind.__struct_config__.tag: kind for kind in kinds}
        given = [tag for tag in tags if tag in data]
        if len(given) == 1:
            return tags[given[0]]
        has = " and ".join(given or data) or "nothing"
        hints = {key: hint for key in data if not given and (hint := nearest(key, tags))}
        mistyped, near = next(iter(hints.items()), ("", ""))
        meant = f"; did you mean {near!r}?" if near else ""
        _, text = fault_at(keys, f"has {has}; expected exactly one of {', '.join(tags)}{meant}")
        place = mistyped or next(iter(given), "")  # the key whose line the fault names
        self.faults.append(((*keys, place) if place else keys, text))
        return None

    def _fields(self, data: Data, kind: type[Struct], keys: Keys) -> dict[str, Any]:
        """The valid fields by name."""
        fields = _fields(kind)
        for key in data:
            if key not in fields:
                inside = f"{dotted(keys)} has " if keys else ""
                self.faults.append(((*keys, key), inside + unknown("key", key, fields)))
        values = {}
        for key, field in fields.items():
            if key in data:
                values[field.name] = self.read(data[key], field.type, (*keys, key))
            elif field.required:
                wanted = f"is missing; expected {_wanted(field.type, None)}"
                _, text = fault_at((*keys, key), wanted)
                tag = kind.__struct_config__.tag
                self.faults.append(((*keys, tag if tag in data else key), text))
        return {name: value for name, value in values.items() if value is not _INVALID}

    def _made(self, kind: Any, values: dict[str, Any], keys: Keys, *, is_clean: bool) -> Any:
        if any(field.required and field.name not in values for field in _fields(kind).values()):
            return _INVALID
        try:
            struct = kind(**values)
        except ValueError as error:  # from __post_init__
            self.faults.append(fault_at(keys, str(error)))
            return _INVALID
        if self._check is not None and is_clean:
            self.faults += self._check(struct, keys)
        return struct

    def _convert(self, data: Any, kind: Any, keys: Keys, described: Any = None) -> Any:
        try:
            return msgspec.convert(data, kind)
        except (msgspec.ValidationError, OverflowError):
            wanted = _wanted(described or kind, data)
            self.faults.append(fault_at(keys, f"is {brief(data)}; expected {wanted}"))
            return _INVALID


@lru_cache(maxsize=256)  # evaluating annotations takes 0.1 ms
def _fields(kind: type[Struct]) -> Mapping[str, msgspec.structs.FieldInfo]:
    return {field.encode_name: field for field in msgspec.structs.fields(kind)}


def _arms(kind: Any, limits: tuple[Any, ...] = ()) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """The types of a union, or the type itself, each with its limits of length."""
    origin = get_origin(kind)
    if origin is Annotated:
        inner, *more = get_args(kind)
        yield from _arms(inner, (*limits, *more))
    elif origin in (Union, UnionType):
        for arm in get_args(kind):
            yield from _arms(arm, limits)
    else:
        yield kind, limits


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)


def _is_shaped(kind: Any, data: Any) -> bool:
    """Whether data can be read into the type piece by piece."""
    if isinstance(data, dict):
        return _is_struct(kind) or get_origin(kind) is dict
    if not isinstance(data, list):
        return False
    inner = get_args(kind)
    is_tuple = get_origin(kind) is tuple and (inner[-1] is Ellipsis or len(inner) == len(data))
    return get_origin(kind) is list or is_tuple


def _wanted(kind: Any, value: object) -> str:
    text = _described(inspect.type_info(kind))
    if text.startswith("text") and isinstance(value, bool | int | float):
        return f"{text} (put it in quotes)"
    return text


def _described(node: inspect.Type) -> str:
    """The type of a key in words, for messages such as "expected a number of at least 0".

    `node`: the type by msgspec's inspection. A description in the type's `extra_json_schema`
    replaces these words.
    """
    match node:
        case inspect.Metadata():
            return str((node.extra_json_schema or {}).get("description") or _described(node.type))
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
            return _described_union(node)
        case inspect.TupleType():
            return f"[{', '.join(_described(part) for part in node.item_types)}]"
        case inspect.ListType() | inspect.VarTupleType():
            return f"a list, each {_described(node.item_type)}"
        case inspect.StructType() if node.tag is not None:
            return str(node.tag)
        case inspect.StructType():
            return f"keys and values: {', '.join(field.encode_name for field in node.fields)}"
        case _:
            return "keys and values"


def _described_union(node: inspect.UnionType) -> str:
    """The types of a union in words; all scalar types together get one text."""
    texts = []
    # A list comes last, since the text of a list ends with that of its items.
    arms = sorted(node.types, key=lambda arm: isinstance(arm, inspect.ListType))
    if {type(arm) for arm in arms} >= _SCALARS:
        texts.append("a number, text, true or false")
        arms = [arm for arm in arms if type(arm) not in _SCALARS]
    return " or ".join(dict.fromkeys([*texts, *map(_described, arms)]))


def _bounds(node: inspect.FloatType | inspect.IntType) -> str:
    words = {"gt": "above", "ge": "of at least", "lt": "below", "le": "up to"}
    bounds = ((word, getattr(node, name)) for name, word in words.items())
    return " and".join(f" {word} {bound:g}" for word, bound in bounds if bound is not None)

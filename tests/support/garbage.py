"""Bytes that every decoder must refuse, made from a valid message."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import msgpack
from hypothesis import strategies as st
from msgspec import Struct, inspect

from swarmd.core.goal import Goal
from swarmd.core.pattern_manifest import PatternManifest, Signed
from swarmd.core.verbs import PushRequest, RosterRequest
from swarmd.link.datagram import GoalReport
from swarmd.link.keys.roster import Roster, SignedRoster
from swarmd.link.keys.roster_change import SharedRoster

Garbage = Callable[[random.Random, bytes, int], bytes]


def noise(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """Random bytes of another wire version."""
    return bytes([rng.choice((0, *range(2, 256)))]) + rng.randbytes(rng.randrange(limit // 32))


def versioned_noise(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The right version, then a byte that MessagePack never uses, then random ones."""
    return b"\x01\xc1" + rng.randbytes(rng.randrange(limit // 32))


def truncated(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message without its end."""
    return valid[: rng.randrange(1, len(valid))]


def trailed(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message with bytes after it."""
    return valid + rng.randbytes(rng.randrange(1, 9))


def oversized(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message with more bytes after it than its key may carry."""
    return valid + bytes(limit)


def nested(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """Arrays in arrays, deeper than a stack; the innermost never comes."""
    return b"\x01" + b"\x91" * rng.randrange(min(900, limit // 2), min(60_000, limit))


KINDS: tuple[Garbage, ...] = (noise, versioned_noise, truncated, trailed, oversized, nested)
"""All of them. Arguments: random generator, a valid message, the limit of its key in bytes."""


# Messages that decode, at the ends of what their types allow, and such with fields that do not.

SURROGATE = "\ud800"
"""A lone surrogate, which no UTF-8 has; it is packed as its bytes."""
TEXTS = (
    *("", "\0", "a\0.mcap", "../a.mcap", "/etc/passwd", ".mcap", "..", "a/b.mcap", "\\", "\n"),
    *("%s%n{0}", "\u202e\u2028", "a" * 63, "a" * 64, "x" * 500, "\U0001f41d" * 200, "r1", "r2"),
    *("drive", "flocking", "table", "versions", "start", "done", "nothing > 1e999", "0"),
    *("speed", "label:red", "[", "[!a-", "lab", "file", "own", "own:Own", "1.0", "0123456789ab"),
)
WRONG: tuple[object, ...] = (
    *(None, True, -1, 0, 1.5, 2**63, 2**64 - 1, -(2**63), math.nan, math.inf, -math.inf),
    *("", "\0", SURROGATE, "x" * 70_000, b"", b"\xff" * 64, [], {}, [[[[]]]], {"": {"": None}}),
    *(msgpack.Timestamp(2**32, 1), msgpack.ExtType(5, b"\0"), {1: 2}, ["\0"] * 300),
)
# Fields of bytes that hold a message of their own.
CONTENTS: Mapping[tuple[type, str], type[Struct]] = {
    (PushRequest, "content"): PatternManifest,
    (RosterRequest, "roster"): SignedRoster,
    (SignedRoster, "content"): Roster,
    (SharedRoster, "roster"): SignedRoster,
    (GoalReport, "goal"): Goal,
    (Signed, "content"): PatternManifest,
}


def packed(value: object) -> bytes:
    """MessagePack of plain values; lone surrogates are packed, too."""
    content: bytes = msgpack.packb(value, unicode_errors="surrogatepass")
    return content


@cache
def hostile(kind: object) -> st.SearchStrategy[Any]:
    """Plain values of a type that msgspec decodes: at the ends of its bounds, or hostile."""
    return _fitting(inspect.type_info(kind))


def hostile_message(kind: type[Struct]) -> st.SearchStrategy[Any]:
    """A message of that type in plain values, of which some fields may not fit their types."""
    return st.builds(_spoilt, hostile(kind), st.lists(_SPOILS, max_size=2))


_SPOILS = st.tuples(st.integers(0, 50), st.sampled_from(WRONG))


def _spoilt(message: Any, spoils: list[tuple[int, object]]) -> Any:
    for number, wrong in spoils if message else ():
        if isinstance(message, dict):
            message = {**message, sorted(message)[number % len(message)]: wrong}
        else:
            at = number % len(message)
            message = [*message[:at], wrong, *message[at + 1 :]]
    return message


def _fitting(kind: inspect.Type) -> st.SearchStrategy[Any]:
    match kind:
        case inspect.IntType():
            low, high = kind.ge if kind.ge is not None else -(2**63), kind.le
            low = low if kind.gt is None else kind.gt + 1
            high = 2**64 - 1 if high is None else high
            return st.sampled_from(sorted({low, high, *(n for n in (0, 1, 7) if low <= n <= high)}))
        case inspect.FloatType():
            found = [-1e300, -1.0, -1e-310, 0.0, 1e-310, 1.0, 1e300, math.nan, math.inf, -math.inf]
            ends = (kind.ge, kind.le)
            found += [end for end in ends if end is not None]
            fits = [x for x in found if _fits(x, kind)]
            return st.sampled_from(fits)
        case inspect.StrType():
            texts = {*TEXTS, "x" * (kind.max_length or 2000), "\0" * (kind.max_length or 10)}
            fits_text = sorted(text for text in texts if _fits_text(text, kind))
            return st.sampled_from(fits_text)
        case inspect.BytesType():
            low, high = kind.min_length or 0, min(kind.max_length or 2000, 40_000)
            sizes = sorted({low, high, *((1,) if low <= 1 <= high else ())})
            return st.builds(
                lambda size, byte: byte * size,
                st.sampled_from(sizes),
                st.sampled_from([b"\0", b"\xff", b"\xc1", b"x"]),
            )
        case inspect.UnionType():
            return st.one_of(*map(_fitting, kind.types))
        case inspect.LiteralType():
            return st.sampled_from(kind.values)
        case inspect.EnumType():
            return st.sampled_from([one.value for one in kind.cls])
        case inspect.VarTupleType() | inspect.ListType() | inspect.FrozenSetType():
            high = min(kind.max_length or 400, 400)
            item = _fitting(kind.item_type)
            few = st.lists(item, max_size=min(high, 3))
            return few | st.builds(lambda one: [one] * high, item)
        case inspect.TupleType():
            return st.tuples(*map(_fitting, kind.item_types)).map(list)
        case inspect.DictType():
            key, value = _fitting(kind.key_type), _fitting(kind.value_type)
            return st.dictionaries(key, value, min_size=kind.min_length or 0, max_size=3)
        case inspect.StructType():
            return _of_struct(kind)
        case inspect.BoolType():
            return st.booleans()
        case inspect.NoneType():
            return st.none()
    return st.sampled_from(WRONG)


def _of_struct(kind: inspect.StructType) -> st.SearchStrategy[Any]:
    def value(one: inspect.Field) -> st.SearchStrategy[Any]:
        inner = CONTENTS.get((kind.cls, one.name))
        if inner is None:
            return _fitting(one.type)
        return _fitting(one.type) | st.deferred(lambda: hostile_message(inner)).map(packed)

    if kind.array_like:
        whole = st.tuples(*map(value, kind.fields)).map(list)
        least = sum(one.required for one in kind.fields)
        sizes = st.integers(least, len(kind.fields))
        return st.builds(lambda fields, size: fields[:size], whole, sizes)
    tag = {} if kind.tag is None else {str(kind.tag_field): st.just(kind.tag)}
    needed = {one.encode_name: value(one) for one in kind.fields if one.required}
    free = {one.encode_name: value(one) for one in kind.fields if not one.required}
    return st.fixed_dictionaries({**tag, **needed}, optional=free)


def _fits(number: float, kind: inspect.FloatType) -> bool:
    return (
        (kind.ge is None or number >= kind.ge)
        and (kind.le is None or number <= kind.le)
        and (kind.gt is None or number > kind.gt)
        and (kind.lt is None or number < kind.lt)
    )


def _fits_text(text: str, kind: inspect.StrType) -> bool:
    low, high = kind.min_length or 0, kind.max_length or 100_000
    return low <= len(text) <= high and (
        kind.pattern is None or re.search(kind.pattern, text) is not None
    )

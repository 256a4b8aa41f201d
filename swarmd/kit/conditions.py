"""Conditions: what they are, as a file or a command line says them. Pure, and quick to import.

What they mean at a time is decided by `swarmd.kit.condition_state`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from swarmd.core.errors import ConfigError, unknown
from swarmd.kit.diagnostics import Faults, Keys

Scalar: TypeAlias = bool | int | float | str
MAX_SECONDS = 1e7


@dataclass(frozen=True, slots=True)
class Timeout:
    """So many seconds have passed."""

    seconds: float

    def __str__(self) -> str:
        return f"{self.seconds:g} s have passed"


@dataclass(frozen=True, slots=True)
class Done:
    """The part has said that it is done; without a name, the pattern itself."""

    part: str = ""

    def __str__(self) -> str:
        return f"{self.part or 'the pattern'} is done"


@dataclass(frozen=True, slots=True)
class Settled:
    """What is reported under a key has not changed for so many seconds."""

    report: str
    seconds: float

    def __str__(self) -> str:
        return f"{self.report} settled for {self.seconds:g} s"


@dataclass(frozen=True, slots=True)
class Nearer:
    """The range sensor sees something nearer than so many metres."""

    distance: float

    def __str__(self) -> str:
        return f"something is nearer than {self.distance:g} m"


@dataclass(frozen=True, slots=True)
class Compared:
    """What is reported under a key, or a reading, is a value, above one or below one."""

    name: str
    relation: str
    value: Scalar
    is_reading: bool = False

    def __str__(self) -> str:
        what = f"reading {self.name}" if self.is_reading else self.name
        between = "is" if self.relation == "is" else f"is {self.relation}"
        return f"{what} {between} {self.value}"


@dataclass(frozen=True, slots=True)
class AnyOf:
    """One of them at least."""

    conditions: tuple[Condition, ...]

    def __str__(self) -> str:
        return " or ".join(map(str, self.conditions))


@dataclass(frozen=True, slots=True)
class AllOf:
    """All of them at once."""

    conditions: tuple[Condition, ...]

    def __str__(self) -> str:
        return " and ".join(map(str, self.conditions))


@dataclass(frozen=True, slots=True)
class Not:
    """The opposite."""

    condition: Condition

    def __str__(self) -> str:
        return f"not: {self.condition}"


Condition: TypeAlias = Timeout | Done | Settled | Nearer | Compared | AnyOf | AllOf | Not

_KINDS = ("timeout", "done", "settled", "nearer", "report", "reading", "any", "all", "not")
_BESIDES = {"settled": ("for",), "report": ("is", "above", "below"), "reading": ("above", "below")}
_TEXTS = ("timeout:SECONDS", "done", "settled:REPORT:SECONDS", "nearer:METRES", "report:KEY=VALUE")


def read_condition(data: object, keys: Keys, faults: Faults) -> Condition | None:
    """The condition of a file; None if it cannot be, with the faults noted."""
    if not isinstance(data, Mapping):
        faults.add(keys, f"is {data!r}; wanted a condition, such as {{timeout: 20}}")
        return None
    given = [kind for kind in _KINDS if kind in data]
    if len(given) != 1:
        said = " and ".join(given) or "nothing"
        wanted = "one of " + ", ".join(_KINDS)
        if len(given) > 1:
            wanted = "one; put them under any: [...] or all: [...]"
        faults.add(keys, f"says {said}; wanted {wanted}")
        return None
    kind = given[0]
    known = (kind, *_BESIDES.get(kind, ()))
    if not faults.only(data, known, keys):
        return None
    if kind in ("any", "all"):
        return _several(kind, data[kind], (*keys, kind), faults)
    if kind == "not":
        inner = read_condition(data[kind], (*keys, kind), faults)
        return None if inner is None else Not(inner)
    return _simple(kind, data, keys, faults)


def _several(kind: str, data: object, keys: Keys, faults: Faults) -> Condition | None:
    if not isinstance(data, list) or not data:
        faults.add(keys, "is empty; wanted a list of conditions")
        return None
    read = [read_condition(one, (*keys, index), faults) for index, one in enumerate(data)]
    whole = tuple(one for one in read if one is not None)
    if len(whole) < len(read):
        return None
    return AnyOf(whole) if kind == "any" else AllOf(whole)


def _simple(kind: str, data: Mapping[str, Any], keys: Keys, faults: Faults) -> Condition | None:
    if kind == "timeout":
        seconds = faults.number(data, kind, keys, low=0.0, high=MAX_SECONDS, unit="s")
        return None if seconds is None else Timeout(seconds)
    if kind == "nearer":
        distance = faults.number(data, kind, keys, low=0.0, high=1000.0, unit="m")
        return None if distance is None else Nearer(distance)
    name = faults.text(data, kind, keys, "the name of a part" if kind == "done" else "PART.KEY")
    if name is None:
        return None
    if kind == "done":
        return Done(name)
    if kind == "settled":
        seconds = faults.number(data, "for", keys, low=0.0, high=MAX_SECONDS, unit="s")
        return None if seconds is None else Settled(name, seconds)
    return _comparison(kind, name, data, keys, faults)


def _comparison(
    kind: str, name: str, data: Mapping[str, Any], keys: Keys, faults: Faults
) -> Condition | None:
    relations = [relation for relation in _BESIDES[kind] if relation in data]
    if len(relations) != 1:
        said = " and ".join(relations) or "not what it is to be"
        faults.add(keys, f"says {said}; wanted one of {', '.join(_BESIDES[kind])}")
        return None
    relation, value = relations[0], data[relations[0]]
    if relation == "is" and isinstance(value, bool | int | float | str):
        return Compared(name, relation, value)
    if relation == "is":
        faults.add((*keys, relation), f"is {value!r}; wanted a number, text, true or false")
        return None
    bound = faults.number(data, relation, keys, low=-1e9, high=1e9)
    return None if bound is None else Compared(name, relation, bound, kind == "reading")


def parse_condition(text: str) -> Condition:
    """The condition of a command line: `settled:opinion:5`; ConfigError if there is none such."""
    kind, _, rest = text.partition(":")
    if kind == "done" and not rest:
        return Done()
    if kind in ("timeout", "nearer"):
        value = _number(text, rest)
        return Timeout(value) if kind == "timeout" else Nearer(value)
    if kind == "settled":
        name, _, seconds = rest.rpartition(":")
        if name:
            return Settled(name, _number(text, seconds))
    if kind == "report":
        name, sign, value_text = rest.partition("=")
        if name and sign:
            return Compared(name, "is", _scalar(value_text))
    kinds = [form.partition(":")[0] for form in _TEXTS]
    fault = f"condition {text!r}" if kind in kinds else unknown("condition", kind, kinds)
    raise ConfigError(f"{fault}; wanted one of {', '.join(_TEXTS)}")


def parse_conditions(texts: object) -> Condition:
    """Any of several, as they come over the network; ConfigError if they are no such thing."""
    if not isinstance(texts, list | tuple) or not 1 <= len(texts) <= 16:
        raise ConfigError(f"until is {str(texts)[:60]!r}; wanted a list of 1 to 16 conditions")
    if any(not isinstance(text, str) or len(text) > 200 for text in texts):
        raise ConfigError("until holds what is no condition; wanted text")
    found = tuple(parse_condition(text) for text in texts)
    return found[0] if len(found) == 1 else AnyOf(found)


def leaves(condition: Condition) -> Iterator[Condition]:
    """The conditions that a condition is made of; itself if it is a simple one."""
    if isinstance(condition, AnyOf | AllOf):
        for inner in condition.conditions:
            yield from leaves(inner)
    elif isinstance(condition, Not):
        yield from leaves(condition.condition)
    else:
        yield condition


def needs_of(condition: Condition) -> frozenset[str]:
    """What a robot must sense for it."""
    found = set()
    for leaf in leaves(condition):
        if isinstance(leaf, Nearer):
            found.add("scan")
        elif isinstance(leaf, Compared) and leaf.is_reading:
            found.add(f"reading:{leaf.name}")
    return frozenset(found)


def _number(text: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= MAX_SECONDS:
        raise ConfigError(f"condition {text!r}: {word!r} is no number above 0; wanted such as 5")
    return value


def _scalar(word: str) -> Scalar:
    if word in ("true", "false"):
        return word == "true"
    for kind in (int, float):
        try:
            value = kind(word)
        except ValueError:
            continue
        if math.isfinite(value):
            return value
    return word

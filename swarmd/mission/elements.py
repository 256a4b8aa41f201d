"""The elements of a mission: a part, a sequence, a parallel, a switch; as they are written."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

from swarmd.errors import unknown
from swarmd.mission.conditions import (
    Compared,
    Condition,
    Done,
    Settled,
    leaves,
    read_condition,
)
from swarmd.mission.faults import Faults, Keys

Then: TypeAlias = Literal["end", "stay", "repeat"]
NOBODY = "nobody"
_KINDS = ("part", "sequence", "parallel", "switch")
_THEN = ("end", "stay", "repeat")
_BESIDES = {"sequence": ("then",), "parallel": ("drives",)}


@dataclass(frozen=True, slots=True)
class Run:
    """One part alone; it drives."""

    name: str
    until: Condition | None
    keys: Keys
    part: str


@dataclass(frozen=True, slots=True)
class Sequence:
    """One after the other; `then`: what follows the last."""

    name: str
    until: Condition | None
    keys: Keys
    steps: tuple[Element, ...]
    then: Then


@dataclass(frozen=True, slots=True)
class Parallel:
    """All at once; the one of index `driver` drives, None: nobody."""

    name: str
    until: Condition | None
    keys: Keys
    items: tuple[Element, ...]
    driver: int | None


@dataclass(frozen=True, slots=True)
class Switch:
    """The first whose condition holds; one without a condition otherwise."""

    name: str
    until: Condition | None
    keys: Keys
    branches: tuple[tuple[Condition | None, Element], ...]


Element: TypeAlias = Run | Sequence | Parallel | Switch


class _Place(NamedTuple):
    """What every kind of element is read from, its head read already."""

    name: str
    until: Condition | None
    keys: Keys
    data: Mapping[str, Any]
    parts: Collection[str]
    faults: Faults


def read_element(
    data: object, keys: Keys, parts: Collection[str], faults: Faults, *, in_switch: bool = False
) -> Element | None:
    """The element of a file; None if it cannot be, with the faults noted."""
    if isinstance(data, str):
        data = {"part": data}
    if not isinstance(data, Mapping):
        faults.add(keys, f"is {data!r}; wanted a part's name, or {', '.join(_KINDS)}")
        return None
    given = [kind for kind in _KINDS if kind in data]
    if len(given) != 1:
        said = " and ".join(given) or "nothing to do"
        faults.add(keys, f"says {said}; wanted one of {', '.join(_KINDS)}")
        return None
    kind = given[0]
    known = (kind, *_BESIDES.get(kind, ()), "name", "until", *(["when"] if in_switch else []))
    is_clean = faults.only(data, known, keys)
    name, until = "", None
    if "name" in data:
        name = faults.text(data, "name", keys, "text") or ""
    if "until" in data:
        until = _condition(data["until"], (*keys, "until"), parts, faults)
        is_clean &= until is not None
    readers = {"part": _run, "sequence": _sequence, "parallel": _parallel, "switch": _switch}
    element = readers[kind](_Place(name, until, keys, data, parts, faults))
    return element if is_clean else None


def _run(at: _Place) -> Element | None:
    name, until, keys, data, parts, faults = at
    part = faults.text(data, "part", keys, "a part's name")
    if part is None:
        return None
    if part not in parts:
        faults.part(keys, part, parts)
        return None
    return Run(name or part, until, keys, part)


def _sequence(at: _Place) -> Element | None:
    name, until, keys, data, parts, faults = at
    steps = _elements("sequence", keys, data, parts, faults)
    then = data.get("then")
    if then not in _THEN:
        said = "is missing" if "then" not in data else f"is {then!r}"
        faults.add((*keys, "then"), f"{said}; wanted one of {', '.join(_THEN)}")
    if steps is None:
        return None
    for step in steps[:-1]:
        if not can_end(step):
            faults.add(step.keys, "never ends, and more steps follow; give it an until")
    last = steps[-1]
    if then == "stay" and last.until is not None:
        text = "is the until of the last step, and then is stay; leave it out, or take end"
        faults.add((*last.keys, "until"), text)
    if then in ("end", "repeat") and not can_end(last):
        faults.add(last.keys, f"never ends, and then is {then}; give it an until, or take stay")
    if then not in _THEN:
        return None
    return Sequence(name, until, keys, steps, then)


def _parallel(at: _Place) -> Element | None:
    name, until, keys, data, parts, faults = at
    items = _elements("parallel", keys, data, parts, faults)
    drives = data.get("drives")
    if not isinstance(drives, str):
        said = "is missing" if "drives" not in data else f"is {drives!r}"
        faults.add((*keys, "drives"), f"{said}; wanted the part that drives, or {NOBODY}")
    if items is None or not isinstance(drives, str):
        return None
    names = [item.name for item in items]
    used = [part for item in items for part in set(uses_of(item))]
    for part in sorted({part for part in used if used.count(part) > 1}):
        faults.add(keys, f"steps part {part} twice at once; name it once, or make two parts")
    if drives != NOBODY and drives not in names:
        known = [one for one in names if one]
        faults.add((*keys, "drives"), f"{unknown('item', drives, known)} (or {NOBODY})")
        return None
    if names.count(drives) > 1:
        faults.add((*keys, "drives"), f"{drives} is the name of two; give each a name of its own")
    return Parallel(name, until, keys, items, None if drives == NOBODY else names.index(drives))


def _switch(at: _Place) -> Element | None:
    name, until, keys, data, parts, faults = at
    rows = _list("switch", keys, data, faults)
    branches: list[tuple[Condition | None, Element]] = []
    for index, row in enumerate(rows or ()):
        place: Keys = (*keys, "switch", index)
        element = read_element(row, place, parts, faults, in_switch=True)
        when = None
        if isinstance(row, Mapping) and "when" in row:
            when = _condition(row["when"], (*place, "when"), parts, faults)
        elif rows is not None and index < len(rows) - 1:
            faults.add((*place, "when"), "is missing; only the last may go without a condition")
        if element is not None:
            branches.append((when, element))
    return None if rows is None else Switch(name, until, keys, tuple(branches))


def _condition(
    data: object, keys: Keys, parts: Collection[str], faults: Faults
) -> Condition | None:
    condition = read_condition(data, keys, faults)
    if condition is not None:
        check_references(condition, keys, parts, faults)
    return condition


def _list(kind: str, keys: Keys, data: Mapping[str, Any], faults: Faults) -> list[Any] | None:
    rows = data[kind]
    if isinstance(rows, list) and rows:
        return rows
    faults.add((*keys, kind), f"is {rows!r}; wanted a list")
    return None


def _elements(
    kind: str, keys: Keys, data: Mapping[str, Any], parts: Collection[str], faults: Faults
) -> tuple[Element, ...] | None:
    rows = _list(kind, keys, data, faults)
    if rows is None:
        return None
    read = [read_element(row, (*keys, kind, i), parts, faults) for i, row in enumerate(rows)]
    whole = tuple(one for one in read if one is not None)
    return whole if len(whole) == len(rows) else None


def can_end(element: Element) -> bool:
    """Whether it is certain that it may end: by a condition, or since all in it may."""
    if element.until is not None:
        return True
    if isinstance(element, Sequence):
        return element.then == "end"
    return isinstance(element, Parallel) and all(map(can_end, element.items))


def uses_of(element: Element) -> Iterator[str]:
    """The parts that it steps."""
    if isinstance(element, Run):
        yield element.part
    for inner in inner_of(element):
        yield from uses_of(inner)


def drivers_of(element: Element) -> Iterator[str]:
    """The parts that may drive."""
    if isinstance(element, Run):
        yield element.part
    elif isinstance(element, Parallel):
        if element.driver is not None:
            yield from drivers_of(element.items[element.driver])
    else:
        for inner in inner_of(element):
            yield from drivers_of(inner)


def inner_of(element: Element) -> tuple[Element, ...]:
    """The elements in it."""
    if isinstance(element, Sequence):
        return element.steps
    if isinstance(element, Parallel):
        return element.items
    return tuple(e for _, e in element.branches) if isinstance(element, Switch) else ()


def conditions_of(element: Element) -> Iterator[tuple[Keys, Condition]]:
    """All conditions in it, and where they stand."""
    if element.until is not None:
        yield (*element.keys, "until"), element.until
    if isinstance(element, Switch):
        for when, inner in element.branches:
            if when is not None:
                yield (*inner.keys, "when"), when
    for inner in inner_of(element):
        yield from conditions_of(inner)


def check_references(
    condition: Condition, keys: Keys, parts: Collection[str], faults: Faults
) -> None:
    """Note parts that are not there."""
    for leaf in leaves(condition):
        if isinstance(leaf, Done):
            if leaf.part not in parts:
                faults.part(keys, leaf.part, parts)
        elif isinstance(leaf, Settled) or (isinstance(leaf, Compared) and not leaf.is_reading):
            name = leaf.report if isinstance(leaf, Settled) else leaf.name
            part, dot, _ = name.partition(".")
            if not dot:
                faults.add(keys, f"{name!r} is no PART.KEY; wanted such as {part}.state")
            elif part not in parts:
                faults.part(keys, part, parts)

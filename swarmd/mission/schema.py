"""Where in a file something stands, for messages of one line.

The elements of a mission: a part, a sequence, a parallel, a switch; as they are written.

What stands in a mission's file, read as a whole: everything that is wrong with its shape.

What needs the patterns themselves, such as their parameters, is checked by
`swarmd.mission.validate`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import yaml

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import is_id
from swarmd.kit.conditions import (
    Compared,
    Condition,
    Done,
    Scalar,
    Settled,
    leaves,
    read_condition,
)
from swarmd.kit.diagnostics import Faults, Keys
from swarmd.settings.layered import dotted
from swarmd.settings.yamlfile import read, shown


def told(path: Path, faults: Iterable[tuple[Keys, str]]) -> list[str]:
    """A line for each fault: file, line, key, what is wrong; in the order of the file."""
    lines = _lines(path)
    rows = [
        (_line(lines, keys), f"{dotted(keys)}: {text}".removeprefix(": ")) for keys, text in faults
    ]
    return [f"{shown(path)}:{line}: {text}" for line, text in sorted(rows, key=lambda row: row[0])]


def refusal(path: Path, faults: Iterable[tuple[Keys, str]]) -> ConfigError:
    """The error for the first of the faults; it says how many more there are."""
    first, *more = told(path, faults)
    rest = f" (and {len(more)} more; swarmctl mission check shows all)" if more else ""
    return ConfigError(first + rest)


def _line(lines: Mapping[Keys, int], keys: Keys) -> int:
    """The line of the key, or of the nearest that is there above it."""
    return next((lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in lines), 1)


def _lines(path: Path) -> Mapping[Keys, int]:
    found: dict[Keys, int] = {}

    def walk(node: yaml.Node | None, keys: Keys) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                place = (*keys, str(key.value))
                found[place] = key.start_mark.line + 1
                walk(value, place)
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                found[(*keys, index)] = value.start_mark.line + 1
                walk(value, (*keys, index))

    try:
        walk(yaml.compose(path.read_bytes(), Loader=yaml.SafeLoader), ())
    except (OSError, yaml.YAMLError, ValueError, RecursionError):
        return {}  # it has changed since it was read
    return found


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


_OWN = ("mission", "parts", "map", "report", "parameters", "recovery")
_OF_PART = ("pattern", "params", "private")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RECOVERY = (
    "is of recovery, which a mission has as a whole: set it beside parts, or with -p recovery="
)
_OF_MAP = ("from", "to", "values", "base", "step", "count")
Table: TypeAlias = Mapping[Scalar, Scalar]


@dataclass(frozen=True, slots=True)
class PartSpec:
    """A part: which pattern, with which parameters, and whether its channels are its own."""

    name: str
    pattern: str
    params: Mapping[str, Scalar | None]
    is_private: bool
    keys: Keys


@dataclass(frozen=True, slots=True)
class MapSpec:
    """From what a part reports to a parameter of another.

    `table` by reported value; None: `base` + `step` times the reported number, for as many as the
    part has opinions.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    table: Table | None
    base: float
    step: float
    keys: Keys


@dataclass(slots=True)
class Document:
    """A mission as it is written. `root` None and parts left out where there are `faults`.

    `names` are those of all parts, also of those left out.
    """

    path: Path
    description: str = ""
    parts: dict[str, PartSpec] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    maps: list[MapSpec] = field(default_factory=list)
    report: dict[str, tuple[str, str]] = field(default_factory=dict)
    parameters: dict[str, tuple[str, str]] = field(default_factory=dict)
    recovery: bool | None = None
    root: Element | None = None
    faults: Faults = field(default_factory=Faults)


def read_document(path: Path) -> Document:
    """The mission of a file, with its faults; ConfigError if it is not YAML at all."""
    data = read(path)
    document = Document(path)
    faults = document.faults
    text = faults.text(data, "mission", (), "a line that says what the mission does")
    document.description = text or ""
    _read_parts(data, document)
    element = {key: value for key, value in data.items() if key not in _OWN}
    document.root = read_element(element, (), document.names, faults)
    _read_maps(data, document)
    for name in ("report", "parameters"):
        _read_references(data, name, document)
    if "recovery" in data:
        if isinstance(data["recovery"], bool):
            document.recovery = data["recovery"]
        else:
            faults.add(("recovery",), f"is {data['recovery']!r}; wanted true or false")
    _check_uses(document)
    return document


def _read_parts(data: Mapping[str, Any], document: Document) -> None:
    faults, parts = document.faults, data.get("parts")
    if not isinstance(parts, dict) or not parts:
        said = "is missing" if parts is None else f"is {parts!r}"
        faults.add(("parts",), f"{said}; wanted parts by name, such as move: {{pattern: NAME}}")
        return
    document.names = list(parts)
    for name, section in parts.items():
        keys: Keys = ("parts", name)
        if not is_id(name) or name in ("nobody", "phase"):
            faults.add(keys, "is no name for a part; wanted letters, digits and _, and not nobody")
        elif not isinstance(section, dict):
            faults.add(keys, f"is {section!r}; wanted {{pattern: NAME}}")
        else:
            faults.only(section, _OF_PART, keys)
            pattern = faults.text(section, "pattern", keys, "a pattern's name")
            params, is_private = section.get("params") or {}, section.get("private", False)
            if not isinstance(params, dict) or not all(map(_is_plain, params.values())):
                faults.add((*keys, "params"), "holds more than values by name")
            elif not isinstance(is_private, bool):
                faults.add((*keys, "private"), f"is {is_private!r}; wanted true or false")
            elif pattern is not None:
                document.parts[name] = PartSpec(name, pattern, params, is_private, keys)


def _read_maps(data: Mapping[str, Any], document: Document) -> None:
    maps, faults = data.get("map", []), document.faults
    if not isinstance(maps, list):
        faults.add(("map",), f"is {maps!r}; wanted a list of {{from: ..., to: ..., values: ...}}")
        return
    targets: set[tuple[str, str]] = set()
    for index, section in enumerate(maps):
        spec = _map(section, ("map", index), document)
        if spec is None:
            continue
        if spec.target in targets:
            faults.add((*spec.keys, "to"), f"{'.'.join(spec.target)} is mapped twice; keep one")
        targets.add(spec.target)
        document.maps.append(spec)


def _map(section: object, keys: Keys, document: Document) -> MapSpec | None:
    faults = document.faults
    if not isinstance(section, dict):
        faults.add(keys, f"is {section!r}; wanted {{from: PART.KEY, to: PART.PARAMETER, ...}}")
        return None
    faults.only(section, _OF_MAP, keys)
    source = _reference(section, "from", keys, document, "PART.KEY, of what it reports")
    target = _reference(section, "to", keys, document, "PART.PARAMETER")
    table = _table(section, keys, faults)
    if source is None or target is None or table is None:
        return None
    if target[1] == "recovery":
        faults.add((*keys, "to"), _RECOVERY)
    if source[0] == target[0]:
        faults.add((*keys, "to"), f"is of {source[0]} itself; wanted another part")
        return None
    values, base, step = table
    return MapSpec(source, target, values, base, step, keys)


def _table(
    section: Mapping[str, Any], keys: Keys, faults: Faults
) -> tuple[Table | None, float, float] | None:
    """The table by reported value, or None with base and step; None as a whole if it is wrong."""
    values = section.get("values")
    if ("values" in section) == ("base" in section):
        faults.add(keys, "wanted either values, or base and step")
        return None
    if values is None:
        base = faults.number(section, "base", keys, low=-1e9, high=1e9)
        step = faults.number(section, "step", keys, low=-1e9, high=1e9)
        if base is None or step is None:
            return None
        if "count" not in section:
            return None, base, step
        count = faults.number(section, "count", keys, low=0.0, high=1000.0)
        if count is not None and count != int(count):
            faults.add((*keys, "count"), f"is {count:g}; wanted a whole number")
        return None if count is None else ({k: base + step * k for k in range(int(count))}, 0, 0)
    if "step" in section or "count" in section:
        faults.add(keys, "step and count go with base, not with values")
    rows = dict(enumerate(values)) if isinstance(values, list) else values
    if not isinstance(rows, dict) or not rows or not all(map(_is_scalar, rows.values())):
        faults.add((*keys, "values"), "wanted a list by opinion, or values by reported text")
        return None
    return rows, 0.0, 0.0


def _read_references(data: Mapping[str, Any], name: str, document: Document) -> None:
    """`report` and `parameters`: names of the mission's own for what its parts have."""
    section, faults = data.get(name, {}), document.faults
    if not isinstance(section, dict):
        faults.add((name,), f"is {section!r}; wanted names, each with PART.KEY")
        return
    found: dict[str, tuple[str, str]] = getattr(document, name)
    for own in section:
        if not _NAME.fullmatch(own) or own in ("recovery", "phase"):
            faults.add((name, own), "is no name; wanted letters, digits and _, not recovery, phase")
            continue
        reference = _reference(section, own, (name,), document, "PART.KEY")
        if reference is not None:
            found[own] = reference
    if name == "parameters":
        _check_targets(document)


def _check_targets(document: Document) -> None:
    """Note parameters of parts that are set from two sides."""
    setters = {spec.target: "a map" for spec in document.maps}
    for own, reference in document.parameters.items():
        if reference[1] == "recovery":
            document.faults.add(("parameters", own), _RECOVERY)
        if reference in setters:
            text = f"{'.'.join(reference)} is what {setters[reference]} sets; keep one"
            document.faults.add(("parameters", own), text)
        setters.setdefault(reference, own)


def _reference(
    section: Mapping[str, Any], key: str, keys: Keys, document: Document, wanted: str
) -> tuple[str, str] | None:
    text = document.faults.text(section, key, keys, wanted)
    if text is None:
        return None
    part, dot, inner = text.partition(".")
    if not dot or not inner:
        document.faults.add((*keys, key), f"is {text!r}; wanted {wanted}")
    elif part not in document.names:
        document.faults.part((*keys, key), part, document.names)
    else:
        return part, inner
    return None


def _check_uses(document: Document) -> None:
    if document.root is None:
        return
    used = set(uses_of(document.root))
    for name, part in document.parts.items():
        if name not in used:
            document.faults.add(part.keys, "is never stepped; name it in a step, or leave it out")


def _is_scalar(value: object) -> bool:
    return isinstance(value, bool | int | float | str)


def _is_plain(value: object) -> bool:
    return value is None or _is_scalar(value)

"""What stands in a mission's file, read as a whole: everything that is wrong with its shape.

What needs the patterns themselves, such as their parameters, is checked by
`swarmd.mission.checking`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from swarmd.keys import is_id
from swarmd.mission.conditions import Scalar
from swarmd.mission.elements import Element, read_element, uses_of
from swarmd.mission.faults import Faults, Keys
from swarmd.settings.yamlfile import read

_OWN = ("mission", "parts", "map", "report", "parameters", "unstick")
_OF_PART = ("pattern", "params", "private")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_UNSTICK = "is of unstick, which a mission has as a whole: set it beside parts, or with -p unstick="
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
    unstick: bool | None = None
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
    if "unstick" in data:
        if isinstance(data["unstick"], bool):
            document.unstick = data["unstick"]
        else:
            faults.add(("unstick",), f"is {data['unstick']!r}; wanted true or false")
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
    if target[1] == "unstick":
        faults.add((*keys, "to"), _UNSTICK)
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
        if not _NAME.fullmatch(own) or own in ("unstick", "phase"):
            faults.add((name, own), "is no name; wanted letters, digits and _, not unstick, phase")
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
        if reference[1] == "unstick":
            document.faults.add(("parameters", own), _UNSTICK)
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

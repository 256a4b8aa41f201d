"""Reads the file of a mission into a `Document`, and lists the faults of the file by line."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.mission.document_checks import (
    check_names,
    check_value,
    check_whole,
    is_part_name,
    valid_names,
)
from swarmd.mission.schema import KINDS, Element, Map, MissionFile, Part, Reference
from swarmd.settings.layered import Fault, Keys, read
from swarmd.settings.yamlfile import key_lines, shown
from swarmd.settings.yamlfile import read as read_yaml


@dataclass(slots=True)
class Document:
    """The valid contents of a mission's file; `faults` lists the invalid contents."""

    path: Path
    description: str
    parts: dict[str, Part]
    names: Collection[str]  # of all parts, the faulty ones included
    maps: list[tuple[Keys, Map]]  # each with its place in the file
    report: Mapping[str, Reference]
    parameters: Mapping[str, Reference]
    recovery: bool | None
    root: Element | None  # None if any element is faulty
    faults: list[Fault] = field(default_factory=list)


def read_document(path: Path) -> Document:
    """Read the mission of a YAML file, and check all that can be checked without patterns.

    The faults are in `Document.faults`; ConfigError only if the file cannot be read as keys and
    values of YAML. `Document.root`, the outermost element, is None if an element has a fault.
    """
    data = read_yaml(path)
    # The keys of the mission itself; all other keys describe the root element.
    mission_keys = {key: data[key] for key in MissionFile.__struct_fields__ if key in data}
    root_keys = {key: value for key, value in data.items() if key not in mission_keys}
    part_names = list(data["parts"]) if isinstance(data.get("parts"), dict) else []
    maps: list[tuple[Keys, Map]] = []

    def check(value: Any, keys: Keys) -> Iterator[Fault]:
        """Called for each value of the file at the place `keys`; also gathers the valid maps."""
        value_faults = list(check_value(value, keys, part_names))
        if isinstance(value, Map) and not value_faults:
            maps.append((keys, value))
        yield from value_faults

    file, faults = read(mission_keys, MissionFile, check)
    report, report_faults = valid_names("report", file.report, part_names)
    parameters, parameter_faults = valid_names("parameters", file.parameters, part_names)
    expanded = _expanded(root_keys)  # with {part: NAME} in place of NAME alone
    root, root_faults = read(expanded, Element, check)
    root_faults += check_names(expanded, (), part_names)
    document = Document(
        path=path,
        description=file.mission,
        parts={name: part for name, part in file.parts.items() if is_part_name(name)},
        names=part_names,
        maps=maps,
        report=report,
        parameters=parameters,
        recovery=file.recovery,
        root=None if root_faults else root,
        faults=[*faults, *report_faults, *parameter_faults, *root_faults],
    )
    document.faults += check_whole(document, data)
    return document


def fault_lines(path: Path, faults: Iterable[Fault]) -> list[str]:
    """A line for each fault, in the order of the file: file, line, key, what is wrong."""
    lines = key_lines(path)
    rows = [
        (next((lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in lines), 1), text)
        for keys, text in faults
    ]
    ordered = sorted(rows, key=lambda row: row[0])
    return [f"{shown(path)}:{line}: {text}" for line, text in ordered]


def fault_error(path: Path, faults: Iterable[Fault]) -> ConfigError:
    """The error for the first fault, with the count of further faults."""
    first, *more = fault_lines(path, faults)
    rest = f" (and {len(more)} more; swarmctl mission check shows all)" if more else ""
    return ConfigError(first + rest)


def _expanded(element: Any) -> Any:
    """The data of an element, with `{part: NAME}` in place of each short form NAME."""
    if isinstance(element, str):
        return {"part": element}
    if not isinstance(element, dict):
        return element
    return {
        key: [_expanded(child) for child in value]
        if key in KINDS and isinstance(value, list)
        else value
        for key, value in element.items()
    }

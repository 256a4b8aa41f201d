"""Where in a file something stands, for messages of one line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml

from swarmd.errors import ConfigError
from swarmd.mission.faults import Keys
from swarmd.settings.layered import dotted
from swarmd.settings.yamlfile import shown


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

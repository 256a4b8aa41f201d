"""Overrides of single values of a scenario by dotted keys, such as `groups.tb3.count=5`."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from copy import deepcopy
from typing import Any

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import python_value, read_duration
from swarmd.settings.yamlfile import brief, read_value

SOURCE = "--set"
SWEEP_SOURCE = "--sweep"
DURATION = "duration"


def parse_override(text: str, source: str = SOURCE, form: str = "{}") -> tuple[str, Any]:
    """Key and value of `key=value`, the value read as YAML; ConfigError if malformed.

    The value `null`, or no text after the =, removes the key's value. The value of `duration` may
    have a unit, such as `3min`. `form`: the YAML to read, in which `{}` stands for the text of the
    value: with "[{}]" the text `1, 2` is the list [1, 2].
    """
    key, equals, value = text.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise ConfigError(f"{source} {text!r}: expected key=value")
    key = key.strip()
    try:
        data = read_value(form.format(value))
        if key == DURATION:
            data = [*map(_seconds, data)] if isinstance(data, list) else _seconds(data)
        return key, data
    except ConfigError as error:
        raise ConfigError(f"{source} {key}: {error}") from error


def _seconds(value: Any) -> Any:
    """The seconds of a text such as `3min`; any other value as given."""
    seconds = read_duration(value) if isinstance(value, str) else None
    return value if seconds is None else seconds


def nested(
    overrides: Mapping[str, Any], base: Mapping[str, Any], source: str = SOURCE
) -> dict[str, Any]:
    """The overrides by dotted key as nested mappings, in the form of a scenario's file.

    A number in a key is the index of a list's item: `events.0.at`. `base`: the file's data, from
    which a list is copied if one of its items is overridden. ConfigError, which begins with
    `source`, for a missing item or an unknown group.
    """
    over: dict[str, Any] = {}
    for key, value in overrides.items():
        keys = key.split(".")
        groups = base.get("groups")
        names = groups if isinstance(groups, Mapping) else {}
        if keys[0] == "groups" and len(keys) > 1 and keys[1] not in names:
            raise ConfigError(f"{source}: {key}: {unknown('group', keys[1], names)}")
        if keys[0] == "realism" and len(keys) > 1 and isinstance(base.get("realism"), str):
            over.setdefault("realism", {"preset": base["realism"]})
        try:
            _put(over, base, keys, python_value(value))
        except ConfigError as error:
            raise ConfigError(f"{source}: {key}: {error}") from error
    return over


def _put(over: Any, base: Any, keys: Sequence[str], value: Any) -> None:
    """Set the value at the path `keys` of `over`; `base`: the file's data at the same place."""
    head: str | int = keys[0]
    if isinstance(over, list):
        head = _index(over, keys[0])
    elif not isinstance(over, MutableMapping):
        raise ConfigError(f"there is {brief(over)}, which holds no {head!r}")
    if len(keys) == 1:
        over[head] = value
        return
    below = base.get(head) if isinstance(base, Mapping) else None
    if isinstance(over, MutableMapping) and over.get(head) is None:
        over[head] = deepcopy(below) if isinstance(below, list) else {}
    _put(over[head], below, keys[1:], value)


def _index(items: Sequence[Any], word: str) -> int:
    if word.isdecimal() and int(word) < len(items):
        return int(word)
    there = f"there are {len(items)}, from 0 on" if items else "there are none"
    raise ConfigError(f"no item {word!r}; {there}")

"""Patterns that a scenario names by a path: `pattern: mine/wall.py` in place of `pattern: wall`.

A path becomes the name of the pattern, and its folder the `plugin_dir` of the scenario. So the
complete configuration, a manifest and a daemon have names alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.core.files import user_path
from swarmd.plugins import PatternPlace, is_pattern_path, pattern_at
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.yamlfile import Data
from swarmd.sim.scenarios.environment import blamed

PLUGIN_DIR = "plugin_dir"
_BY_PATTERN = ("patterns", "parameters", "touch")
"""Mappings by pattern: their keys are names or paths."""

Source = tuple[str, Data]


def anchored(data: Data, folder: Path) -> Data:
    """The data with absolute paths of patterns, which were relative to `folder`."""
    return _replaced(data, lambda text: str(folder / user_path(text)))


def absolute(overrides: Mapping[str, Any], folder: Path = Path()) -> dict[str, Any]:
    """Overrides by dotted key, with absolute paths of patterns and of `plugin_dir`.

    `folder`: where relative paths begin.
    """
    return {
        key: str((folder / user_path(value)).absolute())
        if isinstance(value, str) and (key == PLUGIN_DIR or _is_path_at(key, value))
        else value
        for key, value in overrides.items()
    }


def check_names(data: Mapping[str, Any]) -> None:
    """ConfigError for the first pattern that data name by a path."""
    for keys, text in _named_in(data):
        if is_pattern_path(text):
            raise ConfigError(
                f"effective configuration: {_shown(keys)}: {text} is a path; expected the name of a"
                " pattern, whose file lies in plugin_dir"
            )


def _is_path_at(key: str, value: str) -> bool:
    """Whether a key names a pattern, and the value is a path."""
    return key.rpartition(".")[2] in ("pattern", "run") and is_pattern_path(value)


def named(sources: Sequence[Source]) -> tuple[Source, ...]:
    """The sources, strongest first, with a name in place of each path of a pattern.

    The folder of the paths becomes the `plugin_dir`, also in place of that of a weaker source.
    ConfigError blames the key if there is no pattern at a path, if paths lie in several folders,
    or if the `plugin_dir` of a source that is not weaker is another folder.
    """
    layers = Layered(*sources)
    places: dict[str, PatternPlace] = {}
    first = ""
    for keys, text in _named_in(layers.data):
        if not is_pattern_path(text):
            continue
        with blamed(layers, *keys, prefix=f"{_shown(keys)}: "):
            places[text] = pattern_at(text)
        first = first or text
        if places[text].folder != places[first].folder:
            fault = f"{first} and {text} lie in several folders; put them into one"
            raise layers.error(keys, f"{_shown(keys)}: {fault}")
        _check_folder(layers, sources, keys, text, places[text].folder)
    if not places:
        return tuple((name, _replaced(data, _name_of)) for name, data in sources)
    renamed = [
        (
            name,
            _replaced(data, lambda text: places[text].name if text in places else _name_of(text)),
        )
        for name, data in sources
    ]
    strongest, data = renamed[0]
    return ((strongest, {**data, PLUGIN_DIR: str(places[first].folder)}), *renamed[1:])


def with_one_pattern(data: Data, pattern: str, former: str) -> Data:
    """The data in which groups have no pattern, and events run `pattern` in place of `former`.

    Without the parameters of the groups and of these events, which were meant for `former`.
    """
    result = dict(data)
    groups = data.get("groups")
    if isinstance(groups, Mapping):
        result["groups"] = {
            name: _without(group, "pattern", "parameters") for name, group in groups.items()
        }
    events = data.get("events")
    if isinstance(events, list):
        result["events"] = [_with_run(event, pattern, former) for event in events]
    return result


def _without(section: Any, *keys: str) -> Any:
    if not isinstance(section, Mapping):
        return section
    return {key: value for key, value in section.items() if key not in keys}


def _with_run(event: Any, pattern: str, former: str) -> Any:
    run = event.get("run") if isinstance(event, Mapping) else None
    if not isinstance(run, str) or _name_of(run) != former:
        return event
    return {**_without(event, "parameters"), "run": pattern}


def _check_folder(
    layers: Layered, sources: Sequence[Source], keys: Keys, text: str, folder: Path
) -> None:
    """ConfigError if the `plugin_dir` of a source that is not weaker is not the path's folder."""
    given = layers.data.get(PLUGIN_DIR)
    if not isinstance(given, str) or user_path(given).absolute() == folder:
        return
    names = [name for name, _ in sources]
    owner = layers.source(*keys)
    setter = layers.source(PLUGIN_DIR)
    if owner is None or setter is None or names.index(setter) <= names.index(owner):
        same = user_path(given).resolve() == folder.resolve()
        if not same:
            fault = f"{text} does not lie in the plugin_dir, {given}; leave out one of the two"
            raise layers.error(keys, f"{_shown(keys)}: {fault}")


def _shown(keys: Keys) -> str:
    """A key as errors show it; the last key is left out if it is a path, which the text names."""
    last = keys[-1]
    return dotted(keys[:-1] if isinstance(last, str) and is_pattern_path(last) else keys)


def _name_of(text: str) -> str:
    """The name of a pattern in the text of a value that a stronger source replaces."""
    if not is_pattern_path(text):
        return text
    path = Path(text)
    return path.parent.name if path.name == "pattern.py" else path.stem


def _named_in(data: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
    """All names and paths of patterns in the data of a scenario, each with its keys."""
    for keys, holder, key in _holders(data):
        if key in holder and isinstance(holder[key], str):
            yield (*keys, key), holder[key]
    for keys, mapping in _mappings(data):
        for key in mapping:
            if isinstance(key, str):
                yield (*keys, key), key


def _holders(data: Mapping[str, Any]) -> Iterator[tuple[Keys, Mapping[str, Any], str]]:
    """The mappings that have the name of a pattern as a value: keys, mapping, key of the name."""
    yield (), data, "pattern"
    groups = data.get("groups")
    for name, group in groups.items() if isinstance(groups, Mapping) else ():
        if isinstance(group, Mapping):
            yield ("groups", name), group, "pattern"
    events = data.get("events")
    for index, event in enumerate(events) if isinstance(events, list) else ():
        if isinstance(event, Mapping):
            yield ("events", index), event, "run"
    battery = data.get("on_low_battery")
    if isinstance(battery, Mapping):
        yield ("on_low_battery",), battery, "pattern"


def _mappings(data: Mapping[str, Any]) -> Iterator[tuple[Keys, Mapping[str, Any]]]:
    """The mappings by pattern."""
    for key in _BY_PATTERN:
        if isinstance(data.get(key), Mapping):
            yield (key,), data[key]
    groups = data.get("groups")
    for name, group in groups.items() if isinstance(groups, Mapping) else ():
        if isinstance(group, Mapping) and isinstance(group.get("touch"), Mapping):
            yield ("groups", name, "touch"), group["touch"]


def _replaced(data: Mapping[str, Any], change: Callable[[str], str]) -> Data:
    """The data with each path of a pattern changed; what has no path is shared with `data`."""

    def changed(value: Any) -> Any:
        return change(value) if isinstance(value, str) and is_pattern_path(value) else value

    result: Data = dict(data)
    groups = data.get("groups")
    if isinstance(groups, Mapping):
        result["groups"] = {name: _of_group(group, changed) for name, group in groups.items()}
    events = data.get("events")
    if isinstance(events, list):
        result["events"] = [_with(event, "run", changed) for event in events]
    if "on_low_battery" in data:
        result["on_low_battery"] = _with(data["on_low_battery"], "pattern", changed)
    result = _with(result, "pattern", changed)
    return _by_pattern(result, _BY_PATTERN, changed)


def _of_group(group: Any, changed: Callable[[Any], Any]) -> Any:
    """The section of a group with changed paths."""
    if not isinstance(group, Mapping):
        return group
    return _by_pattern(_with(group, "pattern", changed), ("touch",), changed)


def _with(section: Any, key: str, changed: Callable[[Any], Any]) -> Any:
    """The section with the value of `key` changed; as it is without such a key."""
    if not isinstance(section, Mapping) or key not in section:
        return section
    return {**section, key: changed(section[key])}


def _by_pattern(section: Data, keys: Sequence[str], changed: Callable[[Any], Any]) -> Data:
    """The section with changed names of patterns in its mappings `keys`."""
    for key in keys:
        if isinstance(section.get(key), Mapping):
            by_name = {changed(name): value for name, value in section[key].items()}
            section = {**section, key: by_name}
    return section

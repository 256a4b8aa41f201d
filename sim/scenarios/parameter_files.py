"""YAML files that parameters of patterns name, such as the launch file of `ros2_nodes`.

Such a file chooses code. So it lies in the `plugin_dir` of its scenario, whose files are compared
before the runs of others are repeated (`experiments.trust`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.core.files import user_path
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.yamlfile import Data
from swarmd.sim.scenarios.pattern_paths import PLUGIN_DIR, Source

_SUFFIX = ".yaml"


def anchored(data: Data, folder: Path) -> Data:
    """The data with absolute paths of these files, which were relative to `folder`."""
    return _replaced(data, lambda text: str(folder / user_path(text)))


def placed(sources: Sequence[Source]) -> tuple[Source, ...]:
    """The sources, strongest first, with absolute paths of these files.

    The folder of the first file becomes the `plugin_dir` of data without one. ConfigError blames
    the key of a file that lies elsewhere.
    """
    absolute = tuple(
        (name, _replaced(data, lambda text: str(user_path(text).absolute())))
        for name, data in sources
    )
    layers = Layered(*absolute)
    named = list(_named_in(layers.data))
    if not named:
        return absolute
    given = layers.data.get(PLUGIN_DIR)
    folder = user_path(given).absolute() if isinstance(given, str) else Path(named[0][1]).parent
    for keys, text in named:
        if not _lies_in(text, folder):
            raise layers.error(keys, f"{dotted(keys)}: {_elsewhere(text, str(folder))}")
    if isinstance(given, str):
        return absolute
    strongest, data = absolute[0]
    return ((strongest, {**data, PLUGIN_DIR: str(folder)}), *absolute[1:])


def check_files(effective: Mapping[str, Any]) -> None:
    """ConfigError for a file of a complete configuration that does not lie in its `plugin_dir`."""
    given = effective.get(PLUGIN_DIR)
    for keys, text in _named_in(effective):
        folder = user_path(given).absolute() if isinstance(given, str) else None
        if folder is None or not _lies_in(text, folder):
            fault = _elsewhere(text, str(given))
            raise ConfigError(f"effective configuration: {dotted(keys)}: {fault}")


def _lies_in(text: str, folder: Path) -> bool:
    path = Path(text)
    is_below = path.is_relative_to(folder) and ".." not in path.parts
    return is_below or path.resolve().is_relative_to(folder.resolve())


def _elsewhere(text: str, folder: str) -> str:
    return f"{text} does not lie in the plugin_dir, {folder}; leave out one, or move the file there"


def _named_in(data: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
    """The files in the data of a scenario, each with its keys."""
    for keys, parameters in _parameters_in(data):
        for name, value in parameters.items():
            if _is_file(value):
                yield (*keys, name), value


def _parameters_in(data: Mapping[str, Any]) -> Iterator[tuple[Keys, Mapping[str, Any]]]:
    """The mappings of parameters: of groups, of patterns by their names, and of events."""
    for section in ("groups", "parameters"):
        items = data.get(section)
        for name, item in items.items() if isinstance(items, Mapping) else ():
            given = item.get("parameters") if section == "groups" and _is_map(item) else item
            keys = (section, name, "parameters") if section == "groups" else (section, name)
            if isinstance(given, Mapping):
                yield keys, given
    events = data.get("events")
    for index, event in enumerate(events) if isinstance(events, list) else ():
        for key in ("parameters", "param"):
            given = event.get(key) if isinstance(event, Mapping) else None
            if isinstance(given, Mapping):
                yield ("events", index, key), given


def _is_map(value: object) -> bool:
    return isinstance(value, Mapping)


def _is_file(value: object) -> bool:
    return isinstance(value, str) and value.endswith(_SUFFIX)


def _replaced(data: Mapping[str, Any], change: Callable[[str], str]) -> Data:
    """The data with each of these paths changed; the data themselves stay as they are."""

    def changed(value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {name: change(one) if _is_file(one) else one for name, one in value.items()}

    def within(section: Any, *keys: str) -> Any:
        if not isinstance(section, Mapping):
            return section
        return {name: changed(one) if name in keys else one for name, one in section.items()}

    result: Data = dict(data)
    groups = data.get("groups")
    if isinstance(groups, Mapping):
        result["groups"] = {name: within(one, "parameters") for name, one in groups.items()}
    by_pattern = data.get("parameters")
    if isinstance(by_pattern, Mapping):
        result["parameters"] = {name: changed(one) for name, one in by_pattern.items()}
    events = data.get("events")
    if isinstance(events, list):
        result["events"] = [within(one, "parameters", "param") for one in events]
    return result

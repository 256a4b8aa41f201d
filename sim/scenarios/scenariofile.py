"""Reads scenarios from files, with all checks that need no run.

Precedence: overrides replace values of the file, which replace values of the file that it extends.
`Scenario.effective` holds the complete result in plain values, with platforms, from which
`scenario_of` makes an equal scenario without files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from itertools import chain
from pathlib import Path
from typing import Any

from msgspec import json, structs

import swarmd.config
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import user_path
from swarmd.plugins import pattern_folders
from swarmd.settings.layered import Layered, fault_at
from swarmd.settings.robot_settings import RobotSettings
from swarmd.settings.yamlfile import Data, read_extended, shown
from swarmd.sim.scenarios import parameter_files, pattern_paths
from swarmd.sim.scenarios.environment import arena_of, blamed, fields_of
from swarmd.sim.scenarios.groups import Groups, groups_of, platform_name
from swarmd.sim.scenarios.overrides import SOURCE, nested
from swarmd.sim.scenarios.preflight import (
    check_compatibility,
    check_patterns,
    configured_parameters,
)
from swarmd.sim.scenarios.pseudo_reality import bounds_of
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.schedule import schedule_of
from swarmd.sim.scenarios.schema import ScenarioFile
from swarmd.sim.scenarios.start_poses import StartPoses, start_group_of, without_stale
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.radio import check_radio
from swarmd.sim.world.realism import realism_of

SCENARIO = "scenario.yaml"
"""Beside a pattern: the scenario that shows it, by the pattern's name."""
TASKS = "benchmark"
"""The folder of the benchmark suite below the project's scenarios."""


def scenario_names() -> tuple[str, ...]:
    """The scenarios that come with the project, and those of installed patterns."""
    return tuple(sorted({path.stem for path in _folder().glob("*.yaml")} | _of_patterns().keys()))


def task_names() -> tuple[str, ...]:
    """The scenarios of the benchmark suite, such as `benchmark/doorway`."""
    return tuple(sorted(f"{TASKS}/{path.stem}" for path in (_folder() / TASKS).glob("*.yaml")))


def load_scenario(
    name: str | Path, overrides: Mapping[str, Any] | None = None, *, source: str = SOURCE
) -> Scenario:
    """The scenario of a name, or of a file's path that ends in .yaml.

    `overrides`: values by dotted key of the file: {"groups.tb3.count": 5, "duration": 30}.
    ConfigError names the file (`source` for an override), the key, the value, the expected value
    and the nearest valid key.
    """
    path = _find(str(name), Path())
    stem = path.parent.name if path.name == SCENARIO else path.stem
    return _overridden(tuple(_chain(path)), overrides, stem, source)


def read_scenario(
    name: str | Path, overrides: Mapping[str, Any] | None = None, *, source: str = SOURCE
) -> ScenarioFile:
    """The keys of a scenario as its files and the overrides give them, each checked by itself.

    `name`, `overrides`, `source`: as of `load_scenario`, which also checks the keys together.
    """
    sources = tuple(_chain(_find(str(name), Path())))
    return _layers_of(sources, overrides, source).build(ScenarioFile)


def scenario_of(
    effective: Mapping[str, Any],
    overrides: Mapping[str, Any] | None = None,
    *,
    source: str = SOURCE,
) -> Scenario:
    """The scenario of a complete configuration, `Scenario.effective`, without files.

    `overrides`, `source`: as of `load_scenario`. ConfigError if the configuration has a path in
    place of a pattern's name, or a file of a parameter elsewhere: it may be of others, whose files
    are looked up in `plugin_dir` alone
    (`experiments.trust`).
    """
    pattern_paths.check_names(effective)
    parameter_files.check_files(effective)
    sources = (("effective configuration", dict(effective)),)
    return _overridden(sources, overrides, "scenario", source)


def _folder() -> Path:
    return Path(swarmd.config.__path__[0]).resolve() / "scenarios"


def _of_patterns() -> dict[str, Path]:
    """The scenarios of installed patterns by name; reads the metadata of all packages."""
    files = {name: folder.path / SCENARIO for name, folder in pattern_folders().items()}
    return {name: file for name, file in files.items() if file.is_file()}


def _find(name: str, near: Path) -> Path:
    if name.endswith(".yaml"):
        return near / user_path(name)
    if (file := _folder() / f"{name}.yaml").is_file():
        return file
    if name not in (of_patterns := _of_patterns()):
        known = unknown("scenario", name, (*scenario_names(), *task_names()))
        raise ConfigError(f"{known} (or give a path ending in .yaml)")
    return of_patterns[name]


def _chain(path: Path) -> Iterator[tuple[str, Data]]:
    """The data of a file and of the files that it extends, strongest first, with their paths."""
    for file, data in read_extended(path, _find):
        base = data.get("extends")
        if base is not None and not isinstance(base, str):
            raise ConfigError(f"{shown(file)}: extends is {base!r}; expected a scenario's name")
        rest = {key: value for key, value in data.items() if key != "extends"}
        yield shown(file), _anchored(rest, file.parent.absolute())


def _anchored(data: Data, folder: Path) -> Data:
    """The data with absolute paths, which were relative to `folder`."""
    # The mapping that has each path, and the key of the path.
    holders: list[tuple[Any, str]] = [(data, "plugin_dir")]
    for section, key in (("groups", "platform"), ("platforms", "extends")):
        items = data.get(section)
        holders += [(item, key) for item in (items.values() if isinstance(items, dict) else ())]
    with_fields = [data, *_dicts(data.get("events"))]
    fields = [field for holder in with_fields for field in _dicts(holder.get("fields"))]
    holders += [(patch, "image") for field in fields for patch in _dicts(field.get("patches"))]
    for holder, key in holders:
        value = holder.get(key) if isinstance(holder, dict) else None
        if isinstance(value, str) and (key in ("plugin_dir", "image") or value.endswith(".yaml")):
            holder[key] = str(folder / user_path(value))
    return parameter_files.anchored(pattern_paths.anchored(data, folder), folder)


def _dicts(items: Any) -> list[Data]:
    """The mappings of a list; none of anything else."""
    return [item for item in items if isinstance(item, dict)] if isinstance(items, list) else []


def _overridden(
    sources: tuple[tuple[str, Data], ...],
    overrides: Mapping[str, Any] | None,
    default_name: str,
    override_source: str,
) -> Scenario:
    """The checked scenario of the data of files, and of overrides.

    `sources`: name and data of each file, strongest first. `overrides`: values by dotted key.
    `default_name`: the name of a scenario whose data have no name. `override_source`: the source of
    a wrong override, with which the ConfigError begins.
    """
    layers = _layers_of(sources, overrides, override_source)
    file = layers.build(ScenarioFile)
    if file.pattern is not None:
        names = [name for name, _ in sources]
        source = layers.source("pattern")
        # Of an override, or of a file that extends others.
        first = names.index(source) + 1 if source in names else 0
        if first < len(sources):
            weaker = _with_one_pattern(layers, file, file.pattern, sources[first:])
            sources = (*sources[:first], *weaker)
            layers = _layers_of(sources, overrides, override_source)
            file = layers.build(ScenarioFile)
        pattern = str(file.pattern)
        owner = None if pattern in file.patterns else layers.source("pattern")
        sources = (_choice_of(layers, file, pattern, owner or sources[0][0]), *sources)
        layers = _layers_of(sources, overrides, override_source)
        file = layers.build(ScenarioFile)
    if file.extends is not None:  # of an override: `_chain` has taken the key out of files
        raise layers.error(("extends",), "extends is for files alone; leave it out here")
    # The world, the robots and the events, each checked against the parts before it.
    fields = fields_of(layers, file.fields)
    arena = arena_of(layers, file.arena, file.items, fields)
    with blamed(layers, "radio"):
        check_radio(file.radio)
    groups = groups_of(layers, file, fields)
    settings, notes = check_compatibility(layers, file, groups)
    _check_settings(layers, settings, groups)
    starts = _starts(layers, file, groups, arena)
    schedule = schedule_of(layers, file, groups)
    configured = configured_parameters(file, groups)
    plugin_dir = None if file.plugin_dir is None else user_path(file.plugin_dir).absolute()
    check_patterns(layers, file, schedule, groups, configured, plugin_dir)
    realism_source = str(layers.error(("realism",), "realism"))  # `<file>: realism`, for errors
    realism = realism_of(file.realism, realism_source)
    with blamed(layers, "pseudo_reality", prefix="pseudo_reality: "):
        pseudo_reality = bounds_of(file.pseudo_reality, realism, file.radio)
    name = file.name or default_name
    return Scenario(
        name=name,
        description=file.description,
        duration=file.duration,
        robots=groups.robots,
        groups=groups.groups,
        starts=starts,
        arena=arena,
        fields=fields,
        items=tuple(file.items),
        realism=realism,
        visibility=file.lidar_visibility,
        radio=file.radio,
        parameters=configured,
        settings={
            robot: structs.replace(settings, touch={**file.touch, **file.groups[group].touch})
            for robot, group in groups.group_of.items()
        },
        events=schedule.events,
        absent=schedule.absent,
        notes=notes,
        trace_rate=file.trace_rate,
        plugin_dir=plugin_dir,
        pseudo_reality=pseudo_reality,
        effective={
            **_plain(file, groups),
            "name": name,
            "pattern": None,  # the groups have it
            "fields": json.decode(json.encode(fields)),
            "plugin_dir": None if plugin_dir is None else str(plugin_dir),
        },
    )


def _layers_of(
    sources: tuple[tuple[str, Data], ...],
    overrides: Mapping[str, Any] | None,
    override_source: str,
) -> Layered:
    """The data of files (strongest first) and of overrides, which are stronger than the files.

    Keys of a section `start` that do not fit the layout of a stronger source are dropped
    (`without_stale`). ConfigError if there are no groups.
    """
    strongest_file, _ = sources[0]
    if overrides:
        data = Layered(*sources).data
        sources = ((override_source, nested(overrides, data, override_source)), *sources)
    sources = parameter_files.placed(pattern_paths.named(sources))
    layers = Layered(*without_stale(sources), home=strongest_file)
    if "groups" not in layers.data:
        wanted = "groups: {tb3: {platform: burger, count: 5}}"
        raise layers.error(("groups",), f"groups is missing; expected a value such as {wanted}")
    return layers


def _with_one_pattern(
    layers: Layered, file: ScenarioFile, pattern: str, sources: tuple[tuple[str, Data], ...]
) -> tuple[tuple[str, Data], ...]:
    """The files in which all groups are without a pattern, to run the `pattern` of an override.

    The files as they are if a group has none, or if they name choices of the pattern. ConfigError
    if the groups have several patterns.
    """
    former = {group.pattern for group in file.groups.values()}
    if None in former or file.patterns:
        return sources
    if len(former) > 1:
        names = ", ".join(f"{name} {group.pattern}" for name, group in file.groups.items())
        text = f"pattern: the groups run several ({names}); choose for each by groups.GROUP.pattern"
        raise layers.error(("pattern",), text)
    (only,) = former
    return tuple(
        (name, pattern_paths.with_one_pattern(data, pattern, str(only))) for name, data in sources
    )


def _choice_of(layers: Layered, file: ScenarioFile, pattern: str, source: str) -> tuple[str, Data]:
    """The layer, named `source`, by which the groups without a pattern run `pattern`.

    With the parameters of `file.patterns`. ConfigError if each group has a pattern.
    """
    idle = [name for name, group in file.groups.items() if group.pattern is None]
    if not idle:
        text = "groups: each group has a pattern of its own; leave out the key pattern"
        raise layers.error(("groups",), text)
    values: dict[str, Any] = {f"groups.{name}.pattern": pattern for name in idle}
    for key, value in file.patterns.get(pattern, {}).items():
        owner, _, name = key.rpartition(".")
        for group in [owner] if owner else idle:
            values[f"groups.{group}.parameters.{name}"] = value
    return source, nested(values, layers.data, f"{source}: patterns.{pattern}")


def _plain(file: ScenarioFile, groups: Groups) -> Data:
    """The file in plain values, which need no further file: platforms have their whole content."""
    plain: Data = json.decode(json.encode(file))
    for group in plain["groups"].values():
        group["platform"] = platform_name(group["platform"])
    return {**plain, "platforms": deepcopy(dict(groups.platform_files))}


def _check_settings(layers: Layered, settings: RobotSettings, groups: Groups) -> None:
    """ConfigError for the first fault of the robots' settings, also with one of their platforms."""
    platforms = {platform.name: platform for platform in groups.robots.values()}.values()
    misfits = (fault for platform in platforms for fault in settings.misfits(platform))
    for fault in chain(settings.faults(), misfits):
        raise layers.error(*fault_at(*fault))


def _starts(layers: Layered, file: ScenarioFile, groups: Groups, arena: Arena) -> StartPoses:
    rows = {robot: row for row, robot in enumerate(groups.robots)}
    parts = []
    shared = []
    for name, group in file.groups.items():
        own = [rows[robot] for robot in groups.groups[name]]
        if group.start is None:
            shared += own
        else:
            parts.append(start_group_of(layers, ("groups", name, "start"), group.start, own))
    if shared:
        parts.append(start_group_of(layers, ("start",), file.start, shared))
    footprints = [platform.footprint for platform in groups.robots.values()]
    starts = StartPoses(tuple(groups.robots), footprints, arena, parts)
    starts.check()
    return starts

"""The robots of a scenario by group, each with its platform."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from msgspec import json

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import check_id
from swarmd.core.values import Platform
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.platforms import (
    platform_file,
    platform_names,
    platform_of,
    platform_sources,
)
from swarmd.settings.yamlfile import Data
from swarmd.sim.scenarios.environment import blamed
from swarmd.sim.scenarios.schema import GroupSection, ScenarioFile
from swarmd.sim.world.item_kind import with_items
from swarmd.sim.world.radio import with_bearings
from swarmd.sim.world.scalar_fields import Field, with_readings

ALL = "all"


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """The robots of a scenario."""

    robots: Mapping[str, Platform]
    """By id, in the order of ids: the order in the file has no effect on a result."""
    groups: Mapping[str, tuple[str, ...]]
    """Ids by group."""
    group_of: Mapping[str, str]
    """Group by id."""
    platform_files: Mapping[str, Data]
    """The complete content of each platform's file, by name of the platform."""

    def named(self, target: str) -> tuple[str, ...]:
        """The robots of a group, a robot's id or `all`; empty if unknown."""
        if target == ALL:
            return tuple(self.robots)
        return self.groups.get(target) or ((target,) if target in self.robots else ())

    @property
    def names(self) -> tuple[str, ...]:
        """All names that `named` accepts."""
        return (ALL, *self.groups, *self.robots)


def groups_of(layers: Layered, file: ScenarioFile, fields: Sequence[Field]) -> Groups:
    """The robots of all groups; ConfigError for invalid ids, groups and platforms.

    The platform of a robot also has the sensors that the simulation adds (`_equipped`).
    """
    groups = {name: _ids(layers, name, group) for name, group in file.groups.items()}
    group_of = _group_of(layers, groups)
    platforms = _platforms(layers, file)
    equipped = {
        name: _equipped(platform, file, fields) for name, (platform, _) in platforms.items()
    }
    # In order of names, so that the order of the ids in the file has no effect on results.
    robots = {
        robot: equipped[platform_name(file.groups[group].platform)]
        for robot, group in sorted(group_of.items())
    }
    platform_files = {name: data for name, (_, data) in platforms.items()}
    return Groups(robots, groups, group_of, platform_files)


def _group_of(layers: Layered, groups: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
    """The group of each robot; ConfigError for invalid ids, and for a robot in two groups."""
    group_of: dict[str, str] = {}
    for name, ids in groups.items():
        for robot in ids:
            keys = ("groups", name)
            where = f"groups.{name}: robot {robot!r}"
            with blamed(layers, *keys):
                check_id(robot, f"groups.{name}: a robot's id")
            if robot in groups or robot == ALL:
                raise layers.error(keys, f"{where} has the name of a group; rename one")
            if robot in group_of:
                text = f"{where} is in group {group_of[robot]!r} already"
                raise layers.error(keys, f"{text}; name it once, or give another prefix")
            group_of[robot] = name
    if not groups:
        raise layers.error(("groups",), "groups is empty; expected one group of robots at least")
    if ALL in groups and len(groups) > 1:
        text = "groups.all does not hold all robots, which events call `all`; name it otherwise"
        raise layers.error(("groups", ALL), text)
    return group_of


def _equipped(platform: Platform, file: ScenarioFile, fields: Sequence[Field]) -> Platform:
    """The platform with the sensors that the simulation adds for radio, fields and items."""
    with_radio = replace(platform, provides=platform.provides | {"neighbors"})
    if file.radio.has_places:
        with_radio = with_bearings(with_radio)
    return with_items(with_readings(with_radio, fields), file.items)


def platform_name(text: str) -> str:
    """The name of a platform that a group gives by name or by path."""
    return Path(text).stem if text.endswith(".yaml") else text


def _ids(layers: Layered, name: str, group: GroupSection) -> tuple[str, ...]:
    keys = ("groups", name)
    with blamed(layers, *keys):
        check_id(name, "a group's name")
    if group.robots is None and group.count is None:
        raise layers.error(keys, f"groups.{name} has no robots; give count, or robots: [ids]")
    if group.robots is not None and group.count is not None:
        text = f"groups.{name} has both count and robots; keep one (null takes the other away)"
        raise layers.error((*keys, "count"), text)
    if group.robots == []:
        raise layers.error((*keys, "robots"), f"groups.{name}.robots is empty; name one")
    count = group.count or 0
    prefix = group.prefix or name
    digits = max(2, len(str(count)))
    numbered = (f"{prefix}-{number:0{digits}}" for number in range(1, count + 1))
    return tuple(group.robots or numbered)


def _platforms(layers: Layered, file: ScenarioFile) -> dict[str, tuple[Platform, Data]]:
    """The platforms of all groups by name, with their complete content."""
    wanted: dict[str, str] = {}
    for group, section in file.groups.items():
        name = platform_name(section.platform)
        keys = ("groups", group, "platform")
        known = (*platform_names(), *file.platforms)
        if name == section.platform and name not in known:
            raise layers.error(keys, f"{dotted(keys)}: {unknown('platform', name, known)}")
        if wanted.setdefault(name, section.platform) != section.platform:
            text = f"{dotted(keys)} is {section.platform}, but another group has {wanted[name]}"
            raise layers.error(keys, f"{text}; give one of the two another name")
    platforms = {name: _platform(layers, file, text) for name, text in wanted.items()}
    for name in file.platforms:
        if name not in platforms:
            _platform(layers, file, name)
    return platforms


def _platform(layers: Layered, file: ScenarioFile, wanted: str) -> tuple[Platform, Data]:
    name = platform_name(wanted)
    keys: Keys = ("platforms", name)
    sources: list[tuple[str, Data]] = []
    base: object = wanted
    if name in file.platforms:
        own = file.platforms[name]
        sources = [(str(layers.error(keys, dotted(keys))), own)]  # `<file>: platforms.<name>`
        base = own.get("extends", wanted)
    try:
        sources += platform_sources(base) if isinstance(base, str) else ()
    except ConfigError as error:
        if name not in file.platforms:
            group = next(g for g, section in file.groups.items() if section.platform == wanted)
            keys = ("groups", group, "platform")
        raise layers.error(keys, f"{dotted(keys)}: {error}") from error
    whole = Layered(*sources)
    platform = platform_of(name, whole)
    plain = json.decode(json.encode(platform_file(whole)))
    return platform, {**plain, "extends": None}

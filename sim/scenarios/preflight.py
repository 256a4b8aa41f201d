"""Loads every pattern of a scenario once, to find invalid parameters before a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from swarmd.core.errors import unknown
from swarmd.core.host_messages import REQUEST_LAYER, Layers, Load, LoadRefused
from swarmd.core.values import Value
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import Origin, check_single, pattern_names
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.sim.scenarios.environment import blamed
from swarmd.sim.scenarios.groups import Groups
from swarmd.sim.scenarios.schedule import Preflight, Schedule
from swarmd.sim.scenarios.schema import ScenarioFile

_WORD = 64  # the longest source that a status can name


def configured_parameters(file: ScenarioFile, groups: Groups) -> Callable[[str, str], Layers]:
    """The configured parameters of a robot and pattern, in layers by source, weakest first.

    Layers are "platform", "scenario" and "group <name>"; empty ones are left out.
    """

    def layers_of(robot: str, pattern: str) -> Layers:
        name = groups.group_of[robot]
        group = file.groups[name]
        layers: list[tuple[str, Mapping[str, Value]]] = [
            ("platform", groups.robots[robot].patterns.get(pattern, {})),
            ("scenario", {**file.parameters.get(pattern, {})}),
            (f"group {name}"[:_WORD], {**group.parameters} if group.pattern == pattern else {}),
        ]
        return tuple((source, values) for source, values in layers if values)

    return layers_of


def check_patterns(
    layers: Layered,
    file: ScenarioFile,
    schedule: Schedule,
    groups: Groups,
    configured: Callable[[str, str], Layers],
    plugin_dir: Path | None,
) -> None:
    """Raise ConfigError for the first pattern that is unknown or that a robot would refuse."""
    with blamed(layers, "plugin_dir"):
        origins = pattern_names(plugin_dir)
    for pattern in file.parameters:
        if pattern not in origins:
            text = f"parameters: {unknown('pattern', pattern, origins)}"
            raise layers.error(("parameters", pattern), text)
    for group, section in file.groups.items():
        for pattern in section.touch:
            _check_name(layers, ("groups", group, "touch", pattern), pattern, origins)
    executor = PatternExecutor(
        PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})
    )
    done: set[str] = set()
    for preflight in schedule.preflights:
        _check_name(layers, preflight.keys, preflight.pattern, origins)
        robot, pattern = preflight.robot, preflight.pattern
        parameters = (*configured(robot, pattern), (REQUEST_LAYER, {**preflight.parameters}))
        platform = groups.robots[robot]
        # Robots of one platform with the same parameters give the same result.
        what = repr((pattern, platform.name, parameters))
        if what in done:
            continue
        done.add(what)
        load = Load(
            generation=1, pattern=pattern, layers=parameters, robot=robot, platform=platform, seed=0
        )
        try:
            event = executor.handle(load)
        except SystemExit:  # it would end this process without a message
            event = LoadRefused(
                load.generation, f"{preflight.pattern} calls sys.exit; leave that out"
            )
        if isinstance(event, LoadRefused):
            keys = _faulty_keys(layers, preflight, groups, event.parameter)
            raise layers.error(keys, f"{dotted(keys)}: {event.text}")


def _faulty_keys(layers: Layered, preflight: Preflight, groups: Groups, name: str) -> Keys:
    """The keys that give the parameter `name`; without one, the keys that name the pattern."""
    places: tuple[Keys, ...] = (
        (*preflight.keys, name),
        (*preflight.keys[:-1], "parameters", name),
        ("groups", groups.group_of[preflight.robot], "parameters", name),
        ("parameters", preflight.pattern, name),
    )
    return next((keys for keys in places if layers.source(*keys)), preflight.keys)


def _check_name(layers: Layered, keys: Keys, pattern: str, origins: Mapping[str, Origin]) -> None:
    if pattern not in origins:
        text = f"{dotted(keys)}: {unknown('pattern', pattern, origins)}"
        raise layers.error(keys, text)
    with blamed(layers, *keys, prefix=f"{dotted(keys)}: "):
        check_single(pattern, origins[pattern])

"""Checks before a run: parameters of patterns, and compatibility of the robots' platforms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import cast

from msgspec.structs import replace

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.host_messages import REQUEST_LAYER, Load, LoadRefused
from swarmd.core.messages import PeerFinding
from swarmd.core.values import Platform
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import Origin, check_single, pattern_names, unknown_pattern
from swarmd.robot.protection.compatibility import Accepts, assumed_speed, body_of, findings
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.platforms import platform_names
from swarmd.settings.robot_settings import Parameters, PatternParameters, RobotSettings
from swarmd.sim.scenarios.environment import blamed
from swarmd.sim.scenarios.groups import Groups
from swarmd.sim.scenarios.schedule import Preflight, Schedule
from swarmd.sim.scenarios.schema import ScenarioFile

_WORD = 64  # characters of the longest source of parameters that a status can name


def configured_parameters(file: ScenarioFile, groups: Groups) -> Mapping[str, PatternParameters]:
    """By robot, the configured parameters of its patterns.

    The layers are "platform", "scenario" and "group <name>", weakest first.
    """
    of_groups = {
        name: (
            ("scenario", file.parameters),
            (f"group {name}"[:_WORD], {group.pattern: group.parameters} if group.pattern else {}),
        )
        for name, group in file.groups.items()
    }
    return {
        robot: PatternParameters(
            base=(("platform", cast("Parameters", groups.robots[robot].patterns)), *of_groups[name])
        )
        for robot, name in groups.group_of.items()
    }


def check_patterns(
    layers: Layered,
    file: ScenarioFile,
    schedule: Schedule,
    groups: Groups,
    configured: Mapping[str, PatternParameters],
    plugin_dir: Path | None,
) -> None:
    """Raise ConfigError for the first pattern that is unknown or that a robot would refuse.

    Loads each pattern of the schedule once for each platform and set of parameters. `configured`:
    see `configured_parameters`. `plugin_dir`: a folder of further patterns.
    """
    # 1. The names of patterns in the file.
    with blamed(layers, "plugin_dir"):
        origins = pattern_names(plugin_dir)
    for pattern in file.parameters:
        if pattern not in origins:
            text = f"parameters: {unknown_pattern(pattern, origins)}"
            raise layers.error(("parameters", pattern), text)
    for group, section in file.groups.items():
        for pattern in section.touch:  # `touch`: grants by pattern
            _check_name(layers, ("groups", group, "touch", pattern), pattern, origins)
    for pattern in file.touch:
        _check_name(layers, ("touch", pattern), pattern, origins)
    # 2. A trial for each pattern that a robot will run.
    executor = PatternExecutor(
        PatternLoader({name: (origin.value, origin.is_file) for name, origin in origins.items()})
    )
    tried: set[str] = set()
    for preflight in (*schedule.preflights, *_low_battery(file, groups)):
        _check_name(layers, preflight.keys, preflight.pattern, origins)
        robot = preflight.robot
        pattern = preflight.pattern
        own = configured[robot].layers(pattern, ())
        parameters = (*own, (REQUEST_LAYER, {**preflight.parameters}))
        platform = groups.robots[robot]
        # Robots of one platform with the same parameters give the same result. (Parameters may be
        # mappings, which a set cannot hold: their text stands for them.)
        trial = repr((pattern, platform.name, parameters))
        if trial in tried:
            continue
        tried.add(trial)
        load = Load(
            generation=1, pattern=pattern, layers=parameters, robot=robot, platform=platform, seed=0
        )
        refusal = _refusal_of_load(executor, load)
        if refusal is not None:
            keys = _faulty_keys(layers, preflight, groups, refusal.parameter)
            raise layers.error(keys, f"{dotted(keys)}: {refusal.text}")


def _refusal_of_load(executor: PatternExecutor, load: Load) -> LoadRefused | None:
    """Load a pattern as a robot does; returns the refusal of the robot, None without a refusal.

    A pattern that calls sys.exit is refused: here the call would end this process.
    """
    try:
        event = executor.handle(load)
    except SystemExit:
        return LoadRefused(load.generation, f"{load.pattern} calls sys.exit; leave that out")
    return event if isinstance(event, LoadRefused) else None


def _low_battery(file: ScenarioFile, groups: Groups) -> Iterator[Preflight]:
    """The pattern of `on_low_battery`, for each robot."""
    given = file.on_low_battery
    if given is not None and given.pattern is not None:
        keys = ("on_low_battery", "pattern")
        yield from (Preflight(keys, robot, given.pattern, given.params) for robot in groups.robots)


def _faulty_keys(layers: Layered, preflight: Preflight, groups: Groups, name: str) -> Keys:
    """The keys that give the parameter `name`; without one, the keys that name the pattern."""
    places: tuple[Keys, ...] = (
        (*preflight.keys, name),
        (*preflight.keys[:-1], "parameters", name),
        (*preflight.keys[:-1], "params", name),
        ("groups", groups.group_of[preflight.robot], "parameters", name),
        ("parameters", preflight.pattern, name),
    )
    return next((keys for keys in places if layers.source(*keys)), preflight.keys)


def _check_name(layers: Layered, keys: Keys, pattern: str, origins: Mapping[str, Origin]) -> None:
    if pattern not in origins:
        text = f"{dotted(keys)}: {unknown_pattern(pattern, origins)}"
        raise layers.error(keys, text)
    with blamed(layers, *keys, prefix=f"{dotted(keys)}: "):
        check_single(pattern, origins[pattern])


_REMEDIES = {
    "unseen": "set radio.range_and_bearing: true, by which robots tell where they are",
    "faster": "set one protection.barrier.others_speed under platforms",
}
_MOST_NAMED = 8
WHOLE_BODIES = "every lidar sees whole bodies here (lidar_visibility: body)"


def check_compatibility(
    layers: Layered, file: ScenarioFile, groups: Groups
) -> tuple[RobotSettings, tuple[str, ...]]:
    """The robots' settings, with all platforms that they accept as peers in spite of a finding.

    And notes on pairs of such platforms.

    Protection holds a robot at zero speed for two findings about a peer, unless the peer's platform
    is accepted: `unseen`, the robot's lidar does not detect the peer; `faster`, the peer is faster
    than the robot's protection assumes. A note is a line for a pair of platforms that is compatible
    only because of such an exception. ConfigError if protection would hold robots.
    """
    # 1. The exceptions of the file.
    settings = RobotSettings.of(file)
    names = dict.fromkeys(platform.name for platform in groups.robots.values())
    known = {*names, *file.platforms, *platform_names()}
    for key in ("accepts_unseen", "accepts_faster"):
        for name in getattr(settings, key):
            if name not in known:
                raise layers.error((key,), f"{key}: {unknown('platform', name, known)}")
    # 2. The exceptions of the simulation: lidars see whole bodies, or robots sense each other.
    has_whole_bodies = file.lidar_visibility == "body"
    if has_whole_bodies:
        settings = replace(settings, accepts_unseen=dict.fromkeys(names, WHOLE_BODIES))
    notes = []
    held = []
    # `platform`: the platform of the robot that reports the finding about a peer.
    for platform, finding in _pairs(groups.robots.values(), settings):
        is_faster = finding.kind == "faster"
        if not finding.holds:
            # The user knows from `lidar_visibility` that lidars see whole bodies: no note on that.
            if is_faster or not has_whole_bodies:
                notes.append(f"{platform}: {finding.text}")
        elif file.radio.has_places and not is_faster:
            told_by = "shared poses" if file.radio.places else "range and bearing"
            # Without the advice to accept the peer.
            notes.append(f"{platform}: {finding.text.partition(';')[0]}; told by {told_by}")
        else:
            held.append((platform, finding))
    if held:
        raise _refusal(layers, held)
    return settings, tuple(notes)


def _refusal(layers: Layered, held: Sequence[tuple[str, PeerFinding]]) -> ConfigError:
    """The error in one line: the pairs because of which robots would be held, and the remedies.

    `held`: the platform of the robots that would be held, and the finding, of each pair.
    """
    pairs = [f"{platform}: {finding.text.partition(';')[0]}" for platform, finding in held]
    if len(pairs) > _MOST_NAMED:
        pairs = [*pairs[:_MOST_NAMED], f"and {len(pairs) - _MOST_NAMED} more"]
    kinds = dict.fromkeys(finding.kind for _, finding in held)
    remedies = [f"see accepts_{kind}, or {_REMEDIES[kind]}" for kind in kinds]
    return layers.error((f"accepts_{held[0][1].kind}",), "; ".join((*pairs, *remedies)))


def _pairs(
    platforms: Iterable[Platform], settings: RobotSettings
) -> Iterator[tuple[str, PeerFinding]]:
    """The name of a platform, and a finding of its robots about a peer, for all pairs of robots."""
    accepts = Accepts.of(settings.accepts_unseen, settings.accepts_faster)
    robots = list(platforms)
    kinds = {platform.name: platform for platform in robots}
    counts = Counter(platform.name for platform in robots)
    for own, peer in product(kinds.values(), repeat=2):
        is_alone = own is peer and counts[own.name] == 1
        if is_alone or own.protection["mode"] == "off":  # that promises nothing
            continue
        on_peer = findings(body_of(own), assumed_speed(own), peer.name, body_of(peer), accepts)
        yield from ((own.name, finding) for finding in on_peer)

"""Checks before a run: parameters of patterns, and compatibility of the robots' platforms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.host_messages import REQUEST_LAYER, Layers, Load, LoadRefused
from swarmd.core.messages import PeerFinding
from swarmd.core.values import Platform, Value
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import Origin, check_single, pattern_names
from swarmd.protection.compatibility import Accepts, assumed_speed, body_of, findings
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.platforms import platform_names
from swarmd.sim.scenarios.environment import blamed
from swarmd.sim.scenarios.groups import Groups
from swarmd.sim.scenarios.schedule import Preflight, Schedule
from swarmd.sim.scenarios.schema import ScenarioFile

_WORD = 64  # characters of the longest source of parameters that a status can name


def configured_parameters(file: ScenarioFile, groups: Groups) -> Callable[[str, str], Layers]:
    """A function that gives the configured parameters of a robot and pattern, as layers.

    The layers are "platform", "scenario" and "group <name>", weakest first, without empty layers.
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
    """Raise ConfigError for the first pattern that is unknown or that a robot would refuse.

    Loads each pattern of the schedule once for each platform and set of parameters. `configured`:
    the configured parameters of a robot and pattern (`configured_parameters`). `plugin_dir`: a
    folder of further patterns.
    """
    # 1. The names of patterns in the file.
    with blamed(layers, "plugin_dir"):
        origins = pattern_names(plugin_dir)
    for pattern in file.parameters:
        if pattern not in origins:
            text = f"parameters: {unknown('pattern', pattern, origins)}"
            raise layers.error(("parameters", pattern), text)
    for group, section in file.groups.items():
        for pattern in section.touch:
            _check_name(layers, ("groups", group, "touch", pattern), pattern, origins)
    # 2. A trial for each pattern that a robot will run.
    executor = PatternExecutor(
        PatternLoader({name: (origin.value, origin.is_file) for name, origin in origins.items()})
    )
    tried: set[str] = set()
    for preflight in (*schedule.preflights, *_low_battery(file, groups)):
        _check_name(layers, preflight.keys, preflight.pattern, origins)
        robot, pattern = preflight.robot, preflight.pattern
        parameters = (*configured(robot, pattern), (REQUEST_LAYER, {**preflight.parameters}))
        platform = groups.robots[robot]
        # Robots of one platform with the same parameters give the same result.
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
        text = f"{dotted(keys)}: {unknown('pattern', pattern, origins)}"
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
) -> tuple[Accepts, tuple[str, ...]]:
    """The exceptions that robots accept of their peers, and notes on pairs of platforms.

    Two findings of a robot about a peer hold the robot at zero speed, unless an exception accepts
    the finding: `unseen`, the robot's lidar does not detect the peer; `faster`, the peer is faster
    than the robot's protection assumes. A note is a line for a pair that is compatible only by an
    exception. ConfigError if protection would hold robots.
    """
    # 1. The exceptions of the file.
    accepts = Accepts.of(file.accepts_unseen, file.accepts_faster)
    names = dict.fromkeys(platform.name for platform in groups.robots.values())
    known = {*names, *file.platforms, *platform_names()}
    for kind, accepted in (("unseen", accepts.unseen), ("faster", accepts.faster)):
        for name in accepted:
            if name not in known:
                key = f"accepts_{kind}"
                raise layers.error((key,), f"{key}: {unknown('platform', name, known)}")
    # 2. The exceptions of the simulation: lidars see whole bodies, or robots sense each other.
    has_whole_bodies = file.lidar_visibility == "body"
    if has_whole_bodies:
        accepts = Accepts(dict.fromkeys(names, WHOLE_BODIES), accepts.faster)
    notes, held = [], []
    # `platform`: the platform of the robot that reports the finding about a peer.
    for platform, finding in _pairs(groups.robots.values(), accepts):
        is_sensed = finding.kind == "unseen" and file.radio.range_and_bearing
        if finding.holds and is_sensed:
            text = finding.text.partition(";")[0]  # without the advice to accept the peer
            notes.append(f"{platform}: {text}; told by range and bearing")
        elif finding.holds:
            held.append((platform, finding))
        elif finding.kind == "faster" or not has_whole_bodies:
            notes.append(f"{platform}: {finding.text}")
        # No note for lidars that see whole bodies: the setting `lidar_visibility` tells that.
    if held:
        raise _refusal(layers, held)
    return accepts, tuple(notes)


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


def has_findings(platforms: Iterable[Platform], accepts: Accepts) -> bool:
    """True if two robots of these platforms have a finding about each other."""
    return any(True for _ in _pairs(platforms, accepts))


def _pairs(platforms: Iterable[Platform], accepts: Accepts) -> Iterator[tuple[str, PeerFinding]]:
    """The name of a platform, and a finding of its robots about a peer, for all pairs of robots."""
    robots = list(platforms)
    kinds = {platform.name: platform for platform in robots}
    counts = Counter(platform.name for platform in robots)
    for own, peer in product(kinds.values(), repeat=2):
        is_alone = own is peer and counts[own.name] == 1
        if is_alone or own.protection["mode"] == "off":  # that promises nothing
            continue
        on_peer = findings(body_of(own), assumed_speed(own), peer.name, body_of(peer), accepts)
        yield from ((own.name, finding) for finding in on_peer)

"""The fleet of a plain world, or of a scenario, from the values that a user gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from swarmd.core.errors import ConfigError
from swarmd.core.keys import is_id

if TYPE_CHECKING:
    from swarmd.core.values import Platform
    from swarmd.sim.live.fleet import FleetSpec

Tell = Callable[[str], object]

MAX_ROBOTS = 50


def plain_fleet(
    swarm: str,
    folder: Path,
    *,
    count: int,
    platform: str,
    arena: str | None,
    layout: str | None,
    seed: int,
    lidar_visibility: Literal["body", "real"],
    radio_range: float | None,
    emulator: str | None,
    tell: Tell,
    **others: Any,
) -> FleetSpec:
    """The fleet of a world without a scenario: `count` robots of one platform.

    The default arena is a square, 1.8 times as wide as the range of the lidar, so that a robot
    detects some robots but not all. For many robots the arena is wider, so that each robot has a
    square with a side of 3 protection thresholds. By default the robots start at random places, at
    least 0.6 thresholds apart.

    `folder`: for logs and state. `emulator`: the driver whose protocol is simulated, or None.
    `tell` is called with notes. `others`: further fields of FleetSpec. ConfigError if a value is
    wrong or the arena has no room. PluginError if the emulator is unknown or lacks a library.
    """
    from swarmd.sim.live.fleet import FleetSpec
    from swarmd.sim.world.arena import parse_arena
    from swarmd.sim.world.layouts import parse_layout

    check_emulator(emulator, radio_range)
    loaded, ids = _platform_and_ids(platform, count)
    threshold = float(loaded.protection.get("threshold", 0.5))  # m
    side = round(max(1.8 * loaded.scan.range_max, 3.0 * threshold * count**0.5), 1)
    arena = arena or f"{side:g}x{side:g}"
    layout = layout or f"random:{0.6 * threshold:.2f}"
    # ConfigError if there is no room for the robots.
    parse_layout(layout, [loaded.footprint] * count, parse_arena(arena), seed=seed)
    if count > 1:
        _tell_of_peers(loaded, ids[0], lidar_visibility, tell)
    return FleetSpec(
        swarm=swarm,
        robots=dict.fromkeys(ids, platform),
        folder=folder,
        arena=arena,
        layout=layout,
        seed=seed,
        lidar_visibility=lidar_visibility,
        radio_range=radio_range,
        emulator=emulator,
        **others,
    )


def _platform_and_ids(platform: str, count: int) -> tuple[Platform, tuple[str, ...]]:
    """The platform of a name or file, and the ids of its robots.

    ConfigError without such a platform, or if its name gives no valid ids.
    """
    from swarmd.settings.platforms import load_platform
    from swarmd.sim.live.fleet import robot_ids

    kind = load_platform(platform)
    ids = robot_ids(kind.name, count)
    if not all(map(is_id, ids)):
        raise ConfigError(
            f"--platform {platform!r}: {ids[0]!r} would be no valid robot id;"
            " name the file with a-z, 0-9, _ and - only, such as my_bot.yaml"
        )
    return kind, ids


def _tell_of_peers(kind: Platform, robot: str, visibility: str, tell: Tell) -> None:
    """Call `tell` with the findings that robots of the platform `kind` report about each other.

    A finding says why a robot cannot rely on a peer. The finding `unseen` (the lidar does not
    detect the peer) is left out if lidars of this world detect whole bodies (`visibility`).
    `robot`: the id of a robot, for the texts.
    """
    from swarmd.robot.protection.compatibility import ACCEPTS_NONE, assumed_speed, body_of, findings

    own = body_of(kind)
    for finding in findings(own, assumed_speed(kind), robot, own, ACCEPTS_NONE):
        is_seen = finding.kind == "unseen" and visibility == "body"
        if not is_seen:
            tell(f"note: {finding.text}")


def check_emulator(emulator: str | None, radio_range: float | None = None) -> None:
    """PluginError if the emulator is unknown or lacks a library, ConfigError with a radio range."""
    if emulator is None:
        return
    from swarmd.plugins import load_emulator

    load_emulator(emulator)
    if radio_range is not None:
        raise ConfigError(
            f"--radio-range and --emulate {emulator}: emulated robots do not report which"
            " robots they receive; leave one of the two out"
        )


def scenario_fleet(
    swarm: str,
    folder: Path,
    scenario: str,
    overrides: Mapping[str, Any],
    *,
    seed: int,
    emulator: str | None,
    tell: Tell,
) -> FleetSpec:
    """The fleet of a scenario: its arena, robots, fields and radio, with one seed.

    `scenario`: a name of `exp list` or a YAML file. `folder`: for logs and state. `overrides`: by
    dotted key of the file. `emulator`: the driver whose protocol is simulated, or None. `tell` is
    called with notes. ConfigError names the wrong key.
    """
    from swarmd.sim.live.fleet import FleetSpec
    from swarmd.sim.live.live_scenario import LiveScenario, check_live
    from swarmd.sim.scenarios.scenariofile import load_scenario

    loaded = load_scenario(scenario, overrides)
    check_emulator(emulator)
    check_live(loaded, MAX_ROBOTS, emulator)
    loaded.starts(seed)  # ConfigError if the arena has no room for the robots
    for note in loaded.notes:
        tell(f"note: {note}")
    return FleetSpec(
        swarm=swarm,
        robots={robot: platform.name for robot, platform in loaded.robots.items()},
        folder=folder,
        # Only for the texts of a summary: the scenario gives arena and start poses.
        arena=loaded.arena.text,
        layout=loaded.name,
        seed=seed,
        emulator=emulator,
        plugin_dir=loaded.plugin_dir,
        live=LiveScenario(loaded),
    )

"""What several verbs share: which robots, where, which metrics, and what must be installed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.keys import is_id

if TYPE_CHECKING:
    from swarmd.core.values import Platform
    from swarmd.sim.live.fleet import FleetSpec

Function = TypeVar("Function", bound=Callable[..., Any])

MAX_ROBOTS = 50

_OPTIONS = (
    click.option(
        "-n", "count", type=click.IntRange(1, MAX_ROBOTS), default=7, help="How many robots [7]."
    ),
    click.option("--platform", default="waffle_pi", show_default=True, help="Which kind."),
    click.option(
        "--arena",
        metavar="LxW[,THING]",
        help="Size in m, such as 6x6, then things in it, such as ,box:x:y:l:w:deg or ,pole:x:y:r;"
        " ,box:x:y:l:w:deg:kg can be pushed, ,segment:x1:y1:x2:y2 is an inner wall.",
    ),
    click.option(
        "--layout",
        metavar="NAME[:SIZE]",
        help="Where they start: row, paper, grid, ring, random or list.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Of random layouts.",
    ),
    click.option(
        "--realism",
        type=click.Choice(["realistic", "ideal"]),
        default="realistic",
        show_default=True,
        help="Noise and delays of sensors and bases, or none.",
    ),
    click.option(
        "--lidar-visibility",
        type=click.Choice(["body", "real"]),
        default="body",
        show_default=True,
        help="Lidars see whole robots, or what stands at their height.",
    ),
    click.option(
        "--radio-range",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="M",
        help="Robots further apart do not hear each other [all do].",
    ),
    click.option(
        "--emulate",
        metavar="NAME",
        help="Bodies speak as the robots of this driver do, such as ros2dds, and daemons drive"
        " them with it.",
    ),
    click.option(
        "--plugin-dir",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        envvar="SWARM_PLUGIN_DIR",
        help="Folder of one-file patterns besides the installed ones [$SWARM_PLUGIN_DIR].",
    ),
)


def fleet_options(function: Function) -> Function:
    """Give a verb the options of `WorldOptions`."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldOptions:
    """What `fleet_options` asks for, as it was given."""

    count: int
    platform: str
    arena: str | None
    layout: str | None
    seed: int
    realism: str
    lidar_visibility: str
    radio_range: float | None
    emulator: str | None
    plugin_dir: Path | None


def fleet_for(options: WorldOptions, swarm: str, folder: Path) -> FleetSpec:
    """The fleet that is wanted; ConfigError if it cannot be."""
    from swarmd.sim.live.fleet import FleetSpec

    check_dialect(options)
    kind, robots = robots_for(options.platform, options.count)
    arena, layout = stage_for(kind, options.count, options.arena, options.layout, options.seed)
    return FleetSpec(
        swarm=swarm,
        robots=robots,
        folder=folder,
        arena=arena,
        layout=layout,
        seed=options.seed,
        realism=options.realism,
        lidar_visibility=options.lidar_visibility,
        radio_range=options.radio_range,
        emulator=options.emulator,
        plugin_dir=options.plugin_dir,
    )


def check_dialect(options: WorldOptions) -> None:
    """PluginError if the dialect is none or its needs are missing; ConfigError if it cannot be."""
    if options.emulator is None:
        return
    from swarmd.plugins import load_emulator

    load_emulator(options.emulator)
    if options.radio_range is not None:
        raise ConfigError(
            f"--radio-range and --emulate {options.emulator}: no robot says there whom it hears;"
            " leave one of the two out"
        )


def need(*modules: str) -> None:
    """PluginError with the line that installs them, if one of `modules` is not there."""
    for module in modules:
        if find_spec(module) is None:
            raise PluginError(
                f"this verb needs {module}, which is not installed;"
                " run: pip install 'swarmd[sim,plot]'"
            )


def chosen_metrics(text: str | None) -> tuple[str, ...] | None:
    """The metrics of `--metrics A,B`; ConfigError with the nearest name for one that is none."""
    if text is None:
        return None
    from swarmd.sim.metrics.catalog import metric_of

    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise ConfigError("--metrics names none; see `swarmctl exp metrics`")
    return tuple(metric_of(name).name for name in names)


def robots_for(platform: str, count: int) -> tuple[Platform, dict[str, str]]:
    """The platform, and its name or file by robot id; ConfigError if robots cannot be named so."""
    from swarmd.settings.platforms import load_platform
    from swarmd.sim.live.fleet import robot_ids

    if any(mark in platform for mark in ",:"):
        raise ConfigError(f"--platform {platform!r}: a comma or colon; rename the file or folder")
    kind = load_platform(platform)
    ids = robot_ids(kind.name, count)
    if not all(map(is_id, ids)):
        raise ConfigError(
            f"--platform {platform!r}: its robots would be named {ids[0]!r}, which is no robot id;"
            " name the file with a-z, 0-9, _ and - only, such as my_bot.yaml"
        )
    return kind, dict.fromkeys(ids, platform)


def stage_for(
    platform: Platform, count: int, arena: str | None, layout: str | None, seed: int
) -> tuple[str, str]:
    """Arena and layout as wanted, or such as suit the platform; ConfigError if they cannot be.

    The usual arena is 1.8 times as wide as the sensor reaches, so that a robot sees some others and
    none sees all, and gives each robot room for three protection thresholds squared.
    """
    from swarmd.sim.world.arena import parse_arena
    from swarmd.sim.world.layouts import parse_layout

    threshold = float(platform.protection.get("threshold", 0.5))
    side = round(max(1.8 * platform.scan.range_max, 3.0 * threshold * count**0.5), 1)
    arena = arena or f"{side:g}x{side:g}"
    layout = layout or f"random:{0.6 * threshold:.2f}"
    parse_layout(layout, [platform.footprint] * count, parse_arena(arena), seed=seed)
    return arena, layout

"""`swarmctl demo`: a simulated swarm in one command, watched, measured and gone."""

from __future__ import annotations

import json
import secrets
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmd.cli.arguments import Duration, read_assignments
from swarmd.cli.options import Console
from swarmd.cli.output import print_json, print_section, warn
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.cli.options import WorldOptions, fleet_for, fleet_options, need

if TYPE_CHECKING:
    from swarmd.sim.live.fleet import FleetSpec
    from swarmd.sim.live.show import Play
    from swarmd.sim.live.summary import Summary
    from swarmd.sim.live.view import Scene


@click.command()
@fleet_options
@click.option("--pattern", default="attraction", show_default=True, help="What the robots do.")
@click.option(
    "-p", "params", multiple=True, metavar="KEY=VALUE", help="A parameter; may be repeated."
)
@click.option(
    "--seconds", type=Duration(), default=60.0, help="For how long, in simulated time [60]."
)
@click.option("--headless", is_flag=True, help="No live view; so it is without a terminal.")
@click.option("-o", "--output", type=click.Choice(["table", "json"]), help="Form of the summary.")
@click.pass_context
def demo(
    ctx: click.Context,
    /,
    pattern: str,
    params: tuple[str, ...],
    seconds: float,
    headless: bool,
    output: str | None,
    **world: Any,
) -> None:
    """Start a simulated swarm, run one pattern, and sum it up.

    Leaves trajectories.png, summary.json, the trace and all logs in runs/<time>/. Exit code 0 only
    if every robot ran to the end and none touched another.
    """
    need("mujoco", "matplotlib")
    from swarmd.plugins import find_pattern
    from swarmd.sim.live.show import Play

    is_json = (output or (ctx.find_object(Console) or Console()).output) == "json"
    options = WorldOptions(**world)
    play = Play(
        pattern=pattern,
        params=read_assignments(params),
        seconds=seconds,
        platform=options.platform,
    )
    find_pattern(pattern, options.plugin_dir)
    fleet = fleet_for(options, f"demo-{secrets.token_hex(3)}", Path())
    folder = new_folder(Path("runs"))
    spec = replace(fleet, folder=folder / "logs", trace=folder / "trace.npz", seconds=seconds)
    summary = perform(spec, play, is_live=sys.stdout.isatty() and not (headless or is_json))
    finish(summary, folder, is_json=is_json)
    ctx.exit(0 if summary.is_good else 1)


def perform(spec: FleetSpec, play: Play, *, is_live: bool) -> Summary:
    """The whole course of a demo; every process is gone when it returns or raises."""
    from swarmd.network.operator import Operator
    from swarmd.network.session import SessionSettings
    from swarmd.sim.live.fleet import Fleet, end_on_signals, started_at
    from swarmd.sim.live.link import WorldView
    from swarmd.sim.live.show import Show

    end_on_signals()
    assert spec.trace is not None
    warn(f"Starting a world and {len(spec.robots)} daemons; logs are in {spec.folder}/")
    with (
        Fleet(spec) as fleet,
        WorldView(spec.swarm, fleet.endpoint) as world,
        Operator(SessionSettings(swarm=spec.swarm)) as operator,
        _screen(is_live) as on_scene,
    ):
        return Show(play, fleet, operator, world, on_scene).perform(spec.trace, started_at())


def finish(summary: Summary, folder: Path, *, is_json: bool) -> None:
    """Tell the summary, then keep it: a full disk is not to cost the one that has been earned.

    SwarmError if it cannot be kept.
    """
    tell(summary, folder, is_json=is_json)
    try:
        keep(summary, folder)
    except OSError as error:
        text = f"not all results could be kept in {folder}/: {error.strerror or error}"
        raise SwarmError(f"{text}; make room there, or call it in another folder") from error


def keep(summary: Summary, folder: Path) -> None:
    """Write summary.json and trajectories.png beside the trace."""
    from swarmd.sim.plots.trajectories import draw_trajectories
    from swarmd.sim.trace import load_trace

    (folder / "summary.json").write_text(json.dumps(summary.as_json(), indent=2) + "\n")
    title = f"{summary.pattern}, {len(summary.robots)} {summary.platform}"
    draw_trajectories(load_trace(folder / "trace.npz"), folder / "trajectories.png", title)


def tell(summary: Summary, folder: Path, *, is_json: bool) -> None:
    """Print the summary; problems go to stderr."""
    if is_json:
        print_json("Demo", {**summary.as_json(), "folder": str(folder)})
    else:
        print_section("Summary", [*summary.lines(), ("results", f"{folder}/")])
    for line in summary.problems:
        warn(f"problem: {line}")


def new_folder(base: Path) -> Path:
    """A folder of its own for this run, named by the time; ConfigError if none can be made."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for suffix in ("", *(f"-{i}" for i in range(2, 1000))):
        folder = base / f"{stamp}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            text = f"{folder}/ cannot be made ({error.strerror})"
            raise ConfigError(f"{text}; call it in a folder that may be written to") from error
        return folder
    raise ConfigError(f"{base / stamp}/ is there a thousand times; remove some")


@contextmanager
def _screen(is_live: bool) -> Iterator[Callable[[Scene], None]]:
    """Where scenes are shown: a live view on the terminal, or nowhere."""
    if not is_live:
        yield lambda scene: None
        return
    from rich.console import Console as Terminal
    from rich.live import Live

    from swarmd.sim.live.view import render

    terminal = Terminal()
    with Live(console=terminal, auto_refresh=False) as live:
        yield lambda scene: live.update(
            render(scene, terminal.width, terminal.height), refresh=True
        )

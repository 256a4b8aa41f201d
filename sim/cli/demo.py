"""`swarmctl demo`: a simulated swarm from start to summary in one command."""

from __future__ import annotations

import json
import secrets
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec import structs

from swarmd.core.clock import process_start
from swarmd.core.errors import PluginError, SwarmError
from swarmd.core.token_bucket import TokenBucket
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import Duration
from swarmd.operator.cli.output import print_json, print_section, signals_end, warn
from swarmd.operator.texts.assignments import read_assignments
from swarmd.operator.texts.values import counted
from swarmd.operator.texts.why import SILENT, state_word
from swarmd.plugins import find_pattern, is_pattern_path, place_of_pattern
from swarmd.sim.cli.options import fleet_for, fleet_options, need, new_folder, output_option
from swarmd.sim.cli.world_page import page_option, world_page

if TYPE_CHECKING:
    from swarmd.operator.cli.web import WebOptions
    from swarmd.operator.view.scene import Scene
    from swarmd.sim.live.fleet import FleetSpec
    from swarmd.sim.live.summary import DemoSummary
    from swarmd.sim.scenarios.scenario import ScheduledEvent


@click.command(epilog="Example: swarmctl demo --pattern dispersion -n 7")
@fleet_options
@click.option(
    "--pattern",
    default="attraction",
    show_default=True,
    metavar="NAME|FILE",
    help="What they run: a name, or your file or folder; with SCENARIO in place of its own.",
    shell_complete=completion.patterns_or_files,
)
@click.option(
    "-p", "params", multiple=True, metavar="KEY=VALUE", help="A parameter; may be repeated."
)
@click.option(
    "--for",
    "--seconds",
    "seconds",
    type=Duration(),
    default=60.0,
    help="How long, in simulated time [60s].",
)
@click.option("--headless", is_flag=True, help="Show no live view; the default without a terminal.")
@page_option
@output_option
@click.pass_context
def demo(
    ctx: click.Context,
    /,
    pattern: str,
    params: tuple[str, ...],
    seconds: float,
    headless: bool,
    is_json: bool,
    page: WebOptions | None,
    **world: Any,
) -> None:
    """Start a simulated swarm, run one pattern or SCENARIO, and print a summary.

    SCENARIO is a name of `swarmctl exp list` or a YAML file. A scenario runs for its duration, with
    one seed. The demo leaves summary.json, trajectories.png, the trace and all logs in
    runs/<time>/. Ctrl-C and SIGTERM end the run early, also with a summary. Exit code 0 only if
    every robot ran to the end and no two robots touched.
    """
    # 1. Check the options before any process starts. `world`: the values of `fleet_options`, such
    #    as scenario, platform and plugin_dir.
    need("mujoco")
    from swarmd.sim.scenarios.scenario import ScheduledEvent

    has_scenario = world["scenario"] is not None
    if not has_scenario:
        pattern, world["plugin_dir"] = _place(ctx, pattern, world["plugin_dir"])
    values = _checked_parameters(pattern, params, world)
    is_given = ctx.get_parameter_source("pattern") is click.core.ParameterSource.COMMANDLINE
    chosen = pattern if has_scenario and is_given else None

    # 2. The fleet. It is made without a folder, so that a wrong option leaves no folder behind.
    fleet = fleet_for(f"demo-{secrets.token_hex(3)}", Path(), pattern=chosen, **world)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    folder = new_folder(Path("runs"), (stamp, *(f"{stamp}-{n}" for n in range(2, 1000))))
    own = {"folder": folder / "logs", "trace": str(folder / "trace.npz")}
    if fleet.live is None:
        run = ScheduledEvent(
            at=0.0, action="run", robots=tuple(fleet.robots), pattern=pattern, parameters=values
        )
        events: Sequence[ScheduledEvent] = (run,)
        spec = structs.replace(fleet, **own, seconds=seconds)
    else:  # robots that join later, by an event, have no daemon so far
        scenario = fleet.live.scenario
        events = scenario.events
        seconds = scenario.duration
        spec = structs.replace(fleet, **own, seconds=seconds, absent=scenario.absent)

    # 3. The run and its report.
    has_screen = sys.stdout is not None and sys.stdout.isatty()
    is_live = has_screen and not (headless or is_json)
    try:
        with signals_end():  # SIGTERM also ends the processes
            summary = perform(spec, events, seconds, is_live=is_live, page=page)
            report(summary, folder, is_json=is_json)
    except (SwarmError, OSError, KeyboardInterrupt, SystemExit):
        warn(f"what was kept is in {folder}/")
        raise
    ctx.exit(128 + summary.signal if summary.signal else 0 if summary.is_good else 1)


def _place(ctx: click.Context, pattern: str, plugin_dir: Path | None) -> tuple[str, Path | None]:
    """The name of a pattern that is given by name or path, and the folder that has it.

    A path prevails over the variable of --plugin-dir. ConfigError if there is none at the path.
    """

    source = ctx.get_parameter_source("plugin_dir")
    is_variable = source is click.core.ParameterSource.ENVIRONMENT
    is_weaker = is_variable and is_pattern_path(pattern)
    return place_of_pattern(pattern, None if is_weaker else plugin_dir)


def _checked_parameters(
    pattern: str, params: Sequence[str], world: Mapping[str, Any]
) -> Mapping[str, Any]:
    """The values of `-p KEY=VALUE` by key; SwarmError if the pattern is unknown or refuses them.

    A demo with a scenario does not run `pattern`, so only the form of `params` is checked.
    """
    from swarmd.operator.cli.plugin_check import check_parameters

    has_scenario = world["scenario"] is not None
    if not has_scenario:
        find_pattern(pattern, world["plugin_dir"])
    values = read_assignments(params)
    if values and not has_scenario:
        check_parameters(pattern, values, world["plugin_dir"], world["platform"])
    return values


def perform(
    spec: FleetSpec,
    events: Sequence[ScheduledEvent],
    seconds: float,
    *,
    is_live: bool,
    page: WebOptions | None = None,
) -> DemoSummary:
    """Run the demo of `seconds` s from start to end, and return its summary.

    A world and a daemon for each robot run as processes. All of them have ended when this function
    returns or raises. `is_live`: the terminal shows the robots. `page`: options of a web page that
    shows them; None: no page.
    """
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.operator import Operator
    from swarmd.sim.live.demo_run import DemoRun
    from swarmd.sim.live.fleet import Fleet
    from swarmd.sim.live.link import WorldView

    assert spec.trace is not None  # `demo` has set it; the summary is measured on the trace
    warn(f"Starting a world and {counted(len(spec.robots), 'daemon')}; logs are in {spec.folder}/")
    with (
        Fleet(spec) as fleet,
        WorldView(spec.swarm, fleet.endpoint) as world,
        Operator(NetworkSettings(swarm=spec.swarm)) as operator,
        world_page(fleet, page) as served_page,
        _screen(is_live, served_page.addresses if served_page is not None else ()) as draw_scene,
    ):
        run = DemoRun(events, seconds, fleet, operator, world, draw_scene)
        # The summary counts the time until motion from the start of this process.
        summary = run.perform(Path(spec.trace), process_start(), warn)
        if served_page is not None:
            served_page.reason = (
                f"The demo has ended; its robots have stopped. Results: {spec.folder.parent}/"
            )
        return summary


def report(summary: DemoSummary, folder: Path, *, is_json: bool) -> None:
    """Print the summary of a demo, then write summary.json and trajectories.png to `folder`.

    Problems of the run are printed on stderr. Printing comes first, so that the user has the
    summary also if the disk is full; the files are written also if the reader of a pipe has gone.
    SwarmError if a file cannot be written.
    """
    try:
        if is_json:
            print_json("Demo", {**summary.as_json(), "folder": str(folder)})
        else:
            print_section("Summary", [*summary.lines(), ("results", f"{folder}/")])
    finally:
        for problem in summary.problems:
            warn(f"problem: {problem}")
        _keep(summary, folder)


def _keep(summary: DemoSummary, folder: Path) -> None:
    """Write summary.json and trajectories.png."""
    try:
        (folder / "summary.json").write_text(json.dumps(summary.as_json(), indent=2) + "\n")
        try:
            need("matplotlib")
        except PluginError as error:
            warn(f"no trajectories.png: {error}")
            return
        from swarmd.sim.plots.theme import save
        from swarmd.sim.plots.trajectories import trajectories_figure
        from swarmd.sim.trace import load_trace

        title = f"{summary.pattern}, {len(summary.robots)} {summary.platform}"
        figure = trajectories_figure(load_trace(folder / "trace.npz"), title)
        save(figure, folder / "trajectories.png")
    except OSError as error:
        text = f"not all results could be kept in {folder}/: {error.strerror or error}"
        raise SwarmError(f"{text}; make room there, or run the demo in another folder") from error


def progress_lines(clock: Callable[[], float] = time.monotonic) -> Callable[[Scene], None]:
    """A function that prints a line on stderr for a scene, once in TELL_PERIOD s by `clock`.

    The line has the title of the scene, and the count of robots in each state.
    """
    from swarmd.sim.live.starting import TELL_PERIOD

    pace = TokenBucket(1.0 / TELL_PERIOD, 1.0)

    def tell(scene: Scene) -> None:
        if pace.take(1.0, clock()):
            states = {robot: state_word(status) for robot, status in scene.statuses.items()}
            words = [states.get(robot, SILENT) for robot in scene.poses]
            counts = (f"{words.count(word)} {word}" for word in sorted(set(words)))
            warn(f"{scene.title}; {', '.join(counts)}")

    return tell


@contextmanager
def _screen(is_live: bool, addresses: Sequence[str]) -> Iterator[Callable[[Scene], None]]:
    """Yield a function that shows a scene: as a live view of the terminal, or as lines on stderr.

    `is_live`: the function draws. `addresses`: web addresses of a page, shown below the view.
    """
    if not is_live:
        yield progress_lines()
        return
    from rich.console import Console as Terminal
    from rich.live import Live

    from swarmd.operator.view.terminal import render

    terminal = Terminal()
    below = [(line, "bold") for line in addresses]
    with Live(console=terminal, auto_refresh=False) as live:
        yield lambda scene: live.update(
            render(replace(scene, below=below), terminal.width, terminal.height), refresh=True
        )

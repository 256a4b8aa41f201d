"""`swarmctl sim up`: a simulated world and its daemons, until Ctrl-C."""

from __future__ import annotations

import os
import shlex
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from msgspec import structs

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.keys import check_id
from swarmd.link.keys.identity import Installed, installed_identity
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.options import CommonOptions, Duration, VerbGroup
from swarmd.operator.cli.output import print_section, signals_end, warn
from swarmd.operator.client.network_options import DEFAULT_SWARM
from swarmd.operator.texts.values import counted
from swarmd.settings.contexts import context_in_use
from swarmd.sim.cli.options import fleet_for, fleet_options, need
from swarmd.sim.cli.world_page import page_option, world_page

if TYPE_CHECKING:
    from swarmd.operator.cli.web import WebOptions
    from swarmd.sim.live.demo_run import LiveTimeline
    from swarmd.sim.live.fleet import Fleet, FleetSpec
    from swarmd.sim.world.faults import FaultKind

CHECK_PERIOD = 1.0  # s between two checks of the processes


@click.group(cls=VerbGroup, epilog="Example: swarmctl sim up -n 7")
def sim() -> None:
    """Keep a simulated swarm running, commanded with the other verbs."""


@sim.command()
@fleet_options
@click.option("--swarm", metavar="NAME", help="The swarm's name [$SWARM, or default].")
@click.option(
    "--keep",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Keep logs and latches in this folder; the next start loads the latches.",
)
@click.option(
    "--bases-only",
    is_flag=True,
    help="Start no daemons: simulate the bases for daemons that you start yourself.",
)
@click.option(
    "--endpoint",
    default="tcp/127.0.0.1:0",
    show_default=True,
    metavar="ENDPOINT",
    help="Where the bases listen for drivers; anyone who reaches it can drive them.",
)
@page_option
@click.pass_context
def up(
    ctx: click.Context,
    /,
    swarm: str | None,
    keep: Path | None,
    bases_only: bool,
    endpoint: str,
    page: WebOptions | None,
    **world: Any,
) -> None:
    """Start one world, and a daemon for each of its robots; Ctrl-C ends all of these processes.

    SCENARIO is a name of `swarmctl exp list` or a YAML file. The world has the arena, robots,
    fields and radio of the scenario, with one seed, and its faults begin and end at their times.
    The robots start idle: patterns and other events run only with `swarmctl demo SCENARIO`. Command
    the robots from another terminal with the other verbs of swarmctl.
    """
    need("mujoco")
    from swarmd.sim.live.simulated_swarm import kept_folder

    name = _swarm_of(ctx, swarm)
    with kept_folder(keep) as folder:
        # `world`: the values of `fleet_options`. `bases_only`: the user starts the daemons.
        spec = structs.replace(fleet_for(name, folder, **world), endpoint=endpoint)
        if bases_only:
            serve_bases(spec, page)
        else:
            serve(spec, page)


@sim.command()
@click.argument("robots", nargs=-1, required=True, metavar="ROBOT... PLACE=KIND [KEY=VALUE]...")
@click.option("--for", "seconds", type=Duration(), help="Wait, and end the fault after this time.")
@click.option("--end", is_flag=True, help="End the fault of this kind now.")
@click.option("--swarm", metavar="NAME", help="The swarm's name [$SWARM, or default].")
@click.pass_context
def fault(
    ctx: click.Context,
    /,
    robots: tuple[str, ...],
    seconds: float | None,
    end: bool,
    swarm: str | None,
) -> None:
    """Give robots of a running simulated world a fault, such as scan=frozen or scan=noise sd=0.2.

    The kinds and their parameters are those of the event `fault` of scenarios. process=killed kills
    the daemons, process=frozen halts them. With --for this command waits, and then ends the fault.
    """
    need("mujoco")
    from swarmd.operator.texts.assignments import read_assignments
    from swarmd.sim.live.fleet import running
    from swarmd.sim.live.link import WorldView
    from swarmd.sim.world.faults import fault_of

    names = [word for word in robots if "=" not in word]
    kind = fault_of(read_assignments((word for word in robots if "=" in word), "fault"), "fault")
    if not names:
        raise click.UsageError("no robot is named; give one, such as tb3-02")
    name = _swarm_of(ctx, swarm)
    world = running(name)
    with ExitStack() as ends, signals_end():
        change: Callable[..., object]
        if kind.carried_by == "daemon":
            change = partial(signal_daemons, world.pids, name, kind, names)
        else:
            view = ends.enter_context(WorldView(name, world.endpoint))
            change = partial(view.change_fault, kind.plain, names)
        change(is_on=not end)
        words = [*robots, *(() if swarm is None else ("--swarm", swarm))]
        state = "has ended" if end else f"is on; {how_it_ends(kind, words, seconds)}"
        click.echo(f"{', '.join(names)}: {kind.text} {state}")
        if seconds is not None:
            ends.callback(change, is_on=False)
            time.sleep(seconds)


def how_it_ends(kind: FaultKind, words: Sequence[str], seconds: float | None) -> str:
    """How a fault ends that `sim fault` has begun with `words`, and for `seconds` s."""
    if kind.ends_daemon:
        return "the daemon stays off; `sim up` prints how to start it again"
    if seconds is not None:
        return f"it ends in {seconds:g} s"
    return f"to end it: swarmctl sim fault {shlex.join(words)} --end"


def signal_daemons(
    pids: Mapping[str, int], swarm: str, kind: FaultKind, robots: Sequence[str], *, is_on: bool
) -> None:
    """Kill, halt or continue the daemons of robots.

    `pids`: the processes of the world by name, as its file has them; a process that is not the
    daemon of its robot gets no signal. SwarmError, before any signal, for a robot without a daemon.
    """
    from swarmd.sim.live.fleet import WORLD, is_daemon

    for robot in robots:
        if robot == WORLD or robot not in pids:
            raise ConfigError(unknown("robot with a daemon", robot, pids.keys() - {WORLD}))
        if is_on and not is_daemon(pids[robot], robot, swarm):
            raise SwarmError(f"{robot}: its daemon has ended; start it as `sim up` tells")
    begin = signal.SIGKILL if kind.ends_daemon else signal.SIGSTOP
    for robot in robots:
        if is_daemon(pids[robot], robot, swarm):
            os.kill(pids[robot], begin if is_on else signal.SIGCONT)
        else:
            warn(f"{robot}: its daemon has ended; `sim up` tells how to start it again")


def _swarm_of(ctx: click.Context, swarm: str | None) -> str:
    """The name of the swarm: of the verb's option, of the option before the verb, or of $SWARM."""

    common = ctx.find_object(CommonOptions)  # the options before the verb; None without `swarmctl`
    swarm_option = swarm or (common.swarm if common is not None else None)
    return check_id(swarm_option or os.environ.get("SWARM") or DEFAULT_SWARM, "swarm")


def serve(spec: FleetSpec, page: WebOptions | None = None) -> None:
    """Run a fleet until Ctrl-C or SIGTERM. SwarmError if the fleet cannot start, or the world ends.

    A fleet is a simulated world with a daemon for each robot. `page`: options of a web page that
    shows the fleet; None: no page.
    """
    from swarmd.operator.session.operator import Operator
    from swarmd.sim.live.demo_run import LiveTimeline
    from swarmd.sim.live.fleet import Fleet
    from swarmd.sim.live.link import WorldView
    from swarmd.sim.live.simulated_swarm import check_free
    from swarmd.sim.live.starting import await_robots, statuses_of

    with signals_end(), Operator(NetworkSettings(swarm=spec.swarm)) as operator:
        check_free(operator, spec, "swarmctl sim up --swarm NAME")
        with Fleet(spec) as fleet, world_page(fleet, page):
            statuses = statuses_of(await_robots(operator, fleet, warn))
            for robot in spec.robots:
                if robot not in statuses or not statuses[robot].health.driver_up:
                    warn(f"{robot} is not up yet; its log: {spec.folder}/{robot}.log")
            with suppress(KeyboardInterrupt):
                _print_usage(spec)
                with WorldView(spec.swarm, fleet.endpoint) as world:
                    events = () if spec.live is None else spec.live.scenario.events
                    faults = [event for event in events if event.fault is not None]
                    timeline = LiveTimeline(faults, fleet, operator, world)
                    _report_ends(fleet, timeline)
            click.echo("ending all")


def serve_bases(spec: FleetSpec, page: WebOptions | None = None) -> None:
    """Run a world without daemons until Ctrl-C or SIGTERM; SwarmError if the world ends.

    Prints the driver and its options that a daemon needs to drive a robot of this world.
    """
    from swarmd.settings.yamlfile import text_of
    from swarmd.sim.live.fleet import Fleet, daemon_config

    spec = structs.replace(spec, absent=frozenset(spec.robots))
    with signals_end(), Fleet(spec) as fleet, world_page(fleet, page):
        config = daemon_config(spec, next(iter(spec.robots)), fleet.ready)
        names = list(spec.robots)
        shown = {key: config[key] for key in ("platform", "driver", "driver_options")}
        with suppress(KeyboardInterrupt):
            click.echo(f"{counted(len(names), 'base')} up: {', '.join(names)}")
            click.echo("add to the file of each daemon:")
            click.echo(text_of(shown, flow=None).rstrip())
            _report_ends(fleet)
        click.echo("ending the world")


def _report_ends(fleet: Fleet, timeline: LiveTimeline | None = None) -> NoReturn:
    """Warn once of each daemon that ends; SwarmError if the process of the world ends.

    Carries out the events of `timeline` meanwhile, and tells each; its time 0 is now.

    The other daemons keep running, since users kill robots of a simulated swarm on purpose.
    """
    from swarmd.sim.live.fleet import WORLD

    reported: set[str] = set()
    begin = time.monotonic()
    while True:
        fleet.check(WORLD)
        if timeline is not None:
            timeline.apply(time.monotonic() - begin)
            for event in timeline.done:
                problem = f": {event.problem}" if event.problem else ""
                warn(f"{event.at:g} s: {event.action}, {', '.join(event.robots)}{problem}")
            timeline.done.clear()
        for name, line in fleet.ended().items():
            if name not in reported:
                reported.add(name)
                warn(f"{line}; to start it again: swarmd --config {fleet.spec.folder}/{name}.yaml")
        time.sleep(CHECK_PERIOD)


def _print_usage(spec: FleetSpec) -> None:

    try:
        has_context = context_in_use() is not None
    except ConfigError as error:  # the robots are up; a line with $SWARM does without contexts
        has_context = True
        warn(str(error))
    is_default = spec.swarm == DEFAULT_SWARM and not has_context
    swarmctl = "swarmctl" if is_default else f"SWARM={spec.swarm} swarmctl"
    if has_context:  # its profile may be another one
        swarmctl += " --profile dev"
    if installed_identity(spec.swarm) != Installed():
        warn(f"the simulated robots have no keys; a secured swarm {spec.swarm} ignores them")
        swarmctl += " --insecure"
    names = list(spec.robots)
    to_last = f" to {names[-1]}" if names[1:] else ""
    click.echo(f"{counted(len(names), 'robot')} up in swarm {spec.swarm}: {names[0]}{to_last}")
    print_section(
        "In another terminal:",
        [
            (f"{swarmctl} members", "all robots and their states"),
            *_runs(spec, swarmctl),
            (f"{swarmctl} describe {names[0]}", "one robot in detail"),
            (f"{swarmctl} stop", "all robots stop"),
        ],
    )
    click.echo(f"Logs: {spec.folder}/  Ctrl-C ends everything.")


def _runs(spec: FleetSpec, swarmctl: str) -> list[tuple[str, str]]:
    """The commands that start what the scenario runs at its beginning."""
    if spec.live is None:
        return [(f"{swarmctl} run attraction --all", "the robots gather")]
    runs = [e for e in spec.live.scenario.events if e.action == "run" and e.at == 0.0]
    return [
        (f"{swarmctl} run {run.pattern} {_targets(run.robots, spec)}", "as the scenario begins")
        for run in runs
    ]


def _targets(robots: tuple[str, ...], spec: FleetSpec) -> str:
    """The robots as words of a command: --all, a glob, or their names."""
    if set(robots) == set(spec.robots):
        return "--all"
    stem = f"{robots[0].rpartition('-')[0]}-"
    if {robot for robot in spec.robots if robot.startswith(stem)} == set(robots):
        return f"'{stem}*'"
    return " ".join(robots)

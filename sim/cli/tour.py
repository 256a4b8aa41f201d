"""`swarmctl tour`: the first five commands on a simulated swarm, one after the other."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import click

from swarmd.operator.cli.consent import has_terminal
from swarmd.operator.cli.output import signals_end, warn
from swarmd.operator.texts.values import counted
from swarmd.sim.cli.options import fleet_for, fleet_options, need

_ENTRY = "from swarmd.operator.cli.entry import swarmctl; swarmctl()"


class TourStep(NamedTuple):
    """A command, what it is for, and for how long the robots drive after it."""

    words: tuple[str, ...]
    text: str
    seconds: float = 0.0


def steps(robots: tuple[str, ...]) -> tuple[TourStep, ...]:
    """The commands of the tour, for these robots."""
    return (
        TourStep(("members",), "Which robots are there, and in which state?"),
        TourStep(("run", "attraction", "--all"), "All robots drive towards each other.", 5.0),
        TourStep(("describe", robots[0]), "What does one robot do, and why does it stand or move?"),
        TourStep(("stop",), "All robots stop."),
        TourStep(("events",), "What has happened?"),
    )


@click.command(epilog="Example: swarmctl tour")
@fleet_options
@click.option("--yes", is_flag=True, help="Run all commands without waiting for Enter.")
@click.pass_context
def tour(ctx: click.Context, /, yes: bool, **world: Any) -> None:
    """Try the first five commands on a simulated swarm; takes a minute and leaves nothing behind.

    Each command is shown first and runs after Enter; Ctrl-C ends the tour and the swarm. Exit code
    0 if each command succeeds, else the exit code of the first command that fails.
    """
    if not yes and not has_terminal():
        raise click.UsageError("the tour waits for Enter, and this is no terminal; give --yes")
    need("mujoco")
    from swarmd.sim.live.simulated_swarm import kept_folder

    with kept_folder(None) as folder:
        ctx.exit(_toured(folder, is_waiting=not yes, **world))


def _toured(folder: Path, *, is_waiting: bool, **world: Any) -> int:
    """Start a simulated swarm with a unique name, and run the steps of the tour in it.

    Each step prints its text, then runs a `swarmctl` command as a process. `is_waiting`: before a
    command the user presses Enter. `world`: the values of `fleet_options`. Returns 0, or the exit
    code of the first command that fails.
    """
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.operator import Operator
    from swarmd.sim.live.fleet import Fleet
    from swarmd.sim.live.starting import await_robots

    swarm = f"tour-{secrets.token_hex(4)}"
    spec = fleet_for(swarm, folder, **world)
    # Sockets and member lists of the processes lie in `folder`, which the caller removes.
    os.environ |= {"TMPDIR": str(folder), "XDG_CACHE_HOME": str(folder), "SWARM": swarm}
    count = len(spec.robots)
    click.echo(
        f"Starting a simulated swarm of {counted(count, 'robot')},"
        f" as `swarmctl sim up -n {count}` does."
    )
    with (
        signals_end(),  # SIGTERM also ends the processes
        Operator(NetworkSettings(swarm=swarm)) as operator,
        Fleet(spec) as fleet,
    ):
        await_robots(operator, fleet, warn)
        for number, step in enumerate(steps(tuple(spec.robots)), 1):
            click.echo(
                f"\n{number}. {step.text}\n$ swarmctl {' '.join(step.words)}", nl=not is_waiting
            )
            if is_waiting:
                click.prompt("   [Enter]", default="", show_default=False, prompt_suffix=" ")
            # `swarmctl` of this installation, which need not be on PATH. -P: no module is imported
            # from the user's folder.
            command = [sys.executable, "-P", "-c", _ENTRY, *step.words]
            sys.stdout.flush()
            exit_code = subprocess.run(command, check=False).returncode
            if exit_code:
                warn(f"swarmctl {step.words[0]} ended with exit code {exit_code}")
                return exit_code
            time.sleep(step.seconds)
            fleet.check()  # SwarmError if a process of the swarm has ended
    click.echo(
        "\nThe swarm has ended. To keep one, with its map in a browser: swarmctl sim up --web, and"
        "\nin another terminal the commands above."
        "\nLessons: docs/tutorial/README.md"
    )
    return 0

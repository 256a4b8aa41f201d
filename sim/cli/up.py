"""`swarmctl sim up`: a world and its daemons, until Ctrl-C."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.cli.options import DEFAULT_SWARM, Console
from swarmd.cli.output import print_section, warn
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.cli.options import WorldOptions, fleet_for, fleet_options, need

if TYPE_CHECKING:
    from collections.abc import Collection

    from swarmd.network.operator import Operator
    from swarmd.sim.live.fleet import Fleet, FleetSpec

LOOK = 1.0  # s between two looks at the processes


@click.group()
def sim() -> None:
    """Keep a simulated swarm running, to be worked by the other verbs."""


@sim.command()
@fleet_options
@click.option("--swarm", metavar="NAME", help="The swarm's name [$SWARM, or default].")
@click.option(
    "--keep",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Logs and latches stay here, and latches count at the next start.",
)
@click.pass_context
def up(
    ctx: click.Context,
    /,
    swarm: str | None,
    keep: Path | None,
    **world: Any,
) -> None:
    """Start a world and a daemon for each robot; Ctrl-C ends them all.

    The robots come up idle. Work them from another terminal with the ordinary verbs of swarmctl.
    """
    need("mujoco")
    from swarmd.core.keys import check_id

    given = swarm or (ctx.find_object(Console) or Console()).swarm
    name = check_id(given or os.environ.get("SWARM") or DEFAULT_SWARM, "swarm")
    options = WorldOptions(**world)
    with _folder(keep) as folder:
        serve(fleet_for(options, name, folder))


def serve(spec: FleetSpec) -> None:
    """Keep a fleet up until Ctrl-C or SIGTERM; SwarmError if it cannot be, or its world ends."""
    from swarmd.network.operator import Operator
    from swarmd.network.session import SessionSettings
    from swarmd.sim.live.fleet import Fleet, end_on_signals
    from swarmd.sim.live.show import await_up

    end_on_signals()
    with Operator(SessionSettings(swarm=spec.swarm)) as operator:
        refuse_taken(operator, spec.robots)
        with Fleet(spec) as fleet:
            await_up(operator, fleet, tuple(spec.robots))
            tell(spec)
            with suppress(KeyboardInterrupt):
                watch(fleet)
            click.echo("ending all")


def watch(fleet: Fleet) -> NoReturn:
    """Tell of daemons that end; SwarmError if the world does.

    The others go on: to kill a robot is one of the things a simulated swarm is for.
    """
    from swarmd.sim.live.fleet import WORLD

    told: set[str] = set()
    while True:
        fleet.check(WORLD)
        for name, line in fleet.ended().items():
            if name not in told:
                told.add(name)
                warn(f"{line}; to start it again: swarmd --config {fleet.spec.folder}/{name}.yaml")
        time.sleep(LOOK)


def refuse_taken(operator: Operator, robots: Collection[str]) -> None:
    """ConfigError if robots of these names are alive in the swarm."""
    taken = sorted(set(operator.members().alive) & set(robots))
    if taken:
        raise ConfigError(
            f"swarm {operator.settings.swarm!r} already has {', '.join(taken)};"
            " end those, or take another name: swarmctl sim up --swarm NAME"
        )


def tell(spec: FleetSpec) -> None:
    """What there is now, and what a second terminal can do with it."""
    swarmctl = "swarmctl" if spec.swarm == DEFAULT_SWARM else f"SWARM={spec.swarm} swarmctl"
    names = list(spec.robots)
    click.echo(f"{len(names)} robots are up in swarm {spec.swarm}: {names[0]} to {names[-1]}")
    print_section(
        "In another terminal:",
        [
            (f"{swarmctl} members", "who is there, and how they are"),
            (f"{swarmctl} run attraction --all", "gather"),
            (f"{swarmctl} describe {names[0]}", "all about one robot"),
            (f"{swarmctl} stop", "all stand"),
        ],
    )
    click.echo(f"Logs: {spec.folder}/  Ctrl-C ends everything.")


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    """The folder for logs and state: `keep`, or a new one that stays only if something failed."""
    if keep is not None:
        yield keep
        return
    folder = Path(tempfile.mkdtemp(prefix="swarmd-sim-"))
    is_wanted = False
    try:
        yield folder
    except SwarmError:
        is_wanted = any(folder.iterdir())  # there are logs to read
        raise
    finally:
        if not is_wanted:
            shutil.rmtree(folder, ignore_errors=True)

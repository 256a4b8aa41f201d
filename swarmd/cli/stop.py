"""`swarmctl stop` and `swarmctl estop`: taken by robots in every state; without names by all."""

from __future__ import annotations

import click

from swarmd.cli.arguments import read_targets, target_options
from swarmd.cli.options import Console, common
from swarmd.cli.report import finish
from swarmd.cli.send import halt


@click.command()
@target_options
@common
def stop(console: Console, names: tuple[str, ...], is_all: bool, exclude: tuple[str, ...]) -> None:
    """Stop robots; without names all of them. They need a `run` to move again."""
    targets = read_targets("stop", names, is_all, exclude, needed=False)
    with console.operator() as operator:
        outcome = halt(operator, "stop", targets, {}, console.timeout)
    finish(console, "stop", outcome)


@click.command()
@target_options
@click.option("--reason", default="", help="Kept with the latch, and shown by `describe`.")
@common
def estop(
    console: Console,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    reason: str,
) -> None:
    """Emergency stop, latched; without names all robots. Never asks back.

    Robots hold it through restarts, and robots that join take it over, until `swarmctl reset`.
    """
    targets = read_targets("estop", names, is_all, exclude, needed=False)
    # A stop of everyone is taken over by robots that join or return; one of some is not.
    args = {"scope": "swarm" if targets.is_everyone else "robots", "reason": reason}
    with console.operator() as operator:
        outcome = halt(operator, "estop", targets, args, console.timeout)
    finish(console, "estop", outcome)

"""`swarmctl stop` and `swarmctl estop`: taken by robots in every state; without names by all."""

from __future__ import annotations

import click

from swarmd.cli.arguments import read_targets, target_options
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.report import report_outcome
from swarmd.cli.send import send_stop


@click.command()
@target_options
@common_options
def stop(
    options: CommonOptions, names: tuple[str, ...], is_all: bool, exclude: tuple[str, ...]
) -> None:
    """Stop robots; without names all of them. They need a `run` to move again."""
    targets = read_targets("stop", names, is_all, exclude, needed=False)
    with options.operator() as operator:
        outcome = send_stop(operator, "stop", targets, options.timeout)
    report_outcome(options, "stop", outcome)


@click.command()
@target_options
@click.option("--reason", default="", help="Kept with the latch, and shown by `describe`.")
@common_options
def estop(
    options: CommonOptions,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    reason: str,
) -> None:
    """Emergency stop, latched; without names all robots. Never asks back.

    Robots hold it through restarts, and robots that join take it over, until `swarmctl reset`.
    """
    targets = read_targets("estop", names, is_all, exclude, needed=False)
    with options.operator() as operator:
        outcome = send_stop(operator, "estop", targets, options.timeout, reason)
    report_outcome(options, "estop", outcome)

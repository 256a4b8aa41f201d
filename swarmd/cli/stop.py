"""`swarmctl stop` and `swarmctl estop`: robots apply them in every state."""

from __future__ import annotations

import click

from swarmd.cli.arguments import Targets, takes_targets
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.report import report_outcome
from swarmd.cli.send import send_stop


@click.command()
@takes_targets(is_required=False)
@common_options
def stop(options: CommonOptions, targets: Targets) -> None:
    """Stop TARGETS, or all robots; they need a `run` to move again."""
    report_outcome(options, "stop", send_stop(options, "stop", targets))


@click.command()
@takes_targets(is_required=False)
@click.option("--reason", default="", help="Kept with the latch, and shown by `describe`.")
@common_options
def estop(options: CommonOptions, targets: Targets, reason: str) -> None:
    """Emergency-stop TARGETS, or all robots, without confirmation.

    The stop is latched: it survives restarts, and robots that join adopt a stop of the whole
    swarm, until `swarmctl reset`.
    """
    report_outcome(options, "estop", send_stop(options, "estop", targets, reason))

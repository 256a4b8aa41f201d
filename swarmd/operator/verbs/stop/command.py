"""The verbs that stop robots and let them move again: `swarmctl stop`, `estop` and `reset`."""

from __future__ import annotations

import click

from swarmd.operator.cli.consent import need_consent
from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import warn
from swarmd.operator.cli.send import asking, report, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.targets import Targets
from swarmd.operator.verbs.stop import ask, words


@click.command()
@takes_targets(is_required=False)
@common_options
def stop(options: CommonOptions, targets: Targets) -> None:
    """Stop TARGETS, or all robots; they need a `run` to move again."""
    with options.operator(needs_file=False) as operator:
        report(options, ask.send_stop(session_of(options, operator), "stop", targets))


@click.command()
@takes_targets(is_required=False)
@click.option("--reason", default="", help="Kept with the latch, and shown by `describe`.")
@click.option(
    "--until-all",
    is_flag=True,
    help="Go on until every expected robot has acknowledged; Ctrl-C ends it with what was reached.",
)
@common_options
def estop(options: CommonOptions, targets: Targets, reason: str, until_all: bool) -> None:
    """Emergency-stop TARGETS, or all robots, without confirmation.

    The stop is latched: it survives restarts, and robots that join adopt a stop of the whole
    swarm, until `swarmctl reset`.
    """
    with options.operator(needs_file=False) as operator:
        session = session_of(options, operator)
        report(options, ask.send_stop(session, "estop", targets, reason, until_all=until_all))


@click.command()
@takes_targets(is_required=True)
@click.option("--reason", default="", help="Why it is safe again; shown by `describe`.")
@click.option(
    "--findings",
    is_flag=True,
    help="Also end the findings of the assumption monitor; the robots then drive at full speed"
    " again.",
)
@click.option(
    "-y",
    "--yes",
    is_flag=True,
    help="Do not ask before more than one robot is reset; required without a terminal.",
)
@common_options
def reset(
    options: CommonOptions, targets: Targets, reason: str, *, findings: bool, yes: bool
) -> None:
    """Clear emergency stops and faults of TARGETS, which become idle; moves nothing.

    Clears only the emergency stops that swarmctl sees now; a later emergency stop stays. With
    --findings also ends the findings that swarmctl sees now.
    """
    with asking(options, targets, needs_status=True) as asked:
        # A latch is an emergency stop that lasts until a reset. `latches`: those that the robots
        # reported just now, by id; the request names these ids, so a later latch stays.
        robots = asked.names
        latches = asked.view.latches(robots)
        for latch_id, latch in latches.items():
            warn(words.clears(latch_id, latch))
        for robot, finding in ask.findings_of(asked.view, robots):
            warn(words.of_finding(robot, finding, is_ended=findings))
        if len(robots) > 1 and not yes:
            question = f"Reset {', '.join(robots)}?"
            to_check = "all of them may move again"
            need_consent(f"reset of {len(robots)} robots", to_check, question)
        asked.report(ask.reset(asked.targeted, reason=reason, findings=findings))

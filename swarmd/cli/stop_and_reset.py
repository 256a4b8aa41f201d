"""The verbs that stop robots and let them move again: `swarmctl stop`, `estop` and `reset`."""

from __future__ import annotations

from collections.abc import Iterable

import click

from swarmd.cli.consent import need_consent
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn
from swarmd.cli.send import asking, send_stop
from swarmd.cli.targets import Targets, takes_targets
from swarmd.core.verbs import ResetRequest
from swarmd.network.operator.members_view import MembersView


@click.command()
@takes_targets(is_required=False)
@common_options
def stop(options: CommonOptions, targets: Targets) -> None:
    """Stop TARGETS, or all robots; they need a `run` to move again."""
    send_stop(options, "stop", targets)


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
    send_stop(options, "estop", targets, reason, until_all=until_all)


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

    Clears only the emergency stops that swarmctl sees now; a later one stays. --findings ends only
    the findings that swarmctl sees now.
    """
    with asking(options, targets, needs_status=True) as asked:
        names, latches = asked.names, asked.view.latches(asked.names)
        for latch_id, latch in latches.items():
            text = f" ({latch.reason})" if latch.reason else ""
            of = "all robots" if latch.scope == "swarm" else "named robots"
            warn(f"clears emergency stop {latch_id} of {latch.issuer} for {of}{text}")
        found = _findings(asked.view, names)
        for robot, text in found:
            warn(f"{robot}: {'ends' if findings else 'keeps (--findings ends it)'}: {text}")
        if len(names) > 1 and not yes:
            question, to_check = f"Reset {', '.join(names)}?", "all of them may move again"
            need_consent(f"reset of {len(names)} robots", to_check, question)
        ids = tuple(sorted(latches))
        ended = tuple(dict.fromkeys(text for _, text in found)) if findings else ()
        asked.report(asked.request(ResetRequest, ids=ids, findings=ended, reason=reason))


def _findings(view: MembersView, names: Iterable[str]) -> list[tuple[str, str]]:
    """The findings of the assumption monitors, each with its robot."""
    statuses = ((name, view.members[name].status) for name in names if name in view.members)
    return [(name, text) for name, status in statuses if status for text in status.findings]

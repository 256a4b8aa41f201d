"""`swarmctl incidents`: lists, fetches and marks the incidents of which robots keep the minute."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import FOLDER, CommonOptions, Failure, VerbGroup, common_options
from swarmd.cli.output import line_width, print_json, print_table, warn
from swarmd.cli.record import fetch_files
from swarmd.cli.send import asking, session_of
from swarmd.cli.targets import takes_targets
from swarmd.client.incidents import Incidents, SwarmIncident, ask_incidents
from swarmd.client.targets import Targets
from swarmd.core.bounds import MAX_REASON
from swarmd.core.verbs import KeptIncident, MarkRequest, RecordingFile, shortened
from swarmd.network.operator.exit_codes import NO_TARGET
from swarmd.plugins import need
from swarmd.texts.values import NOTHING, counted, megabytes, seconds

if TYPE_CHECKING:
    from swarmd.network.operator.operator import Operator

HEADER = ("INCIDENT", "WHEN", "ROBOT", "KIND", "KEPT BY", "SECONDS", "SIZE", "MISSING", "WHY")


@click.group(cls=VerbGroup, invoke_without_command=True)
@common_options
def incidents(options: CommonOptions) -> None:
    """List incidents: what went wrong on a robot, and which robots keep their last minute of it.

    Each robot keeps its last minute in memory, and writes it to its disk when an incident begins on
    any robot. SECONDS: from how long before the incident to how long after it; `awaited`: the robot
    writes its file 10 s after the incident.
    """
    if click.get_current_context().invoked_subcommand is not None:
        return
    with options.operator() as operator:
        found = _asked(options, operator)
        if options.is_json:
            print_json("Incidents", found.as_json())
        else:
            rows = [row for one in found.incidents for row in _rows(one)]
            print_table(HEADER, rows, width=line_width())
            click.echo(counted(len(found.incidents), "incident"))
        click.get_current_context().exit(found.exit_code)


@incidents.command(epilog="Example: swarmctl incidents fetch 3fa2 -d crash")
@click.argument("incident", metavar="ID")
@click.option(
    "-d",
    "--folder",
    type=FOLDER,
    help="Where to copy to; a folder for each robot is made in it [incidents/ID].",
)
@common_options
def fetch(options: CommonOptions, incident: str, folder: Path | None) -> None:
    """Copy what robots keep of the incident ID, or of the one whose id begins so, to this machine.

    Each copy becomes a recording beside it, for `swarmctl replay FOLDER`. A fetch that was
    interrupted continues where it ended.
    """
    need("mcap", "rosbags", extra="record")
    from swarmd.recording.fetch import INCIDENT

    with options.operator() as operator:
        found = _asked(options, operator)
        chosen = _chosen(found, incident)
        id = chosen.incident.id
        files = {
            robot: (
                RecordingFile(
                    name=f"{id}{INCIDENT.suffix}", size=one.size, is_open=False, crc=one.crc
                ),
            )
            for robot, one in chosen.kept.items()
            if one.size
        }
        if awaited := sorted(chosen.kept.keys() - files.keys()):
            warn(f"no file so far: {shortened(', '.join(awaited))}; fetch again in 10 s")
        failed = [*found.missing, *awaited]
        fetch_files(options, operator, files, failed, folder or Path("incidents", id), INCIDENT)


@incidents.command(epilog="Example: swarmctl incident mark 'it hit the chair'")
@click.argument("words")
@takes_targets(is_required=False)
@common_options
def mark(options: CommonOptions, targets: Targets, words: str) -> None:
    """Begin an incident with these WORDS: TARGETS, or all robots, keep their last minute.

    It moves nothing.
    """
    if not words.strip() or len(words) > MAX_REASON:
        wanted = f"WORDS have {len(words)} characters; expected 1 to {MAX_REASON}"
        raise click.UsageError(f"{wanted}, such as 'it hit the chair'")
    id = secrets.token_hex(6)
    with asking(options, targets, needs_status=False) as asked:
        outcome = asked.targeted.request(MarkRequest, words=words, incident=id)
        if outcome.applied:
            warn(f"incident {id}; after 10 s: swarmctl incidents fetch {id}")
        asked.report(outcome, {"incident": id})


def _asked(options: CommonOptions, operator: Operator) -> Incidents:
    """The incidents of all robots; warns of robots that keep nothing or did not answer."""
    found = ask_incidents(session_of(options, operator))
    for robot, fault in found.faults.items():
        warn(f"{robot}: {fault}")
    if found.missing:
        warn(f"no answer: {', '.join(found.missing)}")
    return found


def _chosen(found: Incidents, prefix: str) -> SwarmIncident:
    """The incident whose id begins with `prefix`; Failure if there is none, or another."""
    matching = [one for one in found.incidents if one.incident.id.startswith(prefix)]
    if not matching:
        raise Failure(f"no robot keeps an incident {prefix}; see `swarmctl incidents`", NO_TARGET)
    if len(matching) > 1:
        ids = ", ".join(one.incident.id for one in matching)
        raise click.UsageError(f"{prefix} begins {len(matching)} ids ({ids}); type more of it")
    return matching[0]


def _rows(one: SwarmIncident) -> list[tuple[str, ...]]:
    """A row for each robot that keeps the incident."""
    incident = one.incident
    robot_text = incident.robot if len(one.robots) == 1 else counted(len(one.robots), "robot")
    when = NOTHING if one.age is None else f"{seconds(one.age)} ago"
    return [
        (
            incident.id, when, robot_text, incident.kind, robot, _span(kept),
            megabytes(kept.size, 2) if kept.size else NOTHING,
            shortened(kept.missing) or NOTHING, incident.text,
        )
        for robot, kept in one.kept.items()
    ]  # fmt: skip


def _span(kept: KeptIncident) -> str:
    """The seconds of a file, from before the incident to after it."""
    is_known = kept.begin is not None and kept.end is not None
    return f"{kept.begin:+.0f} to {kept.end:+.0f}" if is_known else "awaited"

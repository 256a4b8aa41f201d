"""`swarmctl incidents`: lists, shows, fetches and marks what went wrong on robots."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.bounds import MAX_REASON
from swarmd.core.verbs import KeptIncident, MarkRequest, RecordingFile, shortened
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import FOLDER, CommonOptions, Failure, VerbGroup, common_options
from swarmd.operator.cli.output import line_width, print_json, print_table, warn
from swarmd.operator.cli.record import fetch_files
from swarmd.operator.cli.send import asking, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.client.incidents import (
    Account,
    Incidents,
    SwarmIncident,
    ask_incidents,
    mark_fields,
)
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.values import NOTHING, counted, megabytes, printable, seconds
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator

HEADER = ("INCIDENT", "WHEN", "ROBOT", "KIND", "KEPT BY", "WHY")
DETAILS = ("KEPT BY", "SECONDS", "SIZE", "MISSING", "TOLD BY", "ROBOT", "KIND", "WHY")


class _IncidentGroup(VerbGroup):
    """The verbs; a first word that is none names a robot or an incident, as of `show`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The verb, else `show` with all words."""
        if args[0].startswith("-") or self.get_command(ctx, args[0]) is not None:
            return super().resolve_command(ctx, args)
        return "show", self.get_command(ctx, "show"), args


@click.group(cls=_IncidentGroup, invoke_without_command=True)
@common_options
def incidents(options: CommonOptions) -> None:
    """List incidents: what went wrong on a robot, and which robots keep their last minute of it.

    Each robot keeps its last minute in memory, and writes it to its disk when an incident begins on
    any robot. `swarmctl incidents tb3-02` lists those of a robot, `swarmctl incidents 3fa2` shows
    what each robot keeps of the one whose id begins so. The newest is the last. A row `as tb3-05
    says` has words of a robot that contradict those of the others.
    """
    if click.get_current_context().invoked_subcommand is None:
        _show(options, ())


@incidents.command(epilog="Example: swarmctl incidents show tb3-02")
@click.argument("words", nargs=-1, metavar="[TARGET|ID]...", shell_complete=completion.robots)
@common_options
def show(options: CommonOptions, words: tuple[str, ...]) -> None:
    """List the incidents of robots, or show what each robot keeps of an incident.

    TARGET: a name or a glob such as 'tb3-*'. ID: an id, or its beginning. SECONDS: from how long
    before the incident to how long after it; `awaited`: the robot writes its file 10 s after the
    incident.
    """
    _show(options, words)


def _show(options: CommonOptions, words: Sequence[str]) -> None:
    with options.operator() as operator:
        found = _asked(options, operator)
        chosen, is_by_id = _named(found, words)
        if options.is_json:
            print_json("Incidents", found._replace(incidents=chosen).as_json())
        elif is_by_id and len(chosen) == 1:
            _print_details(chosen[0])
        else:
            rows = [row for one in chosen for row in _rows(one, found)]
            print_table(HEADER, rows, width=line_width())
            click.echo(counted(len(chosen), "incident"))
        click.get_current_context().exit(found.exit_code)


def _named(found: Incidents, words: Sequence[str]) -> tuple[tuple[SwarmIncident, ...], bool]:
    """The incidents that words name, all without a word; True if only ids name them.

    Failure if a word names neither a robot nor an incident. A word that is a robot is no id.
    """
    had = {robot for one in found.incidents for robot in one.robots}
    robots = had.union(found.answered, found.missing)
    ids: set[str] = set()
    named: set[str] = set()
    for word in words:
        matching = {robot for robot in robots if fnmatchcase(robot, word)}
        begun = {one.incident.id for one in found.incidents if one.incident.id.startswith(word)}
        if not matching and not begun:
            raise Failure(
                f"{word!r} is no robot that is there, and no incident that a robot keeps; see"
                " `swarmctl incidents`, and `swarmctl incidents --help` for its verbs",
                NO_TARGET,
            )
        named |= matching
        ids |= set() if matching else begun
    chosen = tuple(
        one
        for one in found.incidents
        if not words or one.incident.id in ids or named.intersection(one.robots)
    )
    return chosen, bool(words) and not named


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
    from swarmd.daemon.recording.fetch import INCIDENT

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
        fields = mark_fields(asked.targeted.operator, words, id)
        outcome = asked.targeted.request(MarkRequest, **fields)
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


def _rows(one: SwarmIncident, found: Incidents) -> list[tuple[str, ...]]:
    """The row of an incident, and one for each account that contradicts it."""
    when = NOTHING if one.age is None else f"{seconds(one.age)} ago"
    rows = [_row(one, account, when) for account in one.accounts]
    first = rows[0]
    expected = (*found.answered, one.incident.robot)
    return [(*first[:4], _kept_by(one, expected), first[-1]), *rows[1:]]


def _row(one: SwarmIncident, account: Account, when: str) -> tuple[str, ...]:
    incident = account.incident
    return one.incident.id, when, _had_by(account), incident.kind, _says(account), incident.text


def _had_by(account: Account) -> str:
    """The robot that had the incident, or how many had it."""
    robots = account.robots
    return robots[0] if len(robots) == 1 else counted(len(robots), "robot")


def _says(account: Account) -> str:
    """Whose words these are."""
    verb = "says" if len(account.tellers) == 1 else "say"
    return f"as {shortened(', '.join(account.tellers))} {verb}"


def _kept_by(one: SwarmIncident, expected: Sequence[str]) -> str:
    """Which robots keep their minute, of those of the swarm: `6 of 7, not tb3-02`."""
    keepers = [robot for robot, kept in one.kept.items() if kept.size]
    awaited = [robot for robot, kept in one.kept.items() if not kept.size]
    others = sorted(set(expected) - one.kept.keys())
    count = len(keepers) + len(awaited) + len(others)
    text = f"all {count}" if len(keepers) == count else f"{len(keepers)} of {count}"
    if others and len(keepers) < len(others):
        text += f": {shortened(', '.join(keepers))}" if keepers else ""
    elif others:
        text += f", not {shortened(', '.join(others))}"
    return text + (f", {len(awaited)} awaited" if awaited else "")


def _print_details(one: SwarmIncident) -> None:
    """What each robot keeps of an incident, and its own words."""
    when = "" if one.age is None else f", {seconds(one.age)} ago"
    for account in one.accounts:
        incident = account.incident
        head = f"{incident.id} {incident.kind} of {_had_by(account)}{when}"
        click.echo(printable(f"{head}, {_says(account)}: {incident.text}"))
    rows = []
    for robot, kept in one.kept.items():
        told = kept.incident
        through = f" through {kept.source}" if kept.source else ""
        by = f"{told.by}{through}" if not kept.operator else f"{told.by}{through}, {kept.operator}"
        rows.append(
            (
                robot, _span(kept), megabytes(kept.size, 2) if kept.size else NOTHING,
                shortened(kept.missing) or NOTHING, by, told.robot, told.kind, told.text,
            )
        )  # fmt: skip
    print_table(DETAILS, rows, width=line_width())


def _span(kept: KeptIncident) -> str:
    """The seconds of a file, from before the incident to after it."""
    is_known = kept.begin is not None and kept.end is not None
    return f"{kept.begin:+.0f} to {kept.end:+.0f}" if is_known else "awaited"

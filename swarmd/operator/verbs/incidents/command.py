"""`swarmctl incidents`: lists, shows, fetches and marks what went wrong on robots."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError
from swarmd.operator.cli import completion
from swarmd.operator.cli.fetched import print_fetched, tell_bytes
from swarmd.operator.cli.options import FOLDER, CommonOptions, Failure, VerbGroup, common_options
from swarmd.operator.cli.output import line_width, print_json, print_table, warn
from swarmd.operator.cli.send import asking, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.values import counted, printable
from swarmd.operator.verbs.incidents.ask import (
    Incidents,
    SwarmIncident,
    ask_incidents,
    check_mark,
    incident_named,
)
from swarmd.operator.verbs.incidents.ask import fetch as ask_fetch
from swarmd.operator.verbs.incidents.ask import mark as ask_mark
from swarmd.operator.verbs.incidents.words import DETAILS, HEADER, detail_rows, heads_of, rows_of
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.operator.session.session import Session


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

    Each robot keeps its last minute in RAM, and writes it to its disk when an incident begins on
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
        found = _asked(session_of(options, operator))
        chosen, is_by_id = _named(found, words)
        if options.is_json:
            print_json("Incidents", found._replace(incidents=chosen).as_json())
        elif is_by_id and len(chosen) == 1:
            for line in heads_of(chosen[0]):
                click.echo(printable(line))
            print_table(DETAILS, detail_rows(chosen[0]), width=line_width())
        else:
            rows = [row for one in chosen for row in rows_of(one, found)]
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
    with options.operator() as operator:
        session = session_of(options, operator)
        found = _asked(session)
        try:
            chosen = incident_named(found, incident)
        except ConfigError as error:
            raise click.UsageError(str(error)) from error
        print_fetched(options, ask_fetch(session, found, chosen, folder, tell_bytes))


@incidents.command(epilog="Example: swarmctl incident mark 'it hit the chair'")
@click.argument("words")
@takes_targets(is_required=False)
@common_options
def mark(options: CommonOptions, targets: Targets, words: str) -> None:
    """Begin an incident with these WORDS: TARGETS, or all robots, keep their last minute.

    It moves nothing.
    """
    try:
        check_mark(words)
    except ConfigError as error:
        raise click.UsageError(str(error)) from error
    with asking(options, targets, needs_status=False) as asked:
        outcome = ask_mark(asked.targeted, words)
        if outcome.applied:
            id = outcome.incident
            warn(f"incident {id}; after 10 s: swarmctl incidents fetch {id}")
        asked.report(outcome, {"incident": outcome.incident})


def _asked(session: Session) -> Incidents:
    """The incidents of all robots; warns of robots that keep nothing or did not answer."""
    found = ask_incidents(session)
    for robot, fault in found.faults.items():
        warn(f"{robot}: {fault}")
    if found.missing:
        warn(f"no answer: {', '.join(found.missing)}")
    return found

"""`swarmctl members` and `members forget`: the robots of the swarm; `describe`: one of them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click
from msgspec import to_builtins

from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import SwarmError
from swarmd.link.keys.key_permit import permit_text
from swarmd.link.keys.roster import Role
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import CommonOptions, VerbGroup, common_options
from swarmd.operator.cli.output import line_width, print_json, print_section, print_table
from swarmd.operator.cli.send import exit_code_of, known_members, report, session_of
from swarmd.operator.session.members_view import Dials
from swarmd.operator.session.targets import check_known
from swarmd.operator.texts.keys import (
    end_of_certificate,
    key_text,
    key_warnings,
    own_remedy,
    permit_warning,
)
from swarmd.operator.texts.values import printable
from swarmd.operator.texts.why import why
from swarmd.operator.verbs.members.words import (
    BY_DATAGRAMS,
    HEADER,
    WIDE,
    health,
    heard_row,
    row,
    wide_cells,
)

if TYPE_CHECKING:
    from swarmd.core.messages import Status
    from swarmd.link.keys.identity import Identity


@click.group(cls=VerbGroup, invoke_without_command=True)
@click.option(
    "-w",
    "--wide",
    is_flag=True,
    help="All columns, whole reports. To watch: `swarmctl view`.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="States by datagrams alone, without a link to each robot: for many robots.",
)
@common_options
def members(options: CommonOptions, wide: bool, quick: bool) -> None:
    """Print the robots of the swarm and their states.

    Failed robots stay listed until they return or `members forget NAME` removes them. REPORT is cut
    to the width of the terminal.
    """
    if click.get_current_context().invoked_subcommand is not None:
        return
    if wide and quick:
        raise click.UsageError("--wide needs the status of each robot, which --quick does not ask")
    with options.operator(needs_file=False) as operator:
        view = known_members(options, operator, dials=Dials.NONE if quick else Dials.UNTOLD)
        limits = (BY_DATAGRAMS,) if quick else ()
        notes = (*limits, *health(view), *_secured(operator.identity), *operator.trust_notes())
        listed = list(view.members.values())
        if options.is_json:
            content = {
                "members": [to_builtins(member) for member in listed],
                "roster": sorted(view.roster),
                "missing": list(view.missing),
                "programs": sorted(view.programs),
                "notes": list(notes),
                "asked_as": _asked_as(operator.identity),
            }
            print_json("Members", content)
        else:
            rows = [heard_row(member) if quick else row(member) for member in listed]
            if wide:  # further columns before the last column, REPORT
                wide_header = (*HEADER[:-1], *WIDE, HEADER[-1])
                wide_rows = [
                    (*cells[:-1], *wide_cells(member), cells[-1])
                    for cells, member in zip(rows, listed, strict=True)
                ]
                print_table(wide_header, wide_rows)
            else:
                print_table(HEADER, rows, width=line_width())
            for note in notes:
                click.echo(printable(f"# {note}"))
        click.get_current_context().exit(exit_code_of(view, view.expected))


@members.command()
@click.argument("name", shell_complete=completion.robots)
@common_options
def forget(options: CommonOptions, name: str) -> None:
    """Remove a robot that failed or left from the lists of all robots."""
    from swarmd.operator.verbs.members.ask import forget as remove  # looks do without

    with options.operator() as operator:
        view = known_members(options, operator, is_request_next=True)
        check_known(name, view.members, view.roster)
        report(options, remove(session_of(options, operator), view, name))


def _asked_as(identity: Identity | None) -> dict[str, str] | None:
    """The name, role and permit of the key with which a secured swarm was asked."""
    if identity is None:
        return None
    asked_as = {"name": identity.name, "role": str(identity.role)}
    permit = identity.roster.permits.get(identity.name)
    return asked_as if permit is None else {**asked_as, "may": permit_text(permit)}


def _secured(identity: Identity | None) -> Iterator[str]:
    """The keys with which a secured swarm was asked, and a warning if they end soon."""
    if identity is not None:
        roster = identity.roster
        yield f"secured: asked as {key_text(identity)}, roster {roster.generation}"
        if identity.role is Role.PERMIT:
            if text := permit_warning(identity, time.time()):
                yield f"WARNING: {identity.name} (this user): {text}"
            return
        if text := end_of_certificate(identity.info.expires, time.time()):
            remedy = own_remedy(identity.name) if time.time() >= FIRST_WALL else "set it"
            yield f"WARNING: {text}: {identity.name} (this user); {remedy}"


def _described(status: Status) -> Mapping[str, Any]:
    """The robot's pattern as this machine describes it; empty if this machine cannot."""
    from swarmd.operator.cli.plugin_check import describe_patterns  # `members` does without
    from swarmd.plugins import pattern_names

    if status.pattern is None or status.pattern not in pattern_names(None):
        return {}
    try:
        (row,) = describe_patterns((status.pattern,), None, status.platform)
    except SwarmError:  # such as a platform of another machine: units are left out
        return {}
    return row


@click.command()
@click.argument("robot", shell_complete=completion.robots)
@common_options
def describe(options: CommonOptions, robot: str) -> None:
    """Print the whole status of ROBOT, and why it does not move."""
    from swarmd.operator.texts.status import sections_with_events  # `members` does without

    with options.operator() as operator:
        view = known_members(options, operator, dials=Dials.UNTOLD)
        check_known(robot, view.members, view.roster)
        member = view.members[robot]
        if options.is_json:
            content = {
                "member": to_builtins(member),
                "why": why(member),
                "asked_as": _asked_as(operator.identity),
            }
            print_json("Member", content)
        else:
            click.echo(printable(f"{robot}: {why(member)}"))
            if member.status is not None:
                for note in key_warnings([member.status], time.time()):
                    click.echo(note)
                if operator.identity is not None:
                    click.echo(printable(f"asked as {key_text(operator.identity)}"))
                for title, rows in sections_with_events(
                    member, member.status, _described(member.status)
                ):
                    print_section(title, rows)
        click.get_current_context().exit(exit_code_of(view, [robot]))

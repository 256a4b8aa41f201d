"""`swarmctl members` and `members forget`: the robots of the swarm; `describe`: one of them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import click
from msgspec import to_builtins

from swarmd.cli import completion
from swarmd.cli.options import CommonOptions, VerbGroup, common_options
from swarmd.cli.output import print_json, print_section, print_table, terminal_width
from swarmd.cli.send import exit_code_of, known_members, report, session_of
from swarmd.client.changes import forget as remove
from swarmd.client.targets import check_known
from swarmd.core import codec
from swarmd.core.clock import FIRST_WALL
from swarmd.core.goal import GoalState
from swarmd.core.messages import Presence, State, Status
from swarmd.network.operator.members_view import Contact, SeenMember
from swarmd.texts.keys import end_of_certificate, key_warnings, own_remedy
from swarmd.texts.status import sections
from swarmd.texts.values import NOTHING, number, printable, seconds
from swarmd.texts.why import activity, why

if TYPE_CHECKING:
    from swarmd.core.values import Scalar
    from swarmd.network.operator.members_view import MembersView
    from swarmd.security.identity import Identity

HEADER = ("NAME", "STATE", "REASON", "PATTERN", "PROTECTION", "SEEN", "REPORT")
WIDE = ("GEN", "SCAN", "LOOP99", "VERSION", "LABELS", "GOAL")
_NOW = 1.0  # figures that are newer than this are `now`, in s


@click.group(cls=VerbGroup, invoke_without_command=True)
@click.option("-w", "--wide", is_flag=True, help="Show all columns, whole reports, too.")
@common_options
def members(options: CommonOptions, wide: bool) -> None:
    """Print the robots of the swarm and their states.

    Failed robots stay listed until they return or `members forget NAME` removes them. REPORT is cut
    to the width of the terminal.
    """
    if click.get_current_context().invoked_subcommand is not None:
        return
    with options.operator() as operator:
        view = known_members(options, operator)
        notes = (*health(view), *_secured(operator.identity), *operator.trust_notes())
        if options.is_json:
            found = [to_builtins(member) for member in view.members.values()]
            content = {"roster": sorted(view.roster), "missing": list(view.missing)}
            print_json("Members", {"members": found, **content, "notes": list(notes)})
        else:
            seen = view.members.values()
            if wide:
                rows = [(*row(one)[:-1], *wide_cells(one), row(one)[-1]) for one in seen]
                print_table((*HEADER[:-1], *WIDE, HEADER[-1]), rows)
            else:
                print_table(HEADER, [*map(row, seen)], width=terminal_width())
            for note in notes:
                click.echo(printable(f"# {note}"))
        click.get_current_context().exit(exit_code_of(view, view.expected))


@members.command()
@click.argument("name", shell_complete=completion.robots)
@common_options
def forget(options: CommonOptions, name: str) -> None:
    """Remove a robot that failed or left from the lists of all robots."""
    with options.operator() as operator:
        view = known_members(options, operator, is_request_next=True)
        check_known(name, view.members)
        report(options, remove(session_of(options, operator), view, name))


def _secured(identity: Identity | None) -> Iterator[str]:
    """With which keys a secured swarm was asked, and whether they end soon."""
    if identity is not None:
        roster = identity.roster
        yield f"secured: asked as {identity.name} ({identity.role}), roster {roster.generation}"
        if text := end_of_certificate(identity.info.expires, time.time()):
            remedy = own_remedy(identity.name) if time.time() >= FIRST_WALL else "set it"
            yield f"WARNING: {text}: {identity.name} (this user); {remedy}"


def row(member: SeenMember) -> tuple[str, ...]:
    """The line of a member."""
    status, header = member.status, member.header
    if member.contact is Contact.ANSWERED and status is not None:
        return (
            member.robot,
            status.state,
            status.reason or NOTHING,
            status.pattern or NOTHING,
            activity(status.decision),
            _seen(member),
            _report(status.report if status.state is State.RUNNING else {}),
        )
    states = {
        Contact.GONE: member.presence.value,
        Contact.OTHER_VERSION: member.state or "other version",
    }
    return (
        member.robot,
        states.get(member.contact, member.contact.value),
        (header.reason if header else None) or NOTHING,
        (header.pattern if header else None) or NOTHING,
        NOTHING,
        _seen(member),
        NOTHING,
    )


def wide_cells(member: SeenMember) -> tuple[str, ...]:
    """The cells of a member below WIDE; the goal with what it does about it."""
    status = member.status
    if status is None or member.contact is not Contact.ANSWERED:
        return *(NOTHING,) * 3, member.version or NOTHING, NOTHING, NOTHING
    goal = status.goal
    own = goal.own if goal is not None else None
    text = NOTHING if own is None or goal is None else f"{own.goal.text} ({goal.state})"
    return (
        str(status.generation),
        f"{status.health.scan_rate:.1f} Hz",
        seconds(status.health.loop_p99),
        status.version or NOTHING,
        " ".join(status.labels) or NOTHING,
        text,
    )


def health(view: MembersView) -> Iterator[str]:
    """The count of living robots, then a line for each problem."""
    members, alive = view.members, [view.members[name] for name in view.alive]
    yield f"{len(alive)}/{len(members.keys() | view.roster)} alive"
    for presence in (Presence.FAILED, Presence.LEFT):
        gone = [m for m in members.values() if m.presence is presence]
        if gone:
            yield f"{presence}: " + ", ".join(f"{m.robot} ({seconds(m.age)} ago)" for m in gone)
    silent = [m for m in alive if m.contact is Contact.NO_ANSWER]
    if silent:
        heard = (f"{m.robot} (heard {seconds(m.age)} ago, {m.state})" for m in silent)
        yield f"alive, but no answer: {', '.join(heard)}"
    distant = [m for m in alive if m.contact is Contact.UNREACHABLE]
    if distant:
        words = (f"{m.robot} (alive by {m.by}'s word, {seconds(m.age)} ago)" for m in distant)
        yield f"not reachable from here: {', '.join(words)}"
    for m in alive:
        if m.contact is Contact.OTHER_VERSION:
            yield f"other version: {m.robot} speaks {m.wire}, this swarmctl {codec.VERSION}"
    if view.absent:
        yield f"in the roster and never seen: {', '.join(view.absent)}"
    if view.duplicates:
        yield f"two daemons have one id: {', '.join(sorted(view.duplicates))}; stop one of each"
    statuses = [m.status for m in alive if m.status is not None]
    down = ((s.robot, s.health.driver or s.driver) for s in statuses if not s.health.driver_up)
    for text, names in _by_text(down).items():
        yield f"driver lost: {', '.join(names)} ({text})"
    for text, names in _by_text((s.robot, s.health.storage) for s in statuses).items():
        yield f"an emergency stop would not outlive a restart: {', '.join(names)} ({text})"
    yield from incompatible(statuses)
    yield from offered(statuses)
    yield from key_warnings(statuses, time.time())
    if open_to_all := [s.robot for s in statuses if s.profile != "dev" and not s.is_secured]:
        unsafe = ", ".join(open_to_all)
        yield f"WARNING: insecure: anyone on this network can drive {unsafe}"


def _by_text(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """The robots of each text; those without a text are left out."""
    found: dict[str, list[str]] = {}
    for robot, text in pairs:
        if text:
            found.setdefault(text, []).append(robot)
    return found


def offered(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each goal that robots were offered."""
    waiting: dict[tuple[str, str], list[str]] = {}
    latched = set[str]()
    for status in statuses:
        goal = status.goal
        if status.state in (State.ESTOPPED, State.FAULTED):
            latched.add(status.robot)
        if goal is not None and goal.own is not None and goal.state is GoalState.OFFERED:
            own = goal.own.goal
            until = "" if own.lease is None else f" while {own.issuer} is heard"
            waiting.setdefault((own.text, until), []).append(status.robot)
    for (text, until), names in waiting.items():
        line = f"offered {text}: {', '.join(names)}; swarmctl resume {' '.join(names)}{until}"
        held = [name for name in names if name in latched]
        yield f"{line}; first reset {', '.join(held)}" if held else line


def incompatible(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each kind of peer that robots may not see, or that is faster than they assume."""
    pairs: dict[tuple[bool, str], tuple[list[str], list[str]]] = {}
    for status in statuses:
        for found in status.peers:
            own, peers = pairs.setdefault((found.holds, found.text), ([], []))
            own.extend([status.robot] * (status.robot not in own))
            peers.extend([found.robot] * (found.robot not in peers))
    for (holds, text), (own, peers) in pairs.items():
        yield f"{', '.join(own)} {'held by' if holds else 'beside'} {', '.join(peers)}: {text}"


def _report(report: Mapping[str, Scalar]) -> str:
    """The report of the pattern."""
    return ", ".join(f"{name} {number(value)}" for name, value in report.items()) or NOTHING


def _seen(member: SeenMember) -> str:
    if member.contact is Contact.UNREACHABLE:
        return f"{seconds(member.age)} ago by {member.by}"
    if member.presence is Presence.ALIVE and member.age < _NOW:
        return "now" if member.contact is not Contact.NO_ANSWER else f"{seconds(member.age)} ago"
    return f"{seconds(member.age)} ago"


@click.command()
@click.argument("robot", shell_complete=completion.robots)
@common_options
def describe(options: CommonOptions, robot: str) -> None:
    """Print the whole status of ROBOT, and why it does not move."""
    with options.operator() as operator:
        view = known_members(options, operator)
        check_known(robot, view.members)
        member = view.members[robot]
        if options.is_json:
            print_json("Member", {"member": to_builtins(member), "why": why(member)})
        else:
            click.echo(printable(f"{robot}: {why(member)}"))
            if member.status is not None:
                for note in key_warnings([member.status], time.time()):
                    click.echo(note)
                for title, rows in sections(member, member.status):
                    print_section(title, rows)
        click.get_current_context().exit(exit_code_of(view, [robot]))

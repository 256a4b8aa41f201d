"""`swarmctl members`: the robots of the swarm and their states; `members forget` removes one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import click
from msgspec import to_builtins

from swarmd.cli.arguments import Failure, check_known
from swarmd.cli.explain import activity
from swarmd.cli.options import CommonOptions, VerbGroup, common_options
from swarmd.cli.output import NOTHING, number, print_json, print_table, printable, seconds
from swarmd.cli.send import known_members, report
from swarmd.core.messages import ForgetRequest, Member, Presence, State
from swarmd.network.outcome import REFUSED

if TYPE_CHECKING:
    from swarmd.core.values import Scalar
    from swarmd.network.discovery import MembersView

HEADER = (
    *("NAME", "STATE", "REASON", "PATTERN", "GEN", "PROTECTION", "SCAN", "LOOP99", "SEEN"),
    "REPORT",
)
_MAX_REPORT = 60


@click.group(cls=VerbGroup, invoke_without_command=True)
@common_options
def members(options: CommonOptions) -> None:
    """Print the robots of the swarm and their states.

    Failed robots stay listed until they return or `members forget NAME` removes them.
    """
    if click.get_current_context().invoked_subcommand is not None:
        return
    with options.operator() as operator:
        view = known_members(operator, options.timeout)
    notes = tuple(health(view))
    if options.is_json:
        rows = [to_builtins(member) for member in view.members.values()]
        roster = sorted(view.roster)
        print_json("Members", {"members": rows, "roster": roster, "notes": list(notes)})
        return
    print_table(HEADER, [row(member) for member in view.members.values()])
    for note in notes:
        click.echo(printable(f"# {note}"))


@members.command()
@click.argument("name")
@common_options
def forget(options: CommonOptions, name: str) -> None:
    """Remove a robot that failed or left from the lists of all robots."""
    with options.operator() as operator:
        view = known_members(operator, options.timeout)
        check_known(name, view.members)
        if view.members[name].presence is Presence.ALIVE:
            text = f"{name} is alive; only robots that failed or left can be forgotten"
            raise Failure(text, REFUSED)
        outcome = operator.request(ForgetRequest, view.epochs(view.alive), name=name)
    report(options, outcome)


def row(member: Member) -> tuple[str, ...]:
    """The line of a member; if it is not alive, its last pattern is marked `?`."""
    status = member.status
    if member.presence is not Presence.ALIVE:
        pattern = f"{status.pattern}?" if status is not None and status.pattern else NOTHING
        dashes = (NOTHING,) * 4
        return (member.robot, member.presence, NOTHING, pattern, *dashes, _seen(member), NOTHING)
    if status is None:
        return (member.robot, "no answer", *(NOTHING,) * 6, _seen(member), NOTHING)
    return (
        member.robot,
        status.state,
        status.reason or NOTHING,
        status.pattern or NOTHING,
        str(status.generation),
        activity(status.decision),
        f"{status.health.scan_rate:.1f} Hz",
        seconds(status.health.loop_p99),
        _seen(member),
        _report(status.report if status.state is State.RUNNING else {}),
    )


def health(view: MembersView) -> Iterator[str]:
    """The count of living robots, then a line for each problem."""
    members, alive = view.members, [view.members[name] for name in view.alive]
    yield f"{len(alive)}/{len(members.keys() | view.roster)} alive"
    for presence in (Presence.FAILED, Presence.LEFT):
        gone = [m for m in members.values() if m.presence is presence]
        if gone:
            yield f"{presence}: " + ", ".join(f"{m.robot} ({seconds(m.age)} ago)" for m in gone)
    if view.silent:
        yield f"alive, but no answer: {', '.join(view.silent)}"
    if view.absent:
        yield f"in the roster and never seen: {', '.join(view.absent)}"
    if view.duplicates:
        yield f"two daemons have one id: {', '.join(sorted(view.duplicates))}; stop one of each"
    statuses = [m.status for m in alive if m.status is not None]
    lost: dict[str, list[str]] = {}
    for status in statuses:
        if not status.health.driver_up:
            lost.setdefault(status.health.driver or status.driver, []).append(status.robot)
    for text, names in lost.items():
        yield f"driver lost: {', '.join(names)} ({text})"
    if any(s.profile == "field" and not s.is_secured for s in statuses):
        yield "WARNING: no certificates: anyone on this network can drive these robots"


def _report(report: Mapping[str, Scalar]) -> str:
    """The report of the pattern, cut to the width of its column."""
    text = ", ".join(f"{name} {number(value)}" for name, value in report.items()) or NOTHING
    return text if len(text) <= _MAX_REPORT else f"{text[: _MAX_REPORT - 3]}..."


def _seen(member: Member) -> str:
    return "now" if member.presence is Presence.ALIVE else f"{seconds(member.age)} ago"

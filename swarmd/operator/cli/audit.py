"""`swarmctl audit`: what operators asked of robots, from the audit logs that the robots keep."""

from __future__ import annotations

import time
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from swarmd.core.verbs import AUDIT, AUDIT_PAGE, AuditEntry, AuditQuery, AuditReply
from swarmd.operator.cli.ask_robots import ask_robots, end
from swarmd.operator.cli.options import CommonOptions, Duration, common_options
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.cli.send import known_members
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.session import in_reach
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator

MAX_ENTRIES = 10_000


class _Line(NamedTuple):
    """An entry of a robot's audit log.

    `at`: s since 1970 by this machine's clock; None if not known.
    """

    robot: str
    at: float | None
    entry: AuditEntry


@click.command()
@takes_targets(is_required=False)
@click.option("--since", type=Duration(), help="Only entries of this last time, such as 1h.")
@click.option(
    "-n",
    "--count",
    type=click.IntRange(1, MAX_ENTRIES),
    default=50,
    help="The last entries of each robot, at most [50].",
)
@common_options
def audit(options: CommonOptions, targets: Targets, since: float | None, count: int) -> None:
    """Print the requests to TARGETS, or to all robots: operators, requests and answers.

    Each robot keeps its audit log on its own disk, about 10000 entries. A robot sends the ages of
    entries, so a robot whose clock is wrong does not shift the printed times.
    """
    with options.operator() as operator:
        view = known_members(options, operator)
        names = robots_of(view, targets)
        lines, faults, answered = _read(options, operator, in_reach(view, names), since, count)
        if options.is_json:
            entries = [_record(line) for line in lines]
            missing = sorted(set(names) - answered)
            print_json("Audit", {"entries": entries, "faults": faults, "missing": missing})
        else:
            print_table(
                ("TIME", "ROBOT", "OPERATOR", "FROM", "WHAT", "RESULT"),
                [_row(line) for line in lines],
            )
        for robot, fault in faults.items():
            warn(f"{robot}: {fault}")
        end(names, answered)


def _read(
    options: CommonOptions,
    operator: Operator,
    names: tuple[str, ...],
    since: float | None,
    count: int,
) -> tuple[list[_Line], dict[str, str], set[str]]:
    """Query the audit logs of the robots `names`: the last `count` entries of each, at most.

    `since`: the greatest age of an entry in s, None for all entries. Returns the entries in the
    order of time, the faults by robot (entries that are missing, or a log that could not be
    written), and the robots that answered.
    """
    lines: list[_Line] = []
    faults: dict[str, str] = {}
    newest_page = AuditQuery(since=since, count=min(count, AUDIT_PAGE))
    replies = ask_robots(options, operator, names, AUDIT, newest_page)
    for robot, reply in replies.items():
        robot_lines, fault = _with_older(options, operator, robot, reply, since, count)
        lines += robot_lines
        if fault:
            faults[robot] = fault
    # Entries of unknown time come first: of an earlier boot, in which the clock was not set.
    lines.sort(key=lambda line: (line.at or 0.0, line.robot, line.entry.seq))
    return lines, faults, set(replies)


def _with_older(
    options: CommonOptions,
    operator: Operator,
    robot: str,
    newest: AuditReply,
    since: float | None,
    count: int,
) -> tuple[list[_Line], str]:
    """The last `count` entries of a robot, at most, oldest first; and a fault, empty without.

    `newest`: the newest page. A reply has at most AUDIT_PAGE entries, so older pages are queried.
    """
    reply = newest
    lines = _lines(newest)
    while len(lines) < count and reply.has_more and reply.entries:
        first_number = reply.entries[0].seq  # entries have serial numbers, oldest first
        page_size = min(count - len(lines), AUDIT_PAGE)
        query = AuditQuery(before=first_number, since=since, count=page_size)
        older_replies = ask_robots(options, operator, (robot,), AUDIT, query)
        if robot not in older_replies:
            missing = f"did not tell its entries before number {first_number}; ask again"
            return lines, reply.fault or missing
        reply = older_replies[robot]
        lines = _lines(reply) + lines
    return lines, reply.fault


def _lines(reply: AuditReply) -> list[_Line]:
    now = time.time()
    pairs = zip(reply.entries, reply.ages, strict=False)
    return [_Line(reply.robot, one.wall if age is None else now - age, one) for one, age in pairs]


def _row(line: _Line) -> tuple[str, ...]:
    entry = line.entry
    note = f" [{entry.left_out} before it left out]" if entry.left_out else ""
    result = f"{entry.result}: {entry.text}" if entry.text else entry.result
    operator = f"{entry.operator} ({entry.permit})" if entry.permit else entry.operator
    return (_time(line.at), line.robot, operator, entry.source, entry.what, result + note)


def _time(at: float | None) -> str:
    if at is None:
        return NOTHING
    shown = datetime.fromtimestamp(at)
    now = datetime.now()
    return f"{shown:%H:%M:%S}" if shown.date() == now.date() else f"{shown:%Y-%m-%d %H:%M:%S}"


def _record(line: _Line) -> dict[str, Any]:
    entry = line.entry
    at = line.at
    moment = None if at is None else datetime.fromtimestamp(at).astimezone()
    return {
        "robot": line.robot,
        "time": None if moment is None else moment.isoformat(timespec="milliseconds"),
        "operator": entry.operator,
        "from": entry.source,
        "permit": entry.permit,
        **fields(entry, "verb", "targets", "what", "result", "text", "left_out", "seq"),
    }

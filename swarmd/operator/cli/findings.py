"""Prints findings: those of `swarmctl doctor` and of `swarmd --check` are rows of one table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import click

from swarmd.core.finding import Finding, Level
from swarmd.operator.cli.output import print_table
from swarmd.operator.texts.doctor import worst
from swarmd.operator.texts.values import counted

HERE = "this machine"
_ORDER = (Level.FAULT, Level.WARNING, Level.UNKNOWN, Level.OK)
_HEADER = ("LEVEL", "WHERE", "WHAT", "FINDING, AND WHAT TO DO")


class Line(NamedTuple):
    """A finding about a robot, or about this machine."""

    where: str
    finding: Finding


def print_findings(lines: Sequence[Line], *, only_problems: bool = False) -> None:
    """Print a table and a count; without the column WHERE if all is about this machine."""
    rows: list[tuple[str, ...]] = [_HEADER, *rows_of(lines, only_problems=only_problems)]
    if {line.where for line in lines} == {HERE}:
        rows = [(row[0], *row[2:]) for row in rows]
    print_table(rows[0], rows[1:])
    count = {level: sum(line.finding.level is level for line in lines) for level in Level}
    faults, warnings = (counted(count[level], level) for level in (Level.FAULT, Level.WARNING))
    click.echo(f"{len(lines)} checked: {faults}, {warnings}, {count[Level.UNKNOWN]} not known")


def exit_code_of(lines: Sequence[Line]) -> int:
    """1 with a fault, else 0: a warning is no fault, nor is what could not be measured."""
    return int(worst(line.finding for line in lines) is Level.FAULT)


def rows_of(lines: Sequence[Line], *, only_problems: bool) -> list[tuple[str, ...]]:
    """The cells below _HEADER, the worst first; equal findings of several robots are one row."""
    where_of: dict[Finding, list[str]] = {}
    for where, finding in lines:
        if not only_problems or finding.level is not Level.OK:
            where_of.setdefault(finding, []).append(where)
    everywhere = len({where for where, _ in lines} - {HERE})
    rows: list[tuple[str, ...]] = []
    for finding, places in sorted(where_of.items(), key=lambda item: _ORDER.index(item[0].level)):
        robots = [place for place in places if place != HERE]
        is_all = len(robots) == everywhere > 1
        names = [f"all {everywhere} robots"] if is_all else robots
        where = ", ".join([*([HERE] if HERE in places else []), *names])
        is_due = finding.remedy and not finding.is_well
        text = finding.text + (f"; {finding.remedy}" if is_due else "")
        rows.append((finding.level.value, where, finding.subject, text))
    return rows

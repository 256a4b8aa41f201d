"""The texts of incidents: their rows, and what each robot keeps of one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from swarmd.core.verbs import KeptIncident, shortened
from swarmd.operator.texts.values import NOTHING, counted, megabytes, seconds

if TYPE_CHECKING:
    from swarmd.operator.verbs.incidents.ask import Account, Incidents, SwarmIncident

HEADER = ("INCIDENT", "WHEN", "ROBOT", "KIND", "KEPT BY", "WHY")
"""The titles of `rows_of`."""
DETAILS = ("KEPT BY", "SECONDS", "SIZE", "MISSING", "TOLD BY", "ROBOT", "KIND", "WHY")
"""The titles of `detail_rows`."""


def rows_of(one: SwarmIncident, found: Incidents) -> list[tuple[str, ...]]:
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


def heads_of(one: SwarmIncident) -> Iterator[str]:
    """A line for each account of an incident."""
    when = "" if one.age is None else f", {seconds(one.age)} ago"
    for account in one.accounts:
        incident = account.incident
        head = f"{incident.id} {incident.kind} of {_had_by(account)}{when}"
        yield f"{head}, {_says(account)}: {incident.text}"


def detail_rows(one: SwarmIncident) -> list[tuple[str, ...]]:
    """What each robot keeps of an incident, and its own words."""
    rows: list[tuple[str, ...]] = []
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
    return rows


def _span(kept: KeptIncident) -> str:
    """The seconds of a file, from before the incident to after it."""
    is_known = kept.begin is not None and kept.end is not None
    return f"{kept.begin:+.0f} to {kept.end:+.0f}" if is_known else "awaited"

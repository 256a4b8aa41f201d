"""Judgements as cells of tables: rates with upper bounds, shares, goals per minute."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from studies.safety.judgement import Judgement
from studies.safety.runs import Record, total

HOUR = 3600.0


def upper_bound(count: int, hours: float) -> float:
    """The upper bound of a rate per hour at 95 % confidence, after `count` events.

    Poisson, by Wilson and Hilferty's approximation (1931), within 1 %; for none the rule of three.
    """
    k = count + 1.0
    return float(k * (1.0 - 1.0 / (9.0 * k) + 1.645 / (3.0 * k**0.5)) ** 3 / hours)


def rate(count: int, seconds: float) -> str:
    """Such as `3 (0.3, < 0.77)`: the count, the rate per hour and its upper bound at 95 %."""
    hours = seconds / HOUR
    measured = f"{count / hours:.2g}, " if count else ""
    return f"{count} ({measured}< {upper_bound(count, hours):.2g})"


def goals_a_minute(found: Judgement) -> float | None:
    """Goals per minute of one robot; None in scenes without goals."""
    return 60.0 * found.goals / found.goal_seconds if found.goal_seconds else None


def _faults(count: int, seconds: float, worst: float) -> str:
    return rate(count, seconds) + (f", {100.0 * worst:.1f} cm/s" if count else "")


def _speed(hardest: float) -> str:
    return f"{100.0 * hardest:.1f} cm/s" if hardest else "-"


def _share(part: float, whole: float) -> str:
    return f"{part / whole:.3f}" if whole else "-"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


Columns = Mapping[str, Callable[[Judgement], str]]
"""The header of each column, and its cell."""
COLUMNS: Columns = {
    "robot-h": lambda f: f"{f.seconds / HOUR:.1f}",
    "collisions (a robot-h)": lambda f: rate(f.collisions, f.seconds),
    "at fault": lambda f: _faults(f.faults, f.seconds, f.worst),
    "of these, ran into it": lambda f: _faults(f.hits, f.seconds, f.worst_hit),
    "walls, at fault": lambda f: _faults(f.touch_faults, f.seconds, f.worst_touch),
    "pushed": lambda f: str(f.pushed),
    "min gap [m]": lambda f: f"{f.min_gap:.3f}",
    "goals/min": lambda f: _number(goals_a_minute(f)),
    "stuck": lambda f: _share(f.stuck, f.windows),
    "altered": lambda f: _share(f.altered, f.seconds),
}
EVIDENCE: Columns = {
    "robot-hours": lambda f: f"{f.seconds / HOUR:.2f}",
    "touches": lambda f: str(f.collisions + f.touches),
    "pushed": lambda f: str(f.pushed),
    "at fault": lambda f: str(f.faults + f.touch_faults),
    "a robot-hour, at most (95 %)": lambda f: (
        f"{upper_bound(f.faults + f.touch_faults, f.seconds / HOUR):.2g}"
    ),
    "hardest": lambda f: _speed(max(f.worst, f.worst_touch)),
    "held": lambda f: "-" if f.held is None else f"{f.held / f.seconds:.2%}",
    "`moving_wall`": lambda f: str(f.told),
}
"""What docs/evidence/safety.md shows of a cell: touches of robots, walls and poles."""


def rows(what: str, groups: Mapping[str, Sequence[Record]], columns: Columns) -> list[list[str]]:
    """Header and one row per group; `what` is the header of the groups' names."""
    found = [[what, *columns, "date", "commit"]]
    for name, records in groups.items():
        whole = total(record.found for record in records)
        commits = ", ".join(sorted({record.commit for record in records}))
        cells = (cell(whole) for cell in columns.values())
        found.append([name, *cells, max(record.day for record in records), commits])
    return found

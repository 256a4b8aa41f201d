"""The table of faults, as Markdown."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from studies.ros.robots import ARENA, ROBOTS
from studies.ros.study import Row

HEAD = (
    "| fault | noticed after, s | the daemon says | commands to move until, s (bound) |"
    " base stands after, s | driven, m | order: exit code, s, answer | commands after it |"
    " drives again after, s |",
    "|---|---|---|---|---|---|---|---|---|",
)


def line(row: Row, endpoint: str) -> str:
    """The line of a row; the bridge's `endpoint` is replaced, since it differs in each run."""
    fault = row.fault
    says = row.says.replace(endpoint, "tcp/127.0.0.1:7447").replace("|", "/")
    bound = "none" if fault.bound == math.inf else f"{fault.bound:g}"
    commanded = f"{row.commanded:.1f} ({bound})"
    again = _seconds(row.again) + (", once the bridge was started again" if row.needs_more else "")
    cells = (
        fault.name,
        _noticed(row),
        says or "nothing",
        f"**{commanded}**" if row.commanded > fault.bound else commanded,
        _seconds(row.stood),
        " / ".join(f"{driven:.2f}" for driven in row.driven),
        f"`{fault.order}`: {row.code}, {row.taken:.1f}, {row.answer or 'no answer'}",
        f"**{row.late}**" if row.late else "0",
        again,
    )
    return f"| {' | '.join(cells)} |"


def summary(rows: Sequence[Row], contacts: tuple[int, int], seed: int) -> str:
    """The paragraph with the totals of all rows.

    `contacts`: how often robots touched each other, and walls.
    """
    faults = [row for row in rows if row.fault.is_fault]
    noticed = sum(row.noticed < math.inf for row in faults)
    held = [f"{row.fault.name} ({row.others})" for row in rows if row.others]
    touched, walls = contacts
    late = sum(row.is_late for row in rows)
    text = (
        f"{len(faults)} faults, {noticed} noticed, {late} with a command to move that came too"
        f" late. {len(ROBOTS)} robots in an arena of {ARENA} m, seed {seed}; robots touched each"
        f" other {touched} times and walls {walls} times. Robots without a fault were held at "
        f"{'; '.join(held) or 'none of them'}."
    )
    return "\n".join(textwrap.wrap(text, 120))


def _noticed(row: Row) -> str:
    if row.noticed < math.inf:
        return f"{row.noticed:.1f}"
    return "**never**" if row.fault.is_fault else "-"


def _seconds(value: float) -> str:
    return "**not**" if value == math.inf else f"{value:.1f}"

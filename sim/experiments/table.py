"""The rows of an experiment as runs.csv: appended one by one, read strictly.

A line is either whole or not there: a file whose last line is torn, as a killed process leaves it,
is read without that line.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.errors import ConfigError
from swarmd.sim.experiments.plan import Plan, Run, shown

NAME = "runs.csv"
_FIRST, _LAST = ("run", "variant"), "wall"


@dataclass(frozen=True, slots=True)
class Row:
    """What came of one run: metrics by name, None where there is no value, and seconds it took."""

    run: Run
    metrics: Mapping[str, float | None]
    wall: float

    def plain(self) -> dict[str, Any]:
        """As Python shows it: run, variant, swept values, seed, metrics and wall."""
        about = {"run": self.run.id, "variant": self.run.variant.name, **self.run.variant.values}
        return {**about, "seed": self.run.seed, **self.metrics, _LAST: self.wall}


def header(plan: Plan, metrics: Iterable[str]) -> tuple[str, ...]:
    """The columns of an experiment's table."""
    return (*_FIRST, *plan.sweep, "seed", *metrics, _LAST)


def line_of(row: Row) -> str:
    """A row as a line; numbers are read back as the same bits."""
    return lines([_cells(row)])


def lines(rows: Iterable[Sequence[str]]) -> str:
    """Rows of words as lines of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_table(folder: Path, plan: Plan) -> tuple[tuple[str, ...], dict[str, Row]]:
    """The metrics' names and the rows by run, in the order of the plan.

    ConfigError naming file and line for anything that `line_of` does not write.
    """
    path = folder / NAME
    text = _whole_lines(path)
    try:
        records = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise _damaged(path, 1, str(error)) from error
    metrics = _metrics_of(path, records, plan)
    runs = {run.id: run for run in plan.runs}
    rows: dict[str, Row] = {}
    for number, cells in enumerate(records[1:], start=2):
        row = _row(path, number, cells, metrics, runs)
        if row.run.id in rows:
            raise _damaged(path, number, f"run {row.run.id} stands twice")
        rows[row.run.id] = row
    return metrics, {name: rows[name] for name in runs if name in rows}


def _whole_lines(path: Path) -> str:
    try:
        text = path.read_bytes().decode()
    except FileNotFoundError:
        raise ConfigError(f"{path}: is missing; restore it, or run the experiment anew") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise _damaged(path, 1, "it is no UTF-8 text") from error
    return text[: text.rfind("\n") + 1]


def _metrics_of(path: Path, records: Sequence[Sequence[str]], plan: Plan) -> tuple[str, ...]:
    found = tuple(records[0]) if records else ()
    metrics = found[len(header(plan, ())) - 1 : -1]
    if found != header(plan, metrics) or len(set(found)) < len(found):
        raise _damaged(path, 1, f"the columns are not those of its manifest: {','.join(found)}")
    return metrics


def _row(
    path: Path,
    number: int,
    cells: Sequence[str],
    metrics: Sequence[str],
    runs: Mapping[str, Run],
) -> Row:
    run = runs.get(cells[0]) if cells else None
    if run is None:
        raise _damaged(path, number, f"no run of its manifest: {cells[0] if cells else ''!r}")
    about = _about(run)
    if tuple(cells[: len(about)]) != about or len(cells) != len(about) + len(metrics) + 1:
        raise _damaged(path, number, f"it is not about run {run.id} of its manifest")
    try:
        values = [float(cell) if cell else None for cell in cells[len(about) : -1]]
        wall = float(cells[-1])
    except ValueError as error:
        raise _damaged(path, number, str(error)) from error
    if not all(value is None or math.isfinite(value) for value in (*values, wall)):
        raise _damaged(path, number, "a number is not finite")
    return Row(run, dict(zip(metrics, values, strict=True)), wall)


def _cells(row: Row) -> tuple[str, ...]:
    values = ("" if value is None else repr(float(value)) for value in row.metrics.values())
    return (*_about(row.run), *values, f"{row.wall:.3f}")


def _about(run: Run) -> tuple[str, ...]:
    values = (shown(value) for value in run.variant.values.values())
    return (run.id, run.variant.name, *values, str(run.seed))


def _damaged(path: Path, line: int, why: str) -> ConfigError:
    text = " ".join(why.split())[:120]
    return ConfigError(f"{path}:{line}: damaged: {text}; restore it, or run the experiment anew")

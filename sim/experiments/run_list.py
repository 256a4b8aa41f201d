"""The list of runs that a program has done: `SWARMD_STUDY_RUNS=FILE python study.py`.

While the variable is set, `simulate` appends a line of JSON for each finished run of workers::

    {"scenario": "dispersion", "set": {"duration": 40}, "seed": 3, "bits": "0123456789ab",
     "rules": ["barrier"]}

by which the run can be done again and compared. `scenario` is a name, a path, relative if it is
below the present folder, or the contents of a scenario that has no file. Runs within the process
itself are not listed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.plan import Plan
from swarmd.sim.experiments.results import Results

VARIABLE = "SWARMD_STUDY_RUNS"
"""The variable with the file to which runs are listed."""


def list_runs(
    results: Results, *, is_named: bool = True, environ: Mapping[str, str] = os.environ
) -> None:
    """Append the finished runs to the file of VARIABLE; nothing without it.

    `is_named`: the plan's scenario is a name or a path. SwarmError if the file cannot be written.
    """
    file = environ.get(VARIABLE, "")
    if not file:
        return
    lines = [json.dumps(line) for line in lines_of(results, is_named=is_named)]
    try:
        with Path(file).open("a") as out:
            out.write("".join(f"{line}\n" for line in lines))
    except OSError as error:
        text = f"{file}: {error.strerror}; the runs are kept, and not listed"
        raise SwarmError(f"{text}: mend it, or unset {VARIABLE}") from error


def lines_of(results: Results, *, is_named: bool) -> Iterator[Mapping[str, Any]]:
    """The line of each finished run, without those whose bits are not known."""
    plan = results.plan
    rows = {row["run"]: row for row in results.rows}
    for run in results.runs:
        row = rows[run.id]
        if not row["bits"]:
            continue
        about = (
            _named(plan, run.variant.values) if is_named else {"scenario": run.variant.effective}
        )
        yield {**about, "seed": run.seed, "bits": row["bits"], "rules": row["rules"].split()}


def _named(plan: Plan, values: Mapping[str, Any]) -> Mapping[str, Any]:
    path = Path(plan.scenario)
    here = Path.cwd()
    is_below = path.is_absolute() and path.is_relative_to(here)
    name = path.relative_to(here).as_posix() if is_below else plan.scenario
    return {"scenario": name, "set": {**plan.sets, **values}}


@contextmanager
def unlisted() -> Iterator[None]:
    """While it is open, this process lists no runs: they are of no table."""
    file = os.environ.pop(VARIABLE, None)
    try:
        yield
    finally:
        if file is not None:
            os.environ[VARIABLE] = file

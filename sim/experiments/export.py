"""Export of an experiment for other programs: tables as CSV or Parquet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from swarmd.core.errors import SwarmError
from swarmd.core.files import whole_file
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import cell
from swarmd.sim.trace import Trace

Form: TypeAlias = Literal["csv", "parquet"]


def export(results: Results, form: Form, out: Path, *, traces: bool = True) -> Iterator[Path]:
    """Write the finished runs of an experiment into the folder `out`; yield the path of each file.

    The file `results` has a row for each run, and the file `traces/RUN` has a
    row for each instant and robot. Without `traces` only `results` is written. Files
    are written atomically. SwarmError if a trace is missing, or if a file cannot be written.
    """
    yield _written(out / f"results.{form}", partial(_save, results.frame(), form))
    for number, run in enumerate(results.runs if traces else ()):
        table = _long(results.traces[number], run)
        yield _written(out / "traces" / f"{run.id}.{form}", partial(_save, table, form))


def _long(trace: Trace, run: Run) -> Any:
    """The table of a trace, with the run's name, variant and seed, so that tables can be joined."""
    table = trace.frame()
    about = {"run": run.id, "variant": run.variant.name, "seed": run.seed}
    for place, (name, value) in enumerate(about.items()):
        table.insert(place, name, value)
    return table


def _save(table: Any, form: Form, path: Path) -> None:
    if form == "csv":
        is_text = table.dtypes.map(lambda kind: kind.kind not in "biuf")
        safe = {name: table[name].map(_cell) for name in table.columns[is_text]}
        table.assign(**safe).rename(columns=_cell).to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False)


def _cell(value: Any) -> Any:
    return cell(value) if isinstance(value, str) else value


def _written(path: Path, write: Callable[[Path], None]) -> Path:
    """The path, once `write` has written the file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            write(unfinished)
    except OSError as error:
        text = f"{path}: cannot be written: {error.strerror or error}"
        raise SwarmError(f"{text}; make room or name another place") from error
    except ImportError as error:  # pyarrow, which pandas imports for Parquet
        text = f"{path.suffix[1:]} needs {error.name or 'pyarrow'}"
        raise SwarmError(f"{text}: pip install 'swarmd[table]'") from error
    return path

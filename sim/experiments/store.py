"""The folder of an experiment, complete at every instant.

::

    manifest.json   what was to be run, and with what
    runs.csv        a row for each finished run, appended as it finishes
    traces/ID.npz   the trace of a run
    failures.json   the runs that failed, and why
    summary.json    means, medians and intervals by variant and metric

The last line of runs.csv may be torn, as a killed process leaves it. It is read as if it were not
there.
"""

from __future__ import annotations

import csv
import errno
import fcntl
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments import manifest as manifests
from swarmd.sim.experiments.manifest import (
    Manifest,
    read_manifest,
    write_json,
    write_manifest,
    write_whole,
)
from swarmd.sim.experiments.plan import Plan, Run, shown

TABLE = "runs.csv"
_FIRST, _LAST = ("run", "variant"), "wall"


@dataclass(frozen=True, slots=True)
class Row:
    """A finished run: metrics by name, None without a value, and its duration `wall` in s."""

    run: Run
    metrics: Mapping[str, float | None]
    wall: float

    def plain(self) -> dict[str, Any]:
        """As a dict: run, variant, swept values, seed, metrics and wall."""
        about = {"run": self.run.id, "variant": self.run.variant.name, **self.run.variant.values}
        return {**about, "seed": self.run.seed, **self.metrics, _LAST: self.wall}


def header(plan: Plan, metrics: Iterable[str]) -> tuple[str, ...]:
    """The columns of an experiment's table."""
    return (*_FIRST, *plan.sweep, "seed", *metrics, _LAST)


def line_of(row: Row) -> str:
    """A row as a line; numbers are read back as the same bits."""
    return lines([_cells(row)])


def lines(rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells as lines of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_table(folder: Path, plan: Plan) -> tuple[tuple[str, ...], dict[str, Row]]:
    """The metrics' names and the rows by run, in the order of the plan.

    ConfigError with file and line for anything that `line_of` does not write.
    """
    path = folder / TABLE
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
            raise _damaged(path, number, f"run {row.run.id} appears twice")
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
        raise _damaged(path, 1, "not UTF-8 text") from error
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
        raise _damaged(path, number, f"it does not match run {run.id} of the manifest")
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


TRACES = "traces"
FAILURES = "failures.json"
SUMMARY = "summary.json"
_FULL = (errno.ENOSPC, errno.EDQUOT)
_HEAD = {"apiVersion": "swarm/v1", "kind": "ExperimentSummary"}


class Store:
    """An experiment's folder, open for writing. `rows` and `failures` (reasons) are by run.

    Runs that failed earlier are not in `failures`: they are run again.
    """

    def __init__(self, folder: Path, manifest: Manifest, rows: dict[str, Row]) -> None:
        self.folder = folder
        self.manifest = manifest
        self.plan = manifest.plan
        self.rows = rows
        self.failures: dict[str, str] = {}

    @property
    def missing(self) -> tuple[Run, ...]:
        """The runs that have no row yet, in order."""
        return tuple(run for run in self.plan.runs if run.id not in self.rows)

    def trace_of(self, run: Run) -> Path | None:
        """Where the trace of a run goes; None if traces are not kept."""
        return trace_path(self.folder, run) if self.manifest.traces else None

    @property
    def is_whole(self) -> bool:
        """Whether the folder and its traces still exist."""
        return (self.folder / (TRACES if self.manifest.traces else manifests.NAME)).exists()

    def add(self, run: Run, metrics: Mapping[str, float | None], wall: float) -> None:
        """Append a finished run; SwarmError if it cannot be written."""
        row = Row(run, metrics, round(wall, 3))
        with _translate_errors(self.folder):
            try:
                _append(self.folder / TABLE, line_of(row))
            except FileNotFoundError as error:
                raise gone(self.folder) from error
        self.rows[run.id] = row

    def fail(self, run: Run, reason: str) -> None:
        """Record that a run failed, and why; SwarmError if it cannot be written."""
        self.failures[run.id] = reason
        with _translate_errors(self.folder):
            self._write_failures()

    def close(self, summary: Mapping[str, object]) -> None:
        """Put the rows in order and write the summary; SwarmError if the disk is full."""
        rows = [self.rows[run.id] for run in self.plan.runs if run.id in self.rows]
        with _translate_errors(self.folder):
            if rows:
                head = lines([header(self.plan, rows[0].metrics)])
                text = head + "".join(map(line_of, rows))
                write_whole(self.folder / TABLE, text)
            self._write_failures()
            write_json(self.folder / SUMMARY, {**_HEAD, **summary})

    def _write_failures(self) -> None:
        listed = [
            {"run": run.id, "variant": run.variant.name, "seed": run.seed,
             "reason": self.failures[run.id]}
            for run in self.plan.runs if run.id in self.failures
        ]  # fmt: skip
        path = self.folder / FAILURES
        if listed or path.exists():
            write_json(path, {"failures": listed})


@contextmanager
def open_store(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> Iterator[Store]:
    """The folder for this experiment: a new one, or one in which the same experiment goes on.

    ConfigError, with nothing changed, if the folder holds anything else, belongs to another
    experiment or is in use.
    """
    with _translate_errors(folder):
        made = not folder.is_dir()
        folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        if (folder / manifests.NAME).exists():
            store = _resumed(folder, manifest, metrics)
        else:
            if not made:
                _refuse_other_files(folder)
            _begin(folder, manifest, metrics)
            store = Store(folder, manifest, {})
        yield store


def read_failures(folder: Path) -> dict[str, str]:
    """The reasons by run of failures.json, {} without one; ConfigError if it is damaged."""
    path = folder / FAILURES
    try:
        listed = json.loads(path.read_bytes())["failures"]
        return {str(failure["run"]): str(failure["reason"]) for failure in listed}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigError(f"{path}: damaged; remove it or restore it") from error


def gone(folder: Path) -> SwarmError:
    """The error that the folder, or a file of it, was removed."""
    text = f"{folder}: the folder or a file of it was removed"
    return SwarmError(f"{text}; restore it or remove the rest, and give the same command again")


def trace_path(folder: Path, run: Run) -> Path:
    """Where the trace of a run is."""
    return folder / TRACES / f"{run.id}.npz"


def _begin(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> None:
    with _translate_errors(folder):
        write_manifest(manifest, folder)  # first: it makes the folder that of an experiment
        _begin_table(folder, manifest, metrics)


def _begin_table(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> None:
    write_whole(folder / TABLE, lines([header(manifest.plan, metrics)]))
    if manifest.traces:
        (folder / TRACES).mkdir(exist_ok=True)


def _resumed(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> Store:
    old = read_manifest(folder)
    differing = next(manifests.differences(old, manifest), None)
    if differing is not None:
        text = f"{folder}: holds another experiment: {differing}"
        raise ConfigError(f"{text}; name another folder with --out, or remove this one")
    if not (folder / TABLE).exists():  # interrupted between the two, or deleted
        with _translate_errors(folder):
            _begin_table(folder, old, metrics)
    known, rows = read_table(folder, old.plan)
    if known != metrics:
        raise ConfigError(f"{folder}: holds other metrics; name another folder with --out")
    with _translate_errors(folder):
        for partial in (folder / TRACES).glob(".*.partial"):
            partial.unlink()
        _cut_torn_line(folder / TABLE)
        if old.traces:
            (folder / TRACES).mkdir(exist_ok=True)
    return Store(folder, old, rows)


def _refuse_other_files(folder: Path) -> None:
    cut_off = f".{manifests.NAME}.partial"
    others = sorted(path.name for path in folder.iterdir() if path.name != cut_off)
    if others:
        text = f"{folder}: is not the folder of an experiment: it holds {others[0]}"
        raise ConfigError(f"{text}; name a new or empty one with --out")


def _append(path: Path, line: str) -> None:
    """Append a line as a whole, or nothing."""
    with path.open("r+b", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        data = line.encode()
        try:
            written = 0
            while written < len(data):
                written += file.write(data[written:]) or 0
        except BaseException:
            with suppress(OSError):  # otherwise the torn line is removed at the next start
                file.truncate(size)
            raise


def _cut_torn_line(path: Path) -> None:
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        os.truncate(path, whole)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock of the folder; ConfigError if another process holds it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            text = f"{folder}: another swarmctl is using it"
            raise ConfigError(f"{text}; wait for it, or name another folder") from error
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _translate_errors(folder: Path) -> Iterator[None]:
    """Turn errors of the file system into one line that names the folder."""
    try:
        yield
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(f"{error.filename}: is a file; name a folder with --out") from error
    except OSError as error:
        text = f"{folder}: {error.strerror or error}"
        if error.errno in _FULL:
            raise SwarmError(
                f"{text}; what was finished is kept, so make room and go on"
            ) from error
        raise SwarmError(f"{text}; name another folder with --out") from error

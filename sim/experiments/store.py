"""The folder of an experiment, readable at every instant of the experiment.

::

    manifest.json   the planned runs, and the software that makes them
    runs.csv        a row for each finished run, appended when the run ends
    traces/ID.npz   the trace of a run
    failures.json   the reasons of runs that failed, and in finished runs of custom metrics that
                    failed and of patterns that raised an error (metric failed_patterns)
    summary.json    means, medians and intervals by variant and metric

A killed process may leave the last line of runs.csv incomplete. Readers skip such a line.
"""

from __future__ import annotations

import csv
import io
import json
import logging
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import lock_file, read_regular
from swarmd.sim.experiments import manifest as manifests
from swarmd.sim.experiments.manifest import Manifest, read_manifest, write_json, write_whole
from swarmd.sim.experiments.plan import Plan, Run, shown

log = logging.getLogger(__name__)

TABLE = "runs.csv"
_FORMULA_STARTS = tuple("=+-@\t\r\n")
TRACES = "traces"
FAILURES = "failures.json"
_DID = ("bits", "rules")
"""The columns of what the robots did, before the last; a table of an earlier version lacks them."""
STORED = "stored"
"""In place of the duration of a run that was taken from the store of runs."""
SUMMARY = "summary.json"
_HEAD = {"apiVersion": "swarm/v1", "kind": "ExperimentSummary"}


@dataclass(frozen=True, slots=True)
class Row:
    """A finished run: metrics by name, None without a value.

    `wall`: its duration in s; None if it was taken from the store of runs, and took no time here.
    `bits`, `rules`: as of JobResult; empty in a folder of an earlier version.
    """

    run: Run
    metrics: Mapping[str, float | None]
    wall: float | None
    bits: str = ""
    rules: tuple[str, ...] = ()

    def plain(self) -> dict[str, Any]:
        """As a dict: run, variant, swept values, seed, metrics, bits, rules as text, and wall."""
        about = {"run": self.run.id, "variant": self.run.variant.name, **self.run.variant.values}
        did = {"bits": self.bits, "rules": " ".join(self.rules)}
        return {**about, "seed": self.run.seed, **self.metrics, **did, "wall": self.wall}

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells of its line; numbers are read back as the same bits."""
        variant = self.run.variant
        values = ("" if value is None else repr(float(value)) for value in self.metrics.values())
        swept = map(shown, variant.values.values())
        texts = map(cell, (self.run.id, variant.name, *swept))
        wall = STORED if self.wall is None else f"{self.wall:.3f}"
        rules = " ".join(self.rules)
        return (*texts, str(self.run.seed), *values, cell(self.bits), cell(rules), wall)


def header(plan: Plan, metrics: Iterable[str]) -> tuple[str, ...]:
    """The columns of an experiment's table."""
    return tuple(map(cell, ("run", "variant", *plan.sweep, "seed", *metrics, *_DID, "wall")))


def cell(text: str) -> str:
    """The text for a cell of CSV: a `'` before what a spreadsheet would run as a formula.

    `cell("=1+1") == "'=1+1"` and `cell("-0.5") == "-0.5"`, which is a number.
    """
    if text[:1] not in _FORMULA_STARTS:
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def _text_of(cell_text: str) -> str:
    """The text of which `cell` has made this."""
    text = cell_text.removeprefix("'")
    return text if cell(text) == cell_text else cell_text


def lines(rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells as lines of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_table(folder: Path, plan: Plan) -> tuple[tuple[str, ...], dict[str, Row]]:
    """Read runs.csv: the names of the metrics, and the rows by run id in the order of the plan.

    A last line that was not written completely is skipped. ConfigError with file and line for any
    other damage: wrong columns, an unknown run, a run that appears twice, or a wrong cell.
    """
    path = folder / TABLE
    try:
        text = read_regular(path).decode(errors="replace")
    except OSError as error:
        fault = f"{path}: {error.strerror}"
        raise ConfigError(f"{fault}; restore it, or run the experiment again") from error
    reader = csv.reader(io.StringIO(text[: text.rfind("\n") + 1]), strict=True)
    runs = {run.id: run for run in plan.runs}
    rows: dict[str, Row] = {}
    try:
        columns = tuple(next(reader, ()))
        has_bits = columns[-3:-1] == _DID
        if not has_bits:
            columns = (*columns[:-1], *_DID, *columns[-1:])
        # The metrics stand between `seed` and the last columns.
        last = len(_DID) + 1
        first_metric = len(header(plan, ())) - last
        metrics = tuple(map(_text_of, columns[first_metric:-last]))
        if columns != header(plan, metrics) or len(set(columns)) < len(columns):
            raise ValueError(f"the columns are not those of its manifest: {','.join(columns)}")
        for cells in reader:
            whole = cells if has_bits else [*cells[:-1], *[""] * len(_DID), *cells[-1:]]
            row = _row(whole, metrics, runs)
            if row.run.id in rows:
                raise ValueError(f"run {row.run.id} appears twice")
            rows[row.run.id] = row
    except (csv.Error, ValueError) as error:
        fault = f"{path}:{reader.line_num or 1}: damaged: {' '.join(str(error).split())[:120]}"
        raise ConfigError(f"{fault}; restore it, or run the experiment again") from error
    return metrics, {name: rows[name] for name in runs if name in rows}


def _row(cells: Sequence[str], metrics: Sequence[str], runs: Mapping[str, Run]) -> Row:
    """The row of a line; ValueError if it is not the line of a run of the manifest."""
    name = cells[0] if cells else ""
    if name not in runs:
        raise ValueError(f"no run of its manifest: {name!r}")
    *texts, bits, rules, duration = cells
    values = [float(text) if text else None for text in texts[len(texts) - len(metrics) :]]
    wall = None if duration == STORED else float(duration or "nan")
    if not all(v is None or math.isfinite(v) for v in (*values, wall)):
        raise ValueError("a number is missing or not finite")
    measured = dict(zip(metrics, values, strict=True))
    row = Row(runs[name], measured, wall, _text_of(bits), tuple(_text_of(rules).split()))
    if row.cells != tuple(cells):
        raise ValueError(f"it does not match run {name} of the manifest")
    return row


class Store:
    """An experiment's folder, open for writing.

    - `rows`: the finished runs, by run.
    - `failures`: the reasons of runs that failed in this session, by run. Runs that failed in an
      earlier session are run again.
    - `errors`: why custom metrics have no value in a finished run, by run and metric.
    """

    def __init__(self, folder: Path, manifest: Manifest, rows: dict[str, Row]) -> None:
        self.folder = folder
        self.manifest = manifest
        self.plan = manifest.plan
        self.rows = rows
        self.failures: dict[str, str] = {}
        self._earlier_failures = read_failures(folder)
        self.errors = {run: why for run, why in read_errors(folder).items() if run in rows}

    @property
    def missing(self) -> tuple[Run, ...]:
        """The runs that have no row yet, in order."""
        return tuple(run for run in self.plan.runs if run.id not in self.rows)

    def trace_of(self, run: Run) -> Path | None:
        """Where the trace of a run goes; None if traces are not kept."""
        return trace_path(self.folder, run) if self.manifest.traces else None

    def add(
        self,
        run: Run,
        metrics: Mapping[str, float | None],
        wall: float | None,
        errors: Mapping[str, str] | None = None,
        *,
        bits: str = "",
        rules: tuple[str, ...] = (),
    ) -> None:
        """Append a finished run; SwarmError if it cannot be written.

        `wall`, `bits`, `rules`: as of Row.
        """
        if errors:
            self.errors[run.id] = dict(errors)
            with translated_errors(self.folder):
                self._write_failures()
        row = Row(run, metrics, None if wall is None else round(wall, 3), bits, rules)
        # "r+" raises an error if the table has been removed. A line that a full disk has torn is
        # cut off when the folder is opened again.
        with translated_errors(self.folder), (self.folder / TABLE).open("r+b") as file:
            file.seek(0, os.SEEK_END)
            file.write(lines([row.cells]).encode())
        self.rows[run.id] = row

    def fail(self, run: Run, reason: str) -> None:
        """Record that a run failed, and why; SwarmError if it cannot be written."""
        self.failures[run.id] = reason
        with translated_errors(self.folder):
            self._write_failures()

    def close(self, summary: Mapping[str, object]) -> None:
        """Put the rows in order and write the summary; SwarmError if the disk is full."""
        rows = [self.rows[run.id] for run in self.plan.runs if run.id in self.rows]
        with translated_errors(self.folder):
            if rows:
                head = header(self.plan, rows[0].metrics)
                write_whole(self.folder / TABLE, lines([head, *(row.cells for row in rows)]))
            self._write_failures()
        write_summary(self.folder, summary)

    def _write_failures(self) -> None:
        failures = {**self._earlier_failures, **self.failures}
        listed = [
            {"run": run.id, "variant": run.variant.name, "seed": run.seed,
             "reason": failures[run.id]}
            for run in self.plan.runs if run.id in failures and run.id not in self.rows
        ]  # fmt: skip
        errors = [
            {"run": run.id, "metric": metric, "reason": why}
            for run in self.plan.runs for metric, why in self.errors.get(run.id, {}).items()
        ]  # fmt: skip
        path = self.folder / FAILURES
        if listed or errors or path.exists():
            write_json(path, {"failures": listed, "metrics": errors})


@contextmanager
def open_store(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> Iterator[Store]:
    """Open or make the folder of an experiment, and lock it; an interrupted experiment continues.

    `metrics`: the columns of the table. ConfigError, before any change, if the folder has files
    that are not of an experiment, belongs to another experiment, or is in use.
    """
    with translated_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        with translated_errors(folder):
            store = _opened(folder, manifest, metrics)
        yield store


def write_summary(folder: Path, summary: Mapping[str, object]) -> None:
    """Write summary.json; SwarmError if the disk is full."""
    with translated_errors(folder):
        write_json(folder / SUMMARY, {**_HEAD, **summary})


def set_seeds(folder: Path, manifest: Manifest, *, is_longer: bool) -> None:
    """Prolong (`is_longer`) or shorten the seeds of the experiment in a folder to those of another.

    Nothing is done without an experiment there, or if more than the end of the seeds differs. Runs
    of seeds that are left out must have no row. ConfigError if the folder is in use.
    """
    if (folder / manifests.NAME).exists():
        with _locked(folder), translated_errors(folder):
            recorded = read_manifest(folder)
            short, long = (recorded, manifest) if is_longer else (manifest, recorded)
            changed = msgspec.structs.replace(recorded, seeds=manifest.seeds)
            is_same = next(manifests.differences(changed, manifest), None) is None
            if is_same and long.seeds[: len(short.seeds)] == short.seeds:
                write_json(folder / manifests.NAME, msgspec.to_builtins(changed))


@contextmanager
def translated_errors(folder: Path) -> Iterator[None]:
    """Turn an OSError into a ConfigError or SwarmError of one line that names the folder."""
    try:
        yield
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(f"{error.filename}: is a file; name a folder with --out") from error
    except OSError as error:
        text = f"{folder}: {error.strerror or error}; finished runs are kept"
        remedy = "give the same command again, or name another folder with --out"
        raise SwarmError(f"{text}: mend it and {remedy}") from error


def read_failures(folder: Path) -> dict[str, str]:
    """The reasons by run of failures.json, {} without one; ConfigError if it is damaged."""
    return {run: why for run, _, why in _listed(folder, "failures")}


def read_errors(folder: Path) -> dict[str, dict[str, str]]:
    """Why custom metrics have no value, by run and metric; ConfigError for a damaged file."""
    errors: dict[str, dict[str, str]] = {}
    for run, metric, why in _listed(folder, "metrics"):
        errors.setdefault(run, {})[metric] = why
    return errors


def _listed(folder: Path, key: str) -> list[tuple[str, str, str]]:
    """Run, metric and reason of each entry of failures.json."""
    path = folder / FAILURES
    try:
        return [
            (str(entry["run"]), str(entry.get("metric", "")), str(entry["reason"]))
            for entry in json.loads(read_regular(path))[key]
        ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{path}: damaged; remove it or restore it") from error


def trace_path(folder: Path, run: Run) -> Path:
    """Where the trace of a run is."""
    return folder / TRACES / f"{run.id}.npz"


def _opened(folder: Path, manifest: Manifest, metrics: tuple[str, ...]) -> Store:
    """The store of a new or continued experiment; removes partly written traces and lines."""
    table = folder / TABLE
    traces = folder / TRACES
    if (folder / manifests.NAME).exists():
        manifest = recorded_in(folder, manifest)
    else:
        _refuse_other_files(folder)
        # The manifest comes first: it marks the folder as the folder of an experiment.
        write_json(folder / manifests.NAME, msgspec.to_builtins(manifest))
    if not table.exists():  # new, interrupted after the manifest, or deleted by the user
        write_whole(table, lines([header(manifest.plan, metrics)]))
    known, rows = read_table(folder, manifest.plan)
    if known != metrics:
        raise ConfigError(f"{folder}: holds other metrics; name another folder with --out")
    if manifest.traces:
        traces.mkdir(exist_ok=True)
    for partial in traces.glob(".*.partial"):
        partial.unlink()
    os.truncate(table, read_regular(table).rfind(b"\n") + 1)
    head = lines([header(manifest.plan, metrics)])
    if not read_regular(table).startswith(head.encode()):  # of an earlier version
        write_whole(table, head + lines(row.cells for row in rows.values()))
    return Store(folder, manifest, rows)


def recorded_in(folder: Path, manifest: Manifest) -> Manifest:
    """The manifest in a folder; ConfigError if it is of another experiment than `manifest`."""
    recorded = read_manifest(folder)
    difference = next(manifests.differences(recorded, manifest), None)
    if difference is not None:
        text = f"{folder}: holds another experiment: {difference}"
        raise ConfigError(f"{text}; name another folder with --out, or remove this one")
    return recorded


def _refuse_other_files(folder: Path) -> None:
    cut_off = f".{manifests.NAME}.partial"
    others = sorted(path.name for path in folder.iterdir() if path.name != cut_off)
    if others:
        text = f"{folder}: is not the folder of an experiment: it holds {others[0]}"
        raise ConfigError(f"{text}; name a new or empty one with --out")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock of the folder; ConfigError if another process holds it.

    Where the file system has no locks the folder is used without one, and the log says so.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            is_locked = lock_file(descriptor, waits=False)
        except BlockingIOError as error:
            text = f"{folder}: another swarmctl is using it"
            raise ConfigError(f"{text}; wait for it, or name another folder") from error
        except OSError as error:
            raise ConfigError(
                f"{folder}: cannot be locked: {error.strerror}; name another folder with --out"
            ) from error
        if not is_locked:
            log.warning(
                "%s: its file system has no locks; let no second swarmctl use this folder", folder
            )
        yield
    finally:
        os.close(descriptor)

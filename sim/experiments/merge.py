"""Join the parts of an experiment that several machines have run into one folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from shutil import copyfileobj

from msgspec import structs

from swarmd.core.errors import ConfigError
from swarmd.core.files import open_regular, read_regular, whole_file
from swarmd.sim.experiments.manifest import Manifest, differences, joined, read_manifest
from swarmd.sim.experiments.plan import Plan, Run, parts_of
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.store import (
    Row,
    open_store,
    read_errors,
    read_failures,
    read_table,
    trace_path,
    translated_errors,
)

_NAMED = 10  # runs that a message lists
_MAX_TRACE = 1 << 32  # bytes


def merge(
    folders: Sequence[Path], out: Path, *, is_trusted: bool = False
) -> tuple[Results, list[str]]:
    """Join the parts of an experiment, in `folders`, into the folder `out`.

    Returns the results, and a line for each part that lacks runs. Except for the durations of runs,
    `out` equals the folder of an experiment on one machine.

    - Parts may have common runs, and `out` may hold parts from an earlier call.
    - Parts from different processors are joined; the manifest names all processors.
    - `is_trusted`: metrics in Python files run even if the files are new or have changed.

    ConfigError, before any change of `out`, if the parts are of different experiments or software,
    have different results of one run, or lack a trace.
    """
    if out.resolve() in [folder.resolve() for folder in folders]:
        raise ConfigError(f"--out {out} is one of the parts; name another folder")
    parts = {folder: read_manifest(folder) for folder in folders}
    whole = _whole(parts, out)  # the manifest of the experiment that was divided
    plans = {folder: part.plan for folder, part in parts.items()}
    if (out / "manifest.json").exists():
        plans[out] = read_manifest(out).plan
    metrics, finished_runs = _joined_tables(plans, has_traces=whole.traces)
    # By run: why custom metrics of finished runs have no value, and why other runs failed.
    errors = {run: error for folder in parts for run, error in read_errors(folder).items()}
    failures = {run: fault for folder in parts for run, fault in read_failures(folder).items()}
    with open_store(out, whole, metrics) as store:
        for run in store.missing:  # the runs that `out` does not have already
            if run.id in finished_runs:
                row, folder = finished_runs[run.id]
                if (trace := store.trace_of(run)) is not None:  # the experiment keeps traces
                    _copy(trace_path(folder, run), trace)
                store.add(
                    run,
                    row.metrics,
                    row.wall,
                    errors.get(run.id),
                    bits=row.bits,
                    rules=row.rules,
                )
            elif run.id in failures:
                store.fail(run, failures[run.id])
        results = load_results(out, is_trusted=is_trusted)
        store.close(results.document())
        return results, _missing_runs(parts, store.missing)


def _joined_tables(
    plans: Mapping[Path, Plan], *, has_traces: bool
) -> tuple[tuple[str, ...], dict[str, tuple[Row, Path]]]:
    """The names of the metrics, and by run the row and the first folder that has the run.

    `plans`: by folder. ConfigError if two folders differ in their metrics, or in a common run.
    """
    tables = {folder: read_table(folder, plan) for folder, plan in plans.items()}
    finished_runs: dict[str, tuple[Row, Path]] = {}
    for folder, (_, rows) in tables.items():
        for run, row in rows.items():
            first_row, first_folder = finished_runs.setdefault(run, (row, folder))
            _check_same(first_row, first_folder, row, folder, has_traces=has_traces)
    metrics_of = {folder: metrics for folder, (metrics, _) in tables.items()}
    for folder, next_folder in pairwise(metrics_of):
        if metrics_of[folder] != metrics_of[next_folder]:
            text = f"{folder} and {next_folder}: their metrics differ"
            raise ConfigError(f"{text}; merge parts of one version")
    return next(iter(metrics_of.values())), finished_runs


def _whole(parts: dict[Path, Manifest], out: Path) -> Manifest:
    """The manifest of all parts together; ConfigError if they do not belong together."""
    (first_folder, whole), *further_parts = parts.items()
    whole = structs.replace(whole, shard=None, command=_command(whole.command, out))
    for folder, part in further_parts:
        whole = joined(whole, part)
        # Shards and processors may differ.
        comparable = structs.replace(part, shard=None, made_with=joined(part, whole).made_with)
        difference = next(differences(whole, comparable), None)
        if difference is not None:
            raise ConfigError(
                f"{first_folder} and {folder} are not of one experiment: {difference}"
            )
    return whole


def _command(command: Sequence[str], out: Path) -> list[str]:
    """The command line without `--shard`, and with `out` as its `--out`."""
    kept = [
        word
        for before, word in pairwise(["", *command])
        if not {before, word} & {"--shard", "--out"}
    ]
    return [*kept, "--out", str(out)] if kept else []


def _check_same(
    first_row: Row, first_folder: Path, row: Row, folder: Path, *, has_traces: bool
) -> None:
    """ConfigError if two parts differ in metrics or trace of a run, or the trace is missing.

    `first_folder` may be `folder` itself: then only the presence of the trace is checked.
    """
    try:
        is_same = first_row.metrics == row.metrics
        if has_traces:
            first_trace, trace = (trace_path(part, row.run) for part in (first_folder, folder))
            open_regular(trace).close()
            is_same = is_same and (
                first_folder == folder
                or read_regular(first_trace, _MAX_TRACE) == read_regular(trace, _MAX_TRACE)
            )
    except OSError as error:
        text = f"{error.filename}: the trace of a finished run cannot be read: {error.strerror}"
        raise ConfigError(f"{text}; restore it, or remove the run's line from runs.csv") from error
    if not is_same:
        text = f"{first_folder} and {folder}: their results of run {row.run.id} differ"
        raise ConfigError(f"{text}; leave one of them out")


def _copy(source: Path, target: Path) -> None:
    """Copy a trace atomically; SwarmError if the copy cannot be written."""
    with (
        translated_errors(target.parent),
        whole_file(target) as partial,
        open_regular(source) as file,
        partial.open("wb") as copy,
    ):
        copyfileobj(file, copy)


def _missing_runs(parts: dict[Path, Manifest], missing: Sequence[Run]) -> list[str]:
    """A line for each part that lacks runs of its plan, and a line for runs that no part plans.

    `parts`: the manifest of each part by its folder. `missing`: the runs without a result.
    """
    missing_ids = {run.id for run in missing}
    lines: list[str] = []
    planned: set[str] = set()
    for folder, part in parts.items():
        runs = [run.id for run in part.plan.runs]
        missing_of_part = [run for run in runs if run in missing_ids]
        planned |= set(runs)
        if missing_of_part:
            name = f"{folder} (part {part.shard})" if part.shard else str(folder)
            count = f"{len(missing_of_part)} of {len(runs)} runs"
            lines.append(f"{name}: {count}: {_listed(missing_of_part)}")
    unplanned = [run.id for run in missing if run.id not in planned]
    if unplanned:
        lines.append(f"{_absent_parts(parts, unplanned)}in no folder: {_listed(unplanned)}")
    return lines


def _absent_parts(parts: dict[Path, Manifest], unplanned: Sequence[str]) -> str:
    """The parts to which runs belong that no given part plans, such as "part 3/40, ".

    Empty if the given parts are of different numbers of parts: then the division is not known.
    """
    counts = {part.shard.of if part.shard else 1 for part in parts.values()}
    if len(counts) > 1:
        return ""
    (count,) = counts
    all_runs = replace(next(iter(parts.values())).plan, shard=None).runs
    part_by_run = parts_of(all_runs, count)
    numbers = sorted({part_by_run[run] for run in unplanned})
    return f"part {_listed([f'{number}/{count}' for number in numbers])}, "


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"

"""Repeat an experiment from its manifest alone, and compare it bit by bit."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.plugins import MISSION
from swarmd.sim.experiments.manifest import (
    Manifest,
    manifest_of,
    plugin_folders,
    read_manifest,
    software_differences,
)
from swarmd.sim.experiments.pool import STEP_TIMEOUT, run_jobs
from swarmd.sim.experiments.provenance import digests_of_folders, is_code
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import OnProgress, Runner, run_experiment
from swarmd.sim.experiments.trace_differences import first_difference, trace_differences
from swarmd.sim.experiments.trust import check_code
from swarmd.sim.metrics.catalog import metric_of, names_file
from swarmd.sim.metrics.own import digest_of_file
from swarmd.sim.scenarios.scenariofile import scenario_of


def warnings(folder: Path, *, is_trusted: bool = False) -> list[str]:
    """A text for each difference between the manifest's software and machine and the present ones.

    The likeliest cause of other results is first.
    ConfigError if `folder` is no experiment. ConfigError also if a Python file that the manifest
    names is new, has changed or has never been run by this user, unless `is_trusted`.
    """
    old = read_manifest(folder)
    return list(software_differences(old, _again(folder, old, is_trusted=is_trusted)))


def rerun(
    folder: Path,
    out: Path | None,
    processes: int = 1,
    on_progress: OnProgress | None = None,
    timeout: float = STEP_TIMEOUT,
    *,
    is_trusted: bool = False,
    runner: Runner | None = None,
) -> dict[str, str]:
    """Repeat the experiment in `folder`; returns, by run id, how each finished run now differs.

    The text of a run is empty if the traces are equal bit by bit, or, without traces, if the
    metrics and the hashes of what robots did are equal. Runs are repeated from the manifest alone,
    and nothing in `folder` changes.

    - `out`: the folder in which all runs are repeated. None: the finished runs are repeated in a
      temporary folder.
    - `processes`: runs at a time.
    - `timeout`: a run fails after this time in s without progress.
    - `runner`: does the runs in place of `processes` worker processes.
    - `is_trusted`: the Python files that the manifest names run unchecked.

    ConfigError if `folder` is no experiment, has no finished run, or is `out`. Unless `is_trusted`,
    ConfigError also if such a Python file is new, has changed or has never been run by this user.
    """
    before = load_results(folder)
    if not before.runs:
        raise ConfigError(f"{folder}: no run of it has finished, so there is nothing to compare")
    if out is not None and out.resolve() == folder.resolve():
        raise ConfigError(f"--out {out} is the experiment itself; name another folder")
    old = read_manifest(folder)
    manifest = _again(folder, old, is_trusted=is_trusted)
    runner = runner or partial(run_jobs, processes=processes, timeout=timeout)
    run_again = partial(run_experiment, manifest, runner=runner, on_progress=on_progress)
    if out is not None:
        return _comparisons(before, run_again(out))
    finished = {run.id for run in before.runs}
    with TemporaryDirectory(prefix="swarmd-exp-") as temporary:
        return _comparisons(before, run_again(Path(temporary), only=finished))


def _again(folder: Path, old: Manifest, *, is_trusted: bool) -> Manifest:
    """The manifest of the same runs, with the present software.

    ConfigError if a Python file that the manifest names is new, has changed or has never been run
    by this user, unless `is_trusted`.
    """
    patterns = digests_of_folders(plugin_folders(old.plan)).items()
    code = {
        name: digest
        for name, digest in patterns
        if name.endswith(".py") or (name.endswith(MISSION) and is_code(name))
    }
    files = [metric.origin for metric in old.metrics if names_file(metric.origin)]
    code |= {origin: digest_of_file(origin) for origin in files}
    check_code(folder, old.plugins, code, is_trusted=is_trusted)
    for variant in old.plan.variants:  # such as of a pattern that is not installed here
        scenario_of(variant.effective)
    metrics = [metric_of(metric.origin, code.get(metric.origin, "")) for metric in old.metrics]
    return manifest_of(
        old.plan, traces=old.traces, command=old.command, metrics=metrics, shown=old.shown
    )


def _comparisons(before: Results, after: Results) -> dict[str, str]:
    """The difference of each finished run of `before` as a text, by run."""
    old, new = ({row["run"]: row for row in results.rows} for results in (before, after))
    return {run: _difference(before, after, run, old[run], new.get(run, {})) for run in old}


def _difference(
    before: Results, after: Results, run: str, old: Mapping[str, Any], new: Mapping[str, Any]
) -> str:
    if run in after.failures:
        return f"failed now: {after.failures[run]}"
    both = [name for name in before.metrics if name in after.metrics]
    differing_metrics = ", ".join(name for name in both if old[name] != new[name])
    try:
        traces = before.traces[run], after.traces[run]
    except SwarmError:  # not kept, removed or damaged: metrics and the hash are compared
        if differing_metrics:
            return f"metrics: {differing_metrics}"
        hashes = [str(row["bits"]) for row in (old, new)]
        is_other = all(hashes) and hashes[0] != hashes[1]
        return f"the bits of what robots did: {hashes[1]}, were {hashes[0]}" if is_other else ""
    if differing_fields := ", ".join(trace_differences(*traces)):
        return "; ".join(filter(None, (f"trace: {differing_fields}", first_difference(*traces))))
    return f"metrics of the same trace: {differing_metrics}" if differing_metrics else ""

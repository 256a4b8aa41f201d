"""Experiments from Python: a scenario, over seeds, with statistics.

::

    from swarmd.sim.experiments.simulate import simulate
    results = simulate("aggregation", seeds=20)
    print(results)

The same as `swarmctl exp run`, with the same results to the last bit.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from numbers import Integral
from pathlib import Path
from typing import Any, cast

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.manifest import Manifest, manifest_of, plain
from swarmd.sim.experiments.plan import Plan, Run, check_seeds, make_plan
from swarmd.sim.experiments.pool import STEP_TIMEOUT, Job, JobResult, run_job, run_jobs
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Store, open_store
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.scenarios.overrides import SOURCE, SWEEP_SOURCE
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of

OnProgress = Callable[[int, int, int], None]
"""Called after each run with the number of runs that are done, of all, and that have failed."""


def simulate(
    scenario: str | Path | Scenario,
    seeds: int | Iterable[int] = 20,
    *,
    set: Mapping[str, Any] | None = None,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    jobs: int = 1,
    out: str | Path | None = None,
    traces: bool = True,
    timeout: float = STEP_TIMEOUT,
) -> Results:
    """Run a scenario once for each seed (a number n means 0 to n - 1), and measure every run.

    `set` and `sweep` are by dotted key of the scenario's file: `{"groups.all.count": 5}`, and
    `{"groups.all.parameters.law": ["ours", "paper"]}` for every combination. With `jobs` above 1
    as many worker processes do the runs, from scripts and notebooks alike; with 1, this process
    does them. The results are the same, bit by bit. In worker processes, a run without progress
    for `timeout` s is ended and has failed. `out` is a folder as of `swarmctl exp`; the same call
    continues an interrupted one. Without `out`, the results are deleted with the returned object.

    ConfigError before anything runs if scenario, seeds or overrides are invalid. Failed runs are
    in `failures` of the results; SwarmError if all runs failed.
    """
    if jobs < 1:
        raise ConfigError(f"jobs is {jobs}; expected 1 or more")
    if not timeout >= 1.0:
        raise ConfigError(f"timeout is {timeout:g}; expected 1 s or more")
    listed = range(int(seeds)) if isinstance(seeds, Integral) else cast("Iterable[int]", seeds)
    plan = plan_of(scenario, listed, set, sweep)
    manifest = manifest_of(plan, traces=traces, command=[])
    folder = Path(tempfile.mkdtemp(prefix="swarmd-exp-")) if out is None else Path(out)
    try:
        results = run_experiment(manifest, folder, jobs, is_here=jobs == 1, timeout=timeout)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if out is None:
        weakref.finalize(results, shutil.rmtree, folder, ignore_errors=True)
    if results.failures and not results.rows:
        run, reason = next(iter(results.failures.items()))
        raise SwarmError(f"all {len(results.failures)} runs failed; the first, {run}: {reason}")
    return results


def plan_of(
    scenario: str | Path | Scenario,
    seeds: Iterable[int],
    set: Mapping[str, Any] | None = None,
    sweep: Mapping[str, Sequence[Any]] | None = None,
) -> Plan:
    """The plan of an experiment; every variant of the scenario is checked, start poses too."""
    name = scenario.name if isinstance(scenario, Scenario) else str(scenario)
    first = check_seeds(seeds)
    given = [*([SOURCE] * bool(set)), *([SWEEP_SOURCE] * bool(sweep))]

    def effective(overrides: Mapping[str, Any]) -> Mapping[str, Any]:
        found = _overridden(scenario, overrides, " or ".join(given))
        found.starts(first[0])
        return plain(found.effective)

    return make_plan(name, first, set or {}, sweep or {}, effective)


def run_experiment(
    manifest: Manifest,
    folder: Path,
    processes: int,
    *,
    is_here: bool = False,
    only: Collection[str] | None = None,
    timeout: float = STEP_TIMEOUT,
    on_progress: OnProgress | None = None,
) -> Results:
    """Do all runs of a manifest that are missing in its folder, and write the summary.

    `only` limits the runs. `is_here`: in this process, without `timeout`. If it ends early, the
    finished runs stay in the folder. SwarmError if the folder cannot be used or the disk is full.
    """
    with open_store(folder, manifest, tuple(METRICS)) as store:
        try:
            runs = [run for run in store.missing if only is None or run.id in only]
            jobs = [Job(r.id, r.variant.effective, r.seed, store.trace_of(r)) for r in runs]
            found = (
                (run_job(job) for job in jobs) if is_here else run_jobs(jobs, processes, timeout)
            )
            _gather(store, runs, found, on_progress)
        except BaseException:
            with suppress(SwarmError, OSError):  # the first error is the one to report
                store.close(_results(store).document())
            raise
        results = _results(store)
        store.close(results.document())
        return results


def _gather(
    store: Store,
    runs: Sequence[Run],
    run_jobs: Generator[JobResult, None, None],
    on_progress: OnProgress | None,
) -> None:
    """Keep each result as it arrives; SwarmError if one cannot be written."""
    by_id = {run.id: run for run in runs}
    total = len(store.rows) + len(runs)
    report = on_progress or (lambda done, total, failed: None)
    with closing(run_jobs) as found:
        report(len(store.rows), total, 0)
        for result in found:
            if result.write_error:
                text = f"{result.write_error}; {len(store.rows)} finished runs are kept"
                raise SwarmError(f"{text}: mend it and give the same command again")
            if result.metrics is None:
                store.fail(by_id[result.run], result.reason)
            else:
                store.add(by_id[result.run], result.metrics, result.wall)
            failed = len(store.failures)
            report(len(store.rows) + failed, total, failed)


def _results(store: Store) -> Results:
    rows = [store.rows[run.id] for run in store.plan.runs if run.id in store.rows]
    return Results(store.folder, store.plan, rows, store.failures, tuple(METRICS))


def _overridden(
    scenario: str | Path | Scenario, overrides: Mapping[str, Any], source: str
) -> Scenario:
    if not isinstance(scenario, Scenario):
        return load_scenario(str(scenario), overrides, source=source)
    if not scenario.effective:
        raise ConfigError(
            f"scenario {scenario.name!r} has no effective configuration, so it could not be run"
            " again; make it with load_scenario or scenario_of"
        )
    return scenario_of(scenario.effective, overrides, source=source)

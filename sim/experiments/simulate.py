"""Experiments from Python: `simulate` runs a scenario with many seeds and measures the runs.

::

    from swarmd.sim.experiments.simulate import simulate

    spacings = {"groups.tb3.parameters.spacing": [0.6, 0.8]}
    results = simulate("aggregation", seeds=3, set={"duration": 20}, sweep=spacings)
    print(results)

`swarmctl exp run` uses the functions below; its results are the same to the last bit.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any, TypeAlias, cast

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.numbers import python_value
from swarmd.core.pin import functions_here
from swarmd.sim.experiments.executor import Executor, dask_cluster, on_executor
from swarmd.sim.experiments.known_runs import known_runs
from swarmd.sim.experiments.manifest import Manifest, manifest_of, plain
from swarmd.sim.experiments.plan import Plan, Run, check_seeds, make_plan, parse_shard
from swarmd.sim.experiments.pool import (
    STEP_TIMEOUT,
    Job,
    JobResult,
    Shares,
    has_workers,
    run_job,
    run_jobs,
)
from swarmd.sim.experiments.provenance import is_code
from swarmd.sim.experiments.results import CustomMetrics, Results, known_metrics
from swarmd.sim.experiments.run_list import list_runs
from swarmd.sim.experiments.store import Store, open_store
from swarmd.sim.experiments.trust import remember_code
from swarmd.sim.metrics.catalog import METRICS, Metric, beyond_catalog, metric_of
from swarmd.sim.metrics.protection import FAILED_PATTERNS
from swarmd.sim.scenarios.overrides import SOURCE, SWEEP_SOURCE
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of an experiment. A robot-second is one simulated second of one robot."""

    done: int  # runs that have ended, failed runs included
    total: int
    failed: int
    worked: float  # robot-seconds simulated since the start
    left: float
    """Robot-seconds to come.

    At least the longest running run's rest, times the number of running runs: workers may wait for
    the longest run."""


log = logging.getLogger(__name__)

_TRIAL = 1.0  # simulated s

OnProgress: TypeAlias = Callable[[Progress], None]
"""Called after each run, and several times a second while runs report progress."""

Runner: TypeAlias = Callable[[Sequence[Job]], Generator[JobResult | Shares, None, None]]
"""Does jobs in this process, in worker processes or by an executor: results as they arrive."""


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
    shard: str | None = None,
    cores: int = 1,
    metrics: Iterable[str | Metric] = (),
    on_progress: OnProgress | None = None,
    executor: Executor | None = None,
    in_process: bool = False,
    fresh: bool = False,
    scheduler: str | None = None,
) -> Results:
    """Run a scenario once for each seed (a number n means 0 to n - 1), and measure every run.

    - `set`: overrides by dotted key of the scenario's file: `{"groups.tb3.count": 5}`.
    - `sweep`: lists of values by dotted key: `{"groups.tb3.parameters.spacing": [0.6, 0.8]}`. Every
      combination is run.
    - `jobs`: worker processes that do the runs, from scripts and notebooks alike. The results are
      the same, bit by bit, with any number and on every x86-64 with the same software: workers are
      pinned (`swarmd.core.pin`). One worker stays for the next call, until this process ends.
    - `traces`: keep the trace of each run in the folder.
    - `timeout`: a run in a worker process fails after this time in s without progress.
    - `out`: the folder of the experiment, as for `swarmctl exp run`. A repeated call with this
      folder and equal arguments continues an interrupted experiment. Without `out` the results lie
      in a temporary folder, which is deleted with the returned object.
    - `cores`: the number of processes that share the robots of each run, for runs with many robots.
    - `metrics`: metrics besides those of the catalog: `report:...`, `reading:...`,
      `FILE.py:FUNCTION`.
    - `shard`: with "3/40" only the third of forty parts is run; `merge` joins the parts' folders.
    - `executor`: does the runs on its workers, in place of `jobs`: a `concurrent.futures.Executor`,
      such as that of Dask (`Client.get_executor`) or `mpi4py.futures`, or an executor of submitit.
      A worker has the same software, else SwarmError names the difference.
    - `in_process`: this process does the runs, for a debugger. It is not pinned, and the manifest
      says so: last bits may be others. Nothing is taken from the store of runs.
    - `fresh`: all runs are done, also those that the store of runs has, and none is kept there.
    - `scheduler`: deprecated, `executor` replaces it; the address of a Dask scheduler.
    - `on_progress`: called with the progress after each run, and in worker processes also during
      runs. `progress()` of `swarmd.sim.cli.progress` gives the display of `swarmctl exp run`.

    ConfigError before anything runs if scenario, seeds or overrides are invalid. Failed runs are
    in `failures` of the results. SwarmError if all runs failed.
    """
    if scheduler is not None:
        warnings.warn(
            "simulate(scheduler=ADDRESS) is deprecated: give executor=, such as"
            " Client(ADDRESS).get_executor(pure=False) of Dask; 0.4.0 takes scheduler away",
            DeprecationWarning,
            stacklevel=2,
        )
        if executor is not None:
            raise ConfigError("executor and scheduler both do the runs; leave out scheduler")
        with dask_cluster(scheduler, warn=log.warning) as cluster:
            return simulate(
                scenario,
                seeds,
                set=set,
                sweep=sweep,
                jobs=jobs,
                out=out,
                traces=traces,
                timeout=timeout,
                shard=shard,
                cores=cores,
                metrics=metrics,
                on_progress=on_progress,
                executor=cluster,
                in_process=in_process,
                fresh=fresh,
            )
    if jobs < 1:
        raise ConfigError(f"jobs is {jobs}; expected 1 or more")
    if cores < 1:
        raise ConfigError(f"cores is {cores}; expected 1 or more")
    if not timeout >= 1.0:
        raise ConfigError(f"timeout is {timeout:g}; expected 1 s or more")
    seed_list = range(int(seeds)) if isinstance(seeds, Integral) else cast("Iterable[int]", seeds)
    plan = plan_of(scenario, seed_list, set, sweep)
    if shard is not None:
        plan = replace(plan, shard=parse_shard(shard))
    custom = beyond_catalog(map(metric_of, metrics))
    if in_process and (executor is not None or max(jobs, cores) > 1):
        raise ConfigError("in_process stands alone; leave out jobs, cores and executor")
    is_here = in_process or (executor is None and not has_workers())
    runner = run_here if is_here else runner_of(jobs, timeout, cores, executor)
    functions = functions_here() if is_here else None
    manifest = manifest_of(plan, traces=traces, command=[], metrics=custom, functions=functions)
    known = known_runs(manifest.made_with, is_fresh=fresh or is_here)
    if known is not None:
        runner = known.runner(runner)
    folder = Path(tempfile.mkdtemp(prefix="swarmd-exp-")) if out is None else Path(out)
    try:
        results = run_experiment(manifest, folder, runner, on_progress=on_progress)
        if not is_here:
            list_runs(results, is_named=not isinstance(scenario, Scenario))
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


def runner_of(
    jobs: int = 1, timeout: float = STEP_TIMEOUT, cores: int = 1, executor: Executor | None = None
) -> Runner:
    """What does the runs: `executor`, else `jobs` worker processes; this process without workers.

    `timeout`: s without progress after which a run fails, except in this process. `cores`: the
    number of processes that share the robots of a run. ConfigError for `jobs` beside `executor`.
    """
    if executor is not None:
        if jobs > 1:
            raise ConfigError(f"jobs is {jobs} beside an executor, whose workers set the number")
        return on_executor(executor, timeout, cores)
    if has_workers():
        return partial(run_jobs, processes=jobs, timeout=timeout, cores=cores)
    return run_here


def plan_of(
    scenario: str | Path | Scenario,
    seeds: Iterable[int],
    set: Mapping[str, Any] | None = None,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    *,
    on_note: Callable[[str], object] = str,
    source: str = "",
) -> Plan:
    """The plan of an experiment: all variants of the scenario with all seeds.

    `set`: overrides by dotted key. `sweep`: lists of values by dotted key; each combination of
    values is a variant. Each variant and its start poses are checked; ConfigError for an invalid
    variant. `on_note` is called once with each note of the variants. `source`: how the error of a
    wrong override begins; empty: with --set or --sweep.
    """
    name = scenario.name if isinstance(scenario, Scenario) else str(scenario)
    checked_seeds = check_seeds(seeds)
    reported_notes: dict[str, None] = {}
    sources = [option for option, keys in ((SOURCE, set), (SWEEP_SOURCE, sweep)) if keys]

    def effective(overrides: Mapping[str, Any]) -> Mapping[str, Any]:
        """The complete scenario of a variant; ConfigError if the variant is invalid."""
        variant = _overridden(scenario, overrides, source or " or ".join(sources))
        variant.starts(checked_seeds[0])  # ConfigError if there is no room for the robots
        for note in variant.notes:
            if note not in reported_notes:
                on_note(note)
        reported_notes.update(dict.fromkeys(variant.notes))
        return plain(variant.effective)

    sets = python_value(set or {})
    sweeps = python_value(sweep or {})
    return make_plan(name, checked_seeds, sets, sweeps, effective)


def run_experiment(
    manifest: Manifest,
    folder: Path,
    runner: Runner,
    *,
    only: Collection[str] | None = None,
    on_progress: OnProgress | None = None,
    summarized: Sequence[Metric] | None = None,
) -> Results:
    """Do the runs of a manifest that `folder` does not have yet, and write the summary.

    `runner` does the runs. `only`: ids of the runs to do; None: all. `summarized`: the metrics of
    the summary; None: all. If an error or a signal ends this function early, the finished runs stay
    in the folder, and a later call does the rest. SwarmError if the folder cannot be used or the
    disk is full.
    """
    # SHA-256 of the user's patterns and missions by path, and of custom metrics by origin.
    digests = manifest.plugins
    # The user runs this code now, so the code counts as trusted: `exp rerun` may run it later. The
    # file of a mission holds no code.
    remember_code(digest for name, digest in digests.items() if is_code(name))
    metric_digests = {metric.origin: digests.get(metric.origin, "") for metric in manifest.metrics}
    columns = (*METRICS, *(metric.name for metric in manifest.metrics))
    with open_store(folder, manifest, columns) as store:
        try:
            runs = [run for run in store.missing if only is None or run.id in only]
            jobs = [
                Job(
                    run.id,
                    run.variant.effective,
                    run.seed,
                    store.trace_of(run),
                    metrics=metric_digests,
                )
                for run in runs
            ]
            _gather(store, runs, runner(jobs), on_progress)
        except BaseException:
            with suppress(SwarmError, OSError):  # the first error is the one to report
                store.close(_results(store).document(summarized))
            raise
        results = _results(store)
        store.close(results.document(summarized))
        return results


def check_first_second(plan: Plan, runner: Runner) -> None:
    """Simulate the first second of the first run; SwarmError if a pattern raises an error in it.

    `runner` does the run. If the run fails for another reason, it fails again when its turn comes.
    """
    run = plan.runs[0]
    trial = Job(run.id, run.variant.effective, run.seed, None, seconds=_TRIAL)
    with closing(runner([trial])) as reports:
        for result in reports:
            if isinstance(result, JobResult) and FAILED_PATTERNS in result.errors:
                raise SwarmError(
                    f"{result.errors[FAILED_PATTERNS]} of run {run.id}; no run was begun: correct"
                    " the pattern"
                )


class _Work:
    """The work of an experiment's runs in robot-seconds, for the progress."""

    def __init__(self, work: Mapping[str, float]) -> None:
        """`work`: of all runs to do, by run."""
        self.shares: dict[str, float] = {}  # simulated share 0..1 of runs in progress, by run
        self._work = work
        self._ended = 0.0  # simulated by runs that have ended
        self._to_end = sum(work.values())  # of all runs that have not ended

    def end(self, run: str, *, has_failed: bool) -> None:
        """Count a run that has ended; a failed run has done its last reported share."""
        last_share = self.shares.pop(run, 0.0)
        self._ended += self._work[run] * last_share if has_failed else self._work[run]
        self._to_end -= self._work[run]

    def leave_out(self, run: str) -> None:
        """Take away a run that is not simulated: its result was known."""
        self._to_end -= self._work[run]

    def done_and_left(self) -> tuple[float, float]:
        """The work that is simulated, and the work that is left, in robot-seconds.

        At the end of an experiment some workers have no further run, and wait until the longest run
        ends. So the work left is at least the rest of the longest run, times the number of runs in
        progress.
        """
        begun = sum(self._work[run] * share for run, share in self.shares.items())
        rests = [self._work[run] * (1.0 - share) for run, share in self.shares.items()]
        longest = max(rests, default=0.0)
        return self._ended + begun, max(self._to_end - begun, longest * len(self.shares))


def _gather(
    store: Store,
    runs: Sequence[Run],
    reports: Generator[JobResult | Shares, None, None],
    on_progress: OnProgress | None,
) -> None:
    """Write each result to the store as it arrives, and report the progress.

    `reports`: of a runner; the result of each run of `runs`, and between results the simulated
    share (0..1) of each run in progress. SwarmError if a result cannot be written.
    """
    run_by_id = {run.id: run for run in runs}
    work = _Work({run.id: run.robot_seconds for run in runs})
    total = len(store.rows) + len(runs)

    def report_progress() -> None:
        if on_progress is not None:
            failed = len(store.failures)
            done = len(store.rows) + failed
            on_progress(Progress(done, total, failed, *work.done_and_left()))

    with closing(reports):
        report_progress()
        for result in reports:
            if not isinstance(result, JobResult):
                work.shares = dict(result)
                report_progress()
                continue
            if result.write_error:
                text = f"{result.write_error}; {len(store.rows)} finished runs are kept"
                raise SwarmError(f"{text}: mend it and give the same command again")
            if result.metrics is None:
                store.fail(run_by_id[result.run], result.reason)
            else:
                wall = None if result.stored else result.wall
                run = run_by_id[result.run]
                store.add(
                    run,
                    result.metrics,
                    wall,
                    result.errors,
                    bits=result.bits,
                    rules=result.rules,
                )
            if result.stored:
                work.leave_out(result.run)
            else:
                work.end(result.run, has_failed=result.metrics is None)
            report_progress()


def run_here(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
    """The results of jobs done in this process, without time-outs."""
    yield from map(run_job, jobs)


def _results(store: Store) -> Results:
    rows = [store.rows[run.id] for run in store.plan.runs if run.id in store.rows]
    return Results(
        store.folder,
        store.plan,
        rows,
        store.failures,
        (*METRICS, *(metric.name for metric in store.manifest.metrics)),
        store.manifest.made_with["kernels"],
        CustomMetrics(
            known_metrics(store.manifest, store.folder, is_trusted=True),
            store.errors,
            is_trusted=True,
            report_units=store.manifest.report_units,
        ),
    )


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

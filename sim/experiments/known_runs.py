"""Takes runs that are known from the store of runs, and lets a runner do the others.

One taken run in fifty, by chance, is done again and compared. An experiment takes no stored run
before all of these are equal.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from pathlib import Path
from random import SystemRandom
from typing import TYPE_CHECKING

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.pool import Job, JobResult, Shares, worker_functions
from swarmd.sim.experiments.provenance import made_with as made_with_now
from swarmd.sim.experiments.run_key import RunKeys
from swarmd.sim.experiments.run_store import Entry, RunStore, run_store
from swarmd.sim.experiments.trace_differences import first_difference, trace_differences
from swarmd.sim.trace import load_trace

if TYPE_CHECKING:
    from swarmd.sim.experiments.simulate import Runner

DONE_AGAIN = 1 / 50
"""The share of the taken runs that are done again."""
_KEPT_EVERY = 2.0
"""s between two times at which new results are kept: first the files are read again, of which
their keys were made (some 50 ms)."""


@dataclass(frozen=True, slots=True)
class _Known:
    """A job whose result is in the store."""

    job: Job
    entry: Entry


@dataclass(frozen=True, slots=True)
class _New:
    """A result that may be kept."""

    job: Job
    key: str
    result: JobResult
    """With metrics."""


class KnownRuns:
    """Runs from a store, for one command.

    - `taken`: the number of runs that were taken, by the day on which they were made.
    - `done_again`: the number of runs that were done again, and equal.
    - `refused`: why runs are neither taken nor kept.
    """

    def __init__(
        self,
        store: RunStore,
        made_with: Mapping[str, str] | None = None,
        *,
        chance: Callable[[], float] | None = None,
        today: Callable[[], date] = date.today,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`made_with`: the software of the runs; None: that of a worker of this process.

        `chance`: numbers in [0, 1); None: of the system, so that no seed of a program picks the
        runs that are done again.
        """
        self.taken: Counter[str] = Counter()
        self.done_again = 0
        self.refused: dict[str, None] = {}
        self._store = store
        self._made_with = made_with
        self._chance = SystemRandom().random if chance is None else chance
        self._today = today
        self._clock = clock

    def runner(self, inner: Runner) -> Runner:
        """A runner that takes the runs that are known, and lets `inner` do the others.

        It raises SwarmError if a run that is done again differs from the stored one.
        """

        def run(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
            yield from self._run(jobs, inner)

        return run

    def lines(self) -> list[str]:
        """What a user is told of the stored runs, and of runs that are not stored."""
        found = []
        if count := self.taken.total():
            days = ", ".join(sorted(self.taken))
            again = f"; {self.done_again} more done again, and equal" if self.done_again else ""
            found.append(
                f"{count} {'run' if count == 1 else 'runs'} taken from the store of runs, made on"
                f" {days}{again} (--fresh does all again)"
            )
        elif self.done_again:
            found.append(f"{self.done_again} of the store of runs done again, and equal")
        found += [f"runs are not stored: {reason}" for reason in self.refused]
        return found

    def _run(self, jobs: Sequence[Job], inner: Runner) -> Generator[JobResult | Shares, None, None]:
        if not jobs:
            return
        # Anew for each call: files may change between the batches of a tuning.
        made = made_with_now(worker_functions()) if self._made_with is None else self._made_with
        run_keys = RunKeys(made)
        keys = self._keys_of(jobs, run_keys)
        found: list[_Known] = []
        again: dict[str, _Known] = {}
        left: list[Job] = []
        for job in jobs:
            entry = self._found(job, keys.get(job.run, ""))
            if entry is None:
                left.append(job)
            elif self._chance() < DONE_AGAIN:
                again[job.run] = _Known(job, entry)
            else:
                found.append(_Known(job, entry))
        lost: list[Job] = []  # known runs that could not be handed out after all
        if not again:
            yield from self._hand_out(found, lost)
            found.clear()
            left += lost
            lost.clear()
        with_key = {job.run: (job, keys[job.run]) for job in left if job.run in keys}
        fresh = _Fresh(with_key, partial(self._keep, run_keys), self._clock)
        to_do = [*(one.job for one in again.values()), *left]
        try:
            with closing(_done(inner, to_do)) as reports:
                for report in reports:
                    if not isinstance(report, JobResult):
                        yield report
                        continue
                    result = replace(report, stored="")
                    if result.run in again:
                        self._compare(again.pop(result.run), result)
                    else:
                        fresh.add(result)
                    yield result
                    if not again:
                        yield from self._hand_out(found, lost)
                        found.clear()
        finally:
            fresh.keep()
        yield from self._hand_out(found, lost)
        yield from _done(inner, lost)

    def _hand_out(
        self, found: Sequence[_Known], lost: list[Job]
    ) -> Generator[JobResult, None, None]:
        """The results of known runs, with their traces; adds to `lost` what cannot be had."""
        for known in found:
            if self._store.hand_out(known.entry, known.job.trace):
                self.taken[known.entry.made] += 1
                yield JobResult(
                    known.job.run,
                    known.entry.metrics,
                    stored=known.entry.made,
                    bits=known.entry.bits,
                    rules=known.entry.rules,
                )
            else:
                lost.append(known.job)

    def _keys_of(self, jobs: Sequence[Job], run_keys: RunKeys) -> dict[str, str]:
        """The keys of the jobs that have one, by run."""
        found = {}
        for job in jobs:
            key = run_keys.key(job)
            if key.text:
                found[job.run] = key.text
            elif key.reason:
                self.refused[key.reason] = None
        return found

    def _found(self, job: Job, key: str) -> Entry | None:
        return self._store.find(key, has_trace=job.trace is not None) if key else None

    def _compare(self, known: _Known, result: JobResult) -> None:
        """SwarmError if a run that was done again differs from the store's; both are named.

        A run that failed, such as for want of memory, says nothing of the store's.
        """
        if result.metrics is None:
            return
        where = self._difference(known, result)
        if not where:
            self.done_again += 1
            return
        job = known.job
        entry = known.entry
        folder = self._store.put_aside(entry.key)
        here = "" if job.trace is None else f" ({job.trace})"
        raise SwarmError(
            f"{folder}: the stored run of {entry.made} of scenario"
            f" {job.effective.get('name') or '?'}, seed {job.seed}, is not the same as run"
            f" {job.run}{here}, which was done again: {where}; the stored one is put aside. Give"
            " --fresh and a new folder with --out, and report both: one of the two runs is wrong"
        )

    def _difference(self, known: _Known, result: JobResult) -> str:
        """The first metric that differs, or else the first array of the trace; empty if none."""
        now = result.metrics or {}
        then = known.entry.metrics
        for name in dict.fromkeys((*then, *now)):
            if name not in now or name not in then or not _is_same(then[name], now[name]):
                return f"{name} was {_shown(then, name)}, is {_shown(now, name)}"
        if known.entry.bits and result.bits and known.entry.bits != result.bits:
            return f"bits were {known.entry.bits}, are {result.bits}"
        if result.errors:
            name, why = next(iter(result.errors.items()))
            return f"{name}: {why}"
        return "" if known.job.trace is None else self._trace_difference(known, known.job.trace)

    def _trace_difference(self, known: _Known, trace: Path) -> str:
        stored = self._store.trace(known.entry)
        try:
            if stored is None or stored.read_bytes() == trace.read_bytes():
                return ""
            then = load_trace(stored)
            now = load_trace(trace)
        except (OSError, SwarmError):  # such as of an entry that was removed meanwhile
            return ""
        names = trace_differences(then, now)
        if not names:  # equal, and compressed by another zlib
            return ""
        return "; ".join(filter(None, (f"trace: {', '.join(names)}", first_difference(then, now))))

    def _keep(self, run_keys: RunKeys, results: Sequence[_New]) -> None:
        """Keep new results, if the files of which their keys were made have not changed."""
        if not results or not run_keys.still_hold():
            return
        made = self._today().isoformat()
        for one in results:
            self._store.keep(
                one.key,
                one.result.metrics or {},
                one.job.trace,
                made,
                bits=one.result.bits,
                rules=one.result.rules,
            )


class _Fresh:
    """New results that are not kept yet."""

    def __init__(
        self,
        jobs: Mapping[str, tuple[Job, str]],
        keep: Callable[[Sequence[_New]], None],
        clock: Callable[[], float],
    ) -> None:
        """`jobs`: those with a key, with it, by run. `keep`: puts results into the store."""
        self._jobs = jobs
        self._keep = keep
        self._clock = clock
        self._results: list[_New] = []
        self._kept_at = clock()

    def add(self, result: JobResult) -> None:
        """Take a result; one without metrics, or with errors, is not kept."""
        if result.metrics is None or result.errors or result.run not in self._jobs:
            return
        job, key = self._jobs[result.run]
        self._results.append(_New(job, key, result))
        if self._clock() - self._kept_at >= _KEPT_EVERY:
            self.keep()

    def keep(self) -> None:
        """Keep all results so far."""
        self._keep(self._results)
        self._results = []
        self._kept_at = self._clock()


def _done(inner: Runner, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
    """What a runner reports of jobs; without jobs no worker starts."""
    if jobs:
        with closing(inner(jobs)) as reports:
            yield from reports


def known_runs(
    made_with: Mapping[str, str] | None = None,
    *,
    is_fresh: bool = False,
    environ: Mapping[str, str] = os.environ,
) -> KnownRuns | None:
    """The known runs of a command; None if all runs are to be done (`is_fresh`, or it is off).

    `made_with`: as of KnownRuns. ConfigError for a wrong variable of the store.
    """
    store = None if is_fresh else run_store(environ)
    return None if store is None else KnownRuns(store, made_with)


def _is_same(a: float | None, b: float | None) -> bool:
    """Whether two values have equal bits: 0.0 and -0.0 differ."""
    return repr(a) == repr(b)


def _shown(metrics: Mapping[str, float | None], name: str) -> str:
    return repr(metrics[name]) if name in metrics else "missing"

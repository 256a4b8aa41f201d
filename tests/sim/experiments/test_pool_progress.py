"""Which progress a pool of workers reports, with workers that are no processes."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from swarmd.sim.experiments import pool
from swarmd.sim.experiments.pool import Job, JobResult, run_jobs


class InstantWorker:
    """A worker that has the result of each job at once."""

    is_alive, share = True, 0.25

    def __init__(self) -> None:
        self.pipe = object()

    def assign(self, job: Job) -> None:
        self.run = job.run

    def receive(self, silence: float, timeout: float) -> JobResult:
        return JobResult(self.run)

    def trim_log(self) -> None:
        """It writes no log."""

    end = kill = trim_log


def test_progress_is_that_of_runs_under_way_and_none_follows_the_last_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def wait(pipes: Sequence[object], timeout: float) -> Sequence[object]:
        return pipes

    kept = pool._KeptWorkers()
    monkeypatch.setattr(pool, "_Worker", InstantWorker)
    monkeypatch.setattr(pool, "_kept_workers", lambda: kept)
    monkeypatch.setattr(pool, "wait", wait)
    monkeypatch.setattr(pool, "_PROGRESS_PERIOD", 0.0)
    jobs = [Job(run, {}, 1, None) for run in ("a", "b")]
    found = [one.run if isinstance(one, JobResult) else one for one in run_jobs(jobs, 1)]
    assert found == ["a", {"b": 0.25}, "b"]

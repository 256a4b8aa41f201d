"""Wall time of 40 runs on one and on two worker processes of Dask: `make night ARGS=executors`.

Pairs in turn, so that other work on the machine changes both sides; each cluster has done a run
before, so that imports of its workers do not count. The control is `jobs` without an executor. A
speed-up of two workers needs two free cores: the load stands below the table.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.table import machine, markdown
from swarmd import simulate
from swarmd.sim.experiments.executor import Executor

RUNS = 40
ROUNDS = 2  # of some ten CPU-minutes
SCENARIO = "aggregation"


def wall_time(workers: int, executor: Executor | None) -> float:
    """s that the runs take, on an executor or else in `workers` processes of this machine."""
    start = time.perf_counter()
    jobs = workers if executor is None else 1
    results = simulate(SCENARIO, RUNS, jobs=jobs, executor=executor, traces=False, fresh=True)
    assert len(results.runs) == RUNS
    return time.perf_counter() - start


def on_dask(workers: int) -> float:
    """The wall time on a local cluster of `workers` processes."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(workers)
        if len(cluster.workers) != workers:
            raise RuntimeError(f"{len(cluster.workers)} workers where {workers} were wanted")
        executor = client.get_executor(pure=False)
        simulate(SCENARIO, workers, executor=executor, traces=False, fresh=True)
        return wall_time(workers, executor)


def table(times: Mapping[tuple[str, int], Sequence[float]]) -> str:
    """Markdown: a row for each engine. `times`: s of each round, by engine and workers.

    `{("Dask", 1): [40, 60], ("Dask", 2): [20, 40]}` is a row with 50 s, 30 s, and 1.75 times as
    fast.
    """
    rows = [["40 runs on", "1 process", "2 processes", "times as fast, by round"]]
    for engine in dict.fromkeys(name for name, _ in times):
        one, two = (np.asarray(times[engine, workers]) for workers in (1, 2))
        ratios = one / two
        shown = f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
        rows.append([engine, f"{np.median(one):.0f} s", f"{np.median(two):.0f} s", shown])
    return markdown(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.executors", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    rounds = parser.parse_args(arguments).rounds
    before = os.getloadavg()
    times: dict[tuple[str, int], list[float]] = {}
    for _ in range(rounds):
        for workers in (1, 2):
            times.setdefault(("Dask's workers", workers), []).append(on_dask(workers))
        for workers in (1, 2):
            times.setdefault(("`jobs`, no executor", workers), []).append(wall_time(workers, None))
    after = os.getloadavg()
    load = " -> ".join(" ".join(f"{one:.1f}" for one in some) for some in (before, after))
    print(f"{table(times)}\n\nLoad average (1, 5, 15 min) {load}; {machine()}.")


if __name__ == "__main__":
    main()

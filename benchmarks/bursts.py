"""Lockstep in short bursts that no other process interrupts: `python -m benchmarks bursts`.

Other work on the machine changes the figures of `lockstep.py` by factors of two. So each sample
here is a burst: with real-time priority, on one processor, without collection of garbage. A burst
takes less than a second, and a pause follows it, so that the machine stays usable. The kernel ends
a process that exceeds `LIMIT` (RLIMIT_RTTIME). Medians of ten bursts repeated within 5 % beside 30
processes of the same machine, and within 20 % on a virtual machine whose host was busy.

A burst covers whole periods of the scans, since these are the dearest steps. `python -m benchmarks
bursts --compare COMMIT` runs this file with the sources of both commits in turn.
"""

from __future__ import annotations

import gc
import math
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

from benchmarks.table import Row, print_table
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.lockstep.processes import RunProcess, run_processes
from swarmd.sim.scenarios.scenariofile import load_scenario

PRIORITY = 5
LIMIT = 3.0  # s in a burst; a burst of 1,000 robots takes some 0.4 s
PAUSE = 0.3  # s before a burst
BURSTS = 10
WARM_UP = 1.0  # s of simulation before the first burst
LENGTHS = {7: 0.4, 100: 0.4, 1000: 0.2}  # s of simulation in a burst; scans come every 0.2 s
PARTS = 5  # pairs of one core and two, in turn
GOALS = {
    (7, "attraction"): ">= 150 x",
    (100, "attraction"): ">= 8.5 x",
    (1000, "attraction"): ">= 0.75 x",
}
CORE_GOALS = {100: ">= 14 x", 1000: ">= 1.3 x"}
Burst = tuple[float, int]
"""s of wall time, and how often another process took the processor meanwhile."""


@contextmanager
def undisturbed(processor: int) -> Iterator[None]:
    """Real-time priority on `processor`, without collection of garbage; SystemExit if refused."""
    everywhere = os.sched_getaffinity(0)
    limits = resource.getrlimit(resource.RLIMIT_RTTIME)
    gc.collect()
    gc.disable()
    try:
        os.sched_setaffinity(0, {processor})
        resource.setrlimit(resource.RLIMIT_RTTIME, (int(1e6 * LIMIT), limits[1]))
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        except PermissionError:
            sys.exit(f"bursts need real-time priority {PRIORITY}; run as root, or raise ulimit -r")
        time.sleep(1e-3)  # the kernel counts towards LIMIT from the last sleep with this priority
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        resource.setrlimit(resource.RLIMIT_RTTIME, limits)
        os.sched_setaffinity(0, everywhere)
        gc.enable()


def burst(advance: Callable[[], object], processor: int) -> Burst:
    """Time one call of `advance` that no other process interrupts."""
    with undisturbed(processor):
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        start = time.perf_counter()
        advance()
        taken = time.perf_counter() - start
        return taken, resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw - before


def row(what: str, simulated: float, bursts: list[Burst], goal: str = "") -> Row:
    """The row of bursts of `simulated` s, in times real time."""
    disturbed = sum(switches > 0 for _, switches in bursts)
    note = f"another process took part in {disturbed} of {len(bursts)}" if disturbed else ""
    return Row(what, [simulated / taken for taken, _ in bursts], goal, note, unit="x")


def scenario_of(robots: int, pattern: str) -> tuple[str, Mapping[str, Any]]:
    """Experiment 1 with seven robots; else one robot a square metre, realistic, 360 rays."""
    if robots == 7:
        return "paper_exp1_waffle_pi", {"realism": "realistic"}
    side = math.sqrt(robots) + 0.1
    return "thousand", {
        "arena.size": [side, side],
        "groups.all.count": robots,
        "groups.all.pattern": pattern,
        "groups.all.start.clearance": 0.05,
    }


def one_core_rows() -> Iterator[Row]:
    processor = min(os.sched_getaffinity(0))
    for robots, pattern in (*GOALS, (100, "random_walk")):
        run = Lockstep(load_scenario(*scenario_of(robots, pattern)), seed=0)
        run.advance(WARM_UP)
        taken = []
        for _ in range(BURSTS):
            time.sleep(PAUSE)
            taken.append(burst(partial(run.advance, LENGTHS[robots]), processor))
        what = f"bursts on one core, {robots} robots, {pattern}"
        yield row(what, LENGTHS[robots], taken, GOALS.get((robots, pattern), ""))


def two_core_rows() -> Iterator[Row]:
    """PARTS pairs of runs on one core and on two, in turn; a sample is the median of a run."""
    for robots, goal in CORE_GOALS.items():
        simulate = partial(_bursts_of_share, robots)
        pairs = [[run_processes(simulate, cores) for cores in (1, 2)] for _ in range(PARTS)]
        what = f"bursts on two cores, {robots} robots, attraction"
        yield row(what, LENGTHS[robots], [two for _, two in pairs], goal)
        factors = [one / two for (one, _), (two, _) in pairs]
        yield Row(f"two cores against one, {robots} robots", factors, ">= 1.7 x", unit="x")


def _bursts_of_share(robots: int, process: RunProcess) -> Burst:
    """The median burst of one process of a run, and all times that another process took part."""
    run = Lockstep(load_scenario(*scenario_of(robots, "attraction")), 0, process)
    run.advance(WARM_UP)
    processor = sorted(os.sched_getaffinity(0))[process.index]
    taken = []
    for _ in range(BURSTS // 2):
        time.sleep(PAUSE)
        process.exchange(0)  # so that the bursts of the processes begin together
        taken.append(burst(partial(run.advance, LENGTHS[robots]), processor))
    return statistics.median(wall for wall, _ in taken), sum(switches for _, switches in taken)


def main() -> None:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    print_table("Lockstep in bursts, one processor", one_core_rows())
    print_table("Lockstep in bursts, one run on two processors", two_core_rows())


if __name__ == "__main__":
    main()

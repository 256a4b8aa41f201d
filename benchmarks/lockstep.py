"""Simulated time per second of processor time: `benchmarks.lockstep [--patterns ...] [--only ...]`.

Processor time of this process, for all parts of an experiment's run: physics, noisy lidars,
odometry, robots with protection, patterns, radio and the trace. Each sample is one simulated
second. The first second is left out, so that robots run and caches are warm as in a long run. Rows
of two cores are wall time, so they need an idle machine.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.table import Row, print_table
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.lockstep.processes import RunProcess, run_processes
from swarmd.sim.scenarios.scenariofile import load_scenario

TABLES = ("experiment", "sizes", "pucks", "argos", "growth", "cores")
SIZES = (7, 100, 1000)
PATTERNS = ("attraction", "random_walk", "drive")
SECONDS = {7: 20, 100: 10, 1000: 5}
GOALS = {7: ">= 100 x", 100: ">= 8 x", 1000: ">= 1 x"}

GROWTH = (100, 300, 1000, 3000, 10_000)  # rising, since memory is the most of the process so far
GROWTH_SECONDS = 2
# Like the proximity sensors of a foot-bot, which ARGoS gives 24 rays at 10 Hz.
SHORT_RAYS = {
    "groups.all.platform": "short_rays",
    "platforms.short_rays": {
        "extends": "waffle_pi",
        "scan": {"rays": 24, "rate": 10.0, "range_max": 1.2, "max_gap_deg": 40.0},
    },
}
# Ten robots without protection drive into a heap, from all sides.
HEAP = {
    "items.0.source": [0.0, 0.0, 0.9],
    "groups.tb3.pattern": "drive",
    "platforms": {"burger": {"extends": "burger", "protection": {"mode": "off"}}},
    "start": {"layout": "ring", "radius": 1.3, "heading_deg": 180.0},
}
CORE_GOALS = {100: ">= 14 x", 1000: ">= 1.8 x"}
CORE_PARTS = 5  # pairs of one core and two, in turn


def seconds_of(name: str, overrides: Mapping[str, Any], count: int) -> list[float]:
    """Processor seconds for each of `count` simulated seconds."""
    run = Lockstep(load_scenario(name, overrides), seed=0)
    run.advance(1.0)
    taken = []
    for _ in range(count):
        start = time.process_time()
        run.advance(1.0)
        taken.append(time.process_time() - start)
    return taken


def one_per_square_metre(n: int, pattern: str) -> Mapping[str, Any]:
    """Overrides of scenario `thousand` for n robots, in an arena of n m2 and a little more."""
    side = math.sqrt(n) + 0.1
    return {
        "arena.size": [side, side],
        "groups.all.count": n,
        "groups.all.pattern": pattern,
        "groups.all.start.clearance": 0.05,
    }


def experiment_rows() -> Iterator[Row]:
    mode = load_platform("waffle_pi").protection["mode"]
    for realism in ("ideal", "realistic"):
        taken = seconds_of("paper_exp1_waffle_pi", {"realism": realism}, SECONDS[7])
        factors = [1.0 / seconds for seconds in taken]
        note = f"experiment 1: attraction, 360 rays at 5 Hz, {mode}"
        yield Row(f"times real time, 7 robots, {realism}", factors, GOALS[7], note, unit="x")


def size_rows(patterns: Sequence[str]) -> Iterator[Row]:
    for pattern in patterns:
        for n in SIZES:
            taken = seconds_of("thousand", one_per_square_metre(n, pattern), SECONDS[n])
            goal = GOALS.get(n, "") if pattern == "attraction" else ""
            factors = [1.0 / seconds for seconds in taken]
            yield Row(f"times real time, {n} robots, {pattern}", factors, goal, unit="x")
            rates = [n / seconds for seconds in taken]
            yield Row(f"robot-seconds a CPU-second, {n}, {pattern}", rates, unit="")


def puck_rows(count: int = 20) -> Iterator[Row]:
    for what, overrides in (("random_walk", {}), ("driven into the heap", HEAP)):
        factors = [1.0 / seconds for seconds in seconds_of("pucks", overrides, count)]
        yield Row(f"times real time, 10 robots, 200 pucks, {what}", factors, ">= 1 x", unit="x")


def argos_rows(
    patterns: Sequence[str] = ("attraction", "random_walk"), seconds: int = SECONDS[1000]
) -> Iterator[Row]:
    n, name = 1000, "robot-seconds a CPU-second, 1000, 24 rays of 1.2 m at 10 Hz"
    for pattern in patterns:
        overrides = {**one_per_square_metre(n, pattern), **SHORT_RAYS}
        rates = [n / taken for taken in seconds_of("thousand", overrides, seconds)]
        note = "ARGoS with such robots: 4650"
        yield Row(f"{name}, {pattern}", rates, ">= 2000", note, unit="")


def growth_rows() -> Iterator[Row]:
    for n in GROWTH:
        taken = seconds_of("thousand", one_per_square_metre(n, "attraction"), GROWTH_SECONDS)
        yield Row(f"CPU a robot-second, {n} robots, attraction", [seconds / n for seconds in taken])
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
        yield Row(f"memory a robot, {n} robots", [memory / n], unit="MB")


def core_rows(sizes: Sequence[int] = (1000,), parts: int = CORE_PARTS) -> Iterator[Row]:
    for n in sizes:
        yield from _core_rows(n, parts)


def _core_rows(n: int, parts: int) -> Iterator[Row]:
    scenario = load_scenario("thousand", one_per_square_metre(n, "attraction"))

    def simulate(process: RunProcess) -> tuple[float, int]:
        run = Lockstep(scenario, 0, process)
        run.advance(0.2)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw
        start = time.perf_counter()
        run.advance(1.0)
        taken = time.perf_counter() - start
        return taken, resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw - before

    pairs = [[run_processes(simulate, cores) for cores in (1, 2)] for _ in range(parts)]
    disturbed = sum(switches > 0 for pair in pairs for _, switches in pair)
    note = f"another process took part in {disturbed} of {2 * parts} runs" if disturbed else ""
    what, ratio = f"lockstep on two cores, {n} robots", f"two cores against one, {n} robots"
    factors = [1.0 / on_two for _, (on_two, _) in pairs]
    yield Row(f"{what}, wall time", factors, CORE_GOALS[n], note, unit="x")
    factors = [on_one / on_two for (on_one, _), (on_two, _) in pairs]
    yield Row(f"{ratio}, wall time", factors, ">= 1.7 x", note, unit="x")


def main(arguments: Sequence[str] | None = None) -> None:
    # A matrix of two columns gains nothing from threads, and they would count as one processor.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lockstep", description=__doc__)
    parser.add_argument("--patterns", nargs="*", default=PATTERNS)
    parser.add_argument("--only", nargs="*", choices=TABLES, default=TABLES, help="these tables")
    given = parser.parse_args(arguments)
    tables = {
        "experiment": ("one processor: experiment 1", experiment_rows()),
        "sizes": ("one processor: one robot a square metre, realistic", size_rows(given.patterns)),
        "pucks": ("one processor: pucks that robots push", puck_rows()),
        "argos": ("one processor: short rays", argos_rows()),
        "growth": ("one processor: growth, one robot a square metre", growth_rows()),
        "cores": ("one run on two cores", core_rows()),
    }
    for name in given.only:
        title, rows = tables[name]
        print_table(f"Lockstep, {title}", rows)


if __name__ == "__main__":
    main()

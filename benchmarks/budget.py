"""Every budget in about three minutes: `make budget`. The benchmarks measure each for longer.

Figures of so few samples on a machine with other work differ from run to run; none is asserted.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence

from benchmarks import cdr, cli, latency, lidar, lockstep, protection, startup, steps, switch
from benchmarks.resources import (
    CPU_BUDGET,
    IDLE_BUDGET,
    MEMORY_BUDGETS,
    cpu_seconds,
    memory,
)
from benchmarks.swarm import Swarm
from benchmarks.table import Row, machine, print_table
from swarmd.core.kernels import describe_kernels
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.realism import REALISTIC
from tests.support.platforms import with_mode
from tests.support.processes import children

LIVE_SECONDS = 10.0
SWITCHES = 5
SIMULATED = {7: 5, 100: 2, 1000: 1}  # seconds of lockstep by number of robots
INTERPRETED_BUDGETS = {7: ">= 4 x", 100: ""}


def decision_rows() -> Iterator[Row]:
    platform = load_platform("waffle_pi")
    field = protection.Decider(
        with_mode(platform, "potential_field"), protection.among(platform, 4)
    )
    timing = steps.measure(field.scan)
    yield Row("scan and decision, potential_field, 4 neighbours", timing, "p99 1 ms")
    for neighbors in (1, 8):
        decider = protection.Decider(platform, protection.among(platform, neighbors))
        what = f"barrier, {neighbors} neighbours"
        timing = steps.measure(decider.scan)
        yield Row(f"scan and decision, {what}", timing, protection.SCAN_BUDGET)
        timing = steps.measure(decider.requested)
        yield Row(f"decision between scans, {what}", timing, protection.DECISION_BUDGETS[neighbors])
    yield from protection.moving_rows(load_platform("burger"))
    slowest = max(
        steps.pattern_rows(steps.in_an_arena(platform, 100)),
        key=lambda row: sorted(row.samples)[len(row.samples) // 2],
    )
    yield Row(f"slowest {slowest.what}", slowest.samples, slowest.budget)
    yield from (row for row in cdr.rows() if row.budget)


def simulation_rows() -> Iterator[Row]:
    world = lidar.make_world(1000, REALISTIC)
    yield from (row for row in lidar.rows_of(world) if row.budget)
    yield from lockstep_rows(SIMULATED, lockstep.BUDGETS)
    yield from lockstep.argos_rows(("attraction",), seconds=1)
    yield from lockstep.core_rows((100, 1000))
    command = [sys.executable, "-m", "benchmarks.budget", "--lockstep-factors"]
    environment = {**os.environ, "SWARMD_COMPILED": "0"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    for n, factors in json.loads(done.stdout).items():
        what = f"lockstep without kernels, {n} robots, attraction"
        yield Row(what, factors, INTERPRETED_BUDGETS[int(n)], unit="x")


def lockstep_rows(sizes: Mapping[int, int], budgets: Mapping[int, str]) -> Iterator[Row]:
    for n, seconds in sizes.items():
        factors = lockstep_factors(n, seconds)
        yield Row(f"lockstep, {n} robots, attraction", factors, budgets[n], unit="x")


def lockstep_factors(n: int, seconds: int) -> list[float]:
    """Times real time of each simulated second, realistic, one robot a square metre."""
    if n == 7:
        taken = lockstep.seconds_of("paper_exp1_waffle_pi", {"realism": "realistic"}, seconds)
    else:
        overrides = lockstep.one_per_square_metre(n, "attraction")
        taken = lockstep.seconds_of("thousand", overrides, seconds)
    return [1.0 / one for one in taken]


def live_rows() -> Iterator[Row]:
    """Latency, memory and CPU of one live swarm."""
    with Swarm(latency.ROBOTS) as swarm:
        pairs = [(daemon.pid, children(daemon.pid)[-1]) for daemon in swarm.daemons.values()]
        idle = cpu_of(pairs, LIVE_SECONDS)
        swarm.run("attraction")
        time.sleep(1.0)
        start = time.monotonic_ns()
        driving = cpu_of(pairs, LIVE_SECONDS)
        span = start, time.monotonic_ns() - 100_000_000
        rss, pss = (
            [sum(memory(pid, kind) for pid in pair) for pair in pairs] for kind in ("Rss", "Pss")
        )
        swarm.close()
        stamps = latency.read_stamps(swarm)
    for what, end, budget in (
        ("reflex", stamps.safe_back, latency.REFLEX_BUDGET),
        ("full", stamps.requested_back, latency.FULL_BUDGET),
    ):
        yield latency.row(f"{what}, 7 live daemons", budget, latency.between(stamps.put, end, span))
    yield Row("CPU, daemon + host, idle", idle, IDLE_BUDGET, unit="%")
    yield Row("CPU, daemon + host, driving", driving, CPU_BUDGET, unit="%")
    yield Row("RSS, daemon + host", rss, MEMORY_BUDGETS["Rss"], unit="MB")
    yield Row("PSS, daemon + host", pss, MEMORY_BUDGETS["Pss"], unit="MB")


def cpu_of(pairs: Sequence[tuple[int, int]], seconds: float) -> list[float]:
    """The % of a core that each daemon takes with its host, over `seconds`."""
    before, start = [sum(map(cpu_seconds, pair)) for pair in pairs], time.monotonic()
    time.sleep(seconds)
    passed = time.monotonic() - start
    return [
        100.0 * (sum(map(cpu_seconds, pair)) - b) / passed
        for pair, b in zip(pairs, before, strict=True)
    ]


def process_rows() -> Iterator[Row]:
    yield from (row for row in switch.rows(runs=SWITCHES) if row.budget)
    yield from (row for row in cli.rows(runs=SWITCHES) if row.budget)
    yield from startup.rows(runs=1)


def main(arguments: Sequence[str] | None = None) -> None:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    parser = argparse.ArgumentParser(prog="python -m benchmarks.budget", description=__doc__)
    parser.add_argument("--lockstep-factors", action="store_true", help="used by this program")
    if parser.parse_args(arguments).lockstep_factors:
        print(json.dumps({n: lockstep_factors(n, 1) for n in INTERPRETED_BUDGETS}))
        return
    print(f"Measured on {machine()}; kernels: {describe_kernels()}.")
    groups = (decision_rows, simulation_rows, live_rows, process_rows)
    print_table("Budgets", (row for group in groups for row in group()))


if __name__ == "__main__":
    main()

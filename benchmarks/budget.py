"""Every budget as a ratio to a yardstick of the same run, in about three minutes: `make budget`.

A figure is measured in turn with its yardstick (`benchmarks/yardsticks.py`), and the median of
their ratios is held against the budget: so the same budgets hold on any machine. The absolute
figure stands beside it without a verdict. A budget is the ratio of the last release plus twice its
spread (lockstep 11 %, driving 19 %, idle 24 %); it falls with the ratio. The exit code is 1 if a
budget does not hold.

Rows of the command line have a verdict only where real-time priority is permitted (root, or
`ulimit -r 5`): without, their ratios spread by 58 %.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from benchmarks import cdr, cli, latency, lidar, lockstep, looks, protection, startup, steps, switch
from benchmarks.resources import cpu_seconds, memory
from benchmarks.swarm import Swarm
from benchmarks.table import Row, machine, markdown, show
from benchmarks.yardsticks import Peer, mixed, real_time
from swarmd.core.kernels import describe_kernels
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.world.realism import REALISTIC
from tests.support.platforms import with_mode
from tests.support.processes import children

LIVE_SECONDS = 10.0
RUNS = 5
DAEMONS, COMMANDS = 2, 5  # real-time priorities
SIMULATED = {7: 10, 100: 4, 1000: 2}  # seconds of lockstep by number of robots
UNITS = 5  # of `mixed` before and after each sample of another unit of work
BUDGETS: Mapping[str, float] = {
    "scan and decision, potential_field, 4 neighbours": 0.013,
    "scan and decision, barrier, 1 neighbours": 0.012,
    "decision between scans, barrier, 1 neighbours": 0.0037,
    "scan and decision, barrier, 8 neighbours": 0.025,
    "decision between scans, barrier, 8 neighbours": 0.0095,
    "scan with de-skew and decision, at rest, 1 neighbours": 0.013,
    "scan with de-skew and decision, turning with the sweep, 1 neighbours": 0.023,
    "scan with de-skew and decision, turning against the sweep, 1 neighbours": 0.024,
    "scan with de-skew and decision, at rest, 8 neighbours": 0.052,
    "scan with de-skew and decision, turning with the sweep, 8 neighbours": 0.063,
    "scan with de-skew and decision, turning against the sweep, 8 neighbours": 0.066,
    "slowest step of a pattern": 0.04,
    "LaserScan, 360 rays, read": 0.0017,
    "scan, 1000 robots, 50 at once": 0.0053,
    "lockstep, 7 robots, attraction": 5.2,
    "lockstep, 100 robots, attraction": 76,
    "lockstep, 1000 robots, attraction": 791,
    "lockstep, 1000 robots, 24 short rays": 732,
    "lockstep without kernels, 7 robots, attraction": 54,
    "reflex, 7 live daemons": 3.8,
    "full, 7 live daemons": 8.6,
    "CPU, daemon + host, idle": 0.64,
    "CPU, daemon + host, driving": 1.6,
    "RSS, daemon + host": 108,
    "PSS, daemon + host": 56,
    "swarmctl --help": 5,
    "swarmctl members, cold": 9.7,
    "swarmctl run --all, 20 daemons": 20,
    "swarmctl members, 20 daemons": 7.2,
    "swarmctl members, 100 robots": 18,
    "CPU of members, each of 100 robots": 0.072,
    "CPU of a stop, 20 robots without acks": 8.5,
}
"""By row, the largest ratio to its yardstick; of memory, MB."""


@dataclass(frozen=True, slots=True)
class Ratio:
    """A figure beside its yardsticks: one for each sample, or some for all; none of memory."""

    row: Row
    yardsticks: Sequence[float] = ()
    has_verdict: bool = True

    @property
    def value(self) -> float:
        """The median of the ratios; of a row without a yardstick its own median."""
        samples, beside = self.row.samples, self.yardsticks or [1.0]
        if len(beside) == len(samples):
            return statistics.median(a / b for a, b in zip(samples, beside, strict=True))
        return statistics.median(samples) / statistics.median(beside)

    @property
    def excess(self) -> float | None:
        """How far the ratio is above its budget, as a share; None if there is no verdict."""
        budget = BUDGETS.get(self.row.what)
        return self.value / budget - 1.0 if budget and self.has_verdict else None

    def cells(self) -> tuple[str, ...]:
        """The texts of the columns of the table."""
        excess, budget = self.excess, BUDGETS.get(self.row.what)
        held = "" if excess is None else "yes" if excess <= 0.0 else "**no**"
        middle, unit = statistics.median(self.row.samples), self.row.unit
        is_rate = unit == "s" and self.row.goal.endswith(" x")
        now = show(1.0 / middle, "x") if is_rate else show(middle, unit)
        yardstick = show(statistics.median(self.yardsticks), unit) if self.yardsticks else ""
        limit = f"{budget:.3g}" if budget else ""
        return (self.row.what, f"{self.value:.3g}", limit, held, now, yardstick, self.row.goal)


HEAD = ("what", "ratio", "budget", "holds", "now", "yardstick", "goal")


class Bench:
    """Measures work in one process in turn with `mixed`."""

    def __init__(self) -> None:
        self._unit = mixed()
        self._unit()

    def unit(self) -> float:
        """The median processor time of UNITS units in s."""
        return statistics.median(self._unit() for _ in range(UNITS))

    def in_turn(self, rows: Iterator[Row]) -> Iterator[Ratio]:
        """Each row that has a goal as soon as it is measured, and the unit before and after it."""
        before = self.unit()
        for row in rows:
            after = self.unit()
            if row.goal:
                yield Ratio(row, [0.5 * (before + after)])
            before = after

    def lockstep(self, name: str, robots: int, seconds: int) -> Ratio:
        """Processor time of each simulated second, realistic, one robot a square metre."""
        overrides: Mapping[str, object] = {"realism": "realistic"}
        scenario = "paper_exp1_waffle_pi"
        if robots != 7:
            scenario, overrides = "thousand", lockstep.one_per_square_metre(robots, "attraction")
        return self.simulated(Row(name, [], lockstep.GOALS[robots]), scenario, overrides, seconds)

    def simulated(
        self, row: Row, scenario: str, overrides: Mapping[str, object], seconds: int
    ) -> Ratio:
        """`row` with the processor time of each simulated second of a scenario."""
        run = Lockstep(load_scenario(scenario, overrides), seed=0)
        run.advance(1.0)
        taken, units = [], [self.unit()]
        for _ in range(seconds):
            start = time.process_time()
            run.advance(1.0)
            taken.append(time.process_time() - start)
            units.append(self.unit())
        beside = [0.5 * (units[at] + units[at + 1]) for at in range(seconds)]
        return Ratio(Row(row.what, taken, row.goal), beside)


def kernel_rows() -> Iterator[Row]:
    """Decisions of protection, steps of patterns, messages decoded, scans simulated."""
    platform = load_platform("waffle_pi")
    field = protection.Decider(
        with_mode(platform, "potential_field"), protection.among(platform, 4)
    )
    timing = steps.measure(field.scan)
    yield Row("scan and decision, potential_field, 4 neighbours", timing, "p99 1 ms")
    for neighbors in (1, 8):
        decider = protection.Decider(platform, protection.among(platform, neighbors))
        what, goal = f"barrier, {neighbors} neighbours", protection.DECISION_GOALS[neighbors]
        timing = steps.measure(decider.scan)
        yield Row(f"scan and decision, {what}", timing, protection.SCAN_GOAL)
        yield Row(f"decision between scans, {what}", steps.measure(decider.requested), goal)
    yield from protection.moving_rows(load_platform("burger"))
    slowest = max(
        steps.pattern_rows(steps.in_an_arena(platform, 100)),
        key=lambda row: statistics.median(row.samples),
    )
    yield Row("slowest step of a pattern", slowest.samples, slowest.goal)
    yield from cdr.rows()
    yield from lidar.rows_of(lidar.make_world(1000, REALISTIC))


def simulation_ratios(bench: Bench) -> Iterator[Ratio]:
    for robots, seconds in SIMULATED.items():
        yield bench.lockstep(f"lockstep, {robots} robots, attraction", robots, seconds)
    short = {**lockstep.one_per_square_metre(1000, "attraction"), **lockstep.SHORT_RAYS}
    yield bench.simulated(
        Row("lockstep, 1000 robots, 24 short rays", [], ">= 2 x"), "thousand", short, 1
    )
    for rows in (lockstep.core_rows((100,), parts=3), lockstep.core_rows((1000,), parts=2)):
        two, ratio = rows
        yield Ratio(Row(two.what, two.samples, two.goal, unit="x"), has_verdict=False)
        yield Ratio(ratio, has_verdict=False)
    command = [sys.executable, "-m", "benchmarks.budget", "--interpreted"]
    environment = {**os.environ, "SWARMD_COMPILED": "0"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    taken, units = json.loads(done.stdout)
    yield Ratio(Row("lockstep without kernels, 7 robots, attraction", taken, ">= 4 x"), units)


def live_ratios() -> Iterator[Ratio]:
    """CPU, memory and latency of a live swarm beside a peer that runs at the same time."""
    with Swarm(latency.ROBOTS) as swarm, Peer() as peer:
        pairs = [(daemon.pid, children(daemon.pid)[-1]) for daemon in swarm.daemons.values()]
        idle = cpu_of([*pairs, (peer.pid,)], LIVE_SECONDS)
        swarm.run("attraction")
        time.sleep(1.0)
        start = time.monotonic_ns()
        driving = cpu_of([*pairs, (peer.pid,)], LIVE_SECONDS)
        span = start, time.monotonic_ns() - 100_000_000
        rss, pss = (
            [sum(memory(pid, kind) for pid in pair) for pair in pairs] for kind in ("Rss", "Pss")
        )
        swarm.close()
        stamps = latency.read_stamps(swarm)
    for what, end, goal in (
        ("reflex", stamps.safe_back, latency.REFLEX_GOAL),
        ("full", stamps.requested_back, latency.FULL_GOAL),
    ):
        row = latency.row(f"{what}, 7 live daemons", goal, latency.between(stamps.put, end, span))
        yield Ratio(row, [peer.hop])
    for what, used, goal in (("idle", idle, "1.2 %"), ("driving", driving, "2.2 %")):
        *daemons, beside = used
        yield Ratio(Row(f"CPU, daemon + host, {what}", daemons, goal, unit="%"), [beside])
    yield Ratio(Row("RSS, daemon + host", rss, "90 MB", unit="MB"))
    yield Ratio(Row("PSS, daemon + host", pss, "45 MB", unit="MB"))


def cpu_of(groups: Sequence[Sequence[int]], seconds: float) -> list[float]:
    """The % of a core that the processes of each group take together, over `seconds`."""
    before, start = [sum(map(cpu_seconds, group)) for group in groups], time.monotonic()
    time.sleep(seconds)
    passed = time.monotonic() - start
    return [
        100.0 * (sum(map(cpu_seconds, group)) - used) / passed
        for group, used in zip(groups, before, strict=True)
    ]


def command_ratios() -> Iterator[Ratio]:
    """Commands beside a Python that opens a Zenoh session, both at real-time priority."""
    with real_time(DAEMONS) as is_real_time:
        prefix = ["chrt", "--fifo", str(COMMANDS)] if is_real_time else []
        opened, *rows = cli.rows(RUNS, prefix)
    # Twenty daemons in real time would keep the processor from the threads of this process.
    rows += switch.rows(runs=RUNS, prefix=prefix)
    rows += looks.rows(runs=RUNS, prefix=prefix)
    yield from (Ratio(row, opened.samples, is_real_time) for row in rows if row.goal)
    for row in startup.rows(runs=1):
        yield Ratio(row, opened.samples, has_verdict=False)


def main(arguments: Sequence[str] | None = None) -> int:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    parser = argparse.ArgumentParser(prog="python -m benchmarks.budget", description=__doc__)
    parser.add_argument("--interpreted", action="store_true", help="used by this program")
    bench = Bench()
    if parser.parse_args(arguments).interpreted:
        ratio = bench.lockstep("", 7, 2)
        print(json.dumps([ratio.row.samples, ratio.yardsticks]))
        return 0
    print(f"Measured on {machine()}; kernels: {describe_kernels()}.\n")
    groups = (
        bench.in_turn(kernel_rows()),
        simulation_ratios(bench),
        live_ratios(),
        command_ratios(),
    )
    ratios = [ratio for group in groups for ratio in group]
    print(markdown([HEAD, *(ratio.cells() for ratio in ratios)]))
    print(f"\n{summary(ratios)}")
    return int(any((ratio.excess or 0.0) > 0.0 for ratio in ratios))


def summary(ratios: Sequence[Ratio]) -> str:
    """One sentence: all budgets hold, or which do not and by how much."""
    judged = [(ratio.row.what, ratio.excess) for ratio in ratios if ratio.excess is not None]
    over = [f"{what} by {100.0 * excess:.0f} %" for what, excess in judged if excess > 0.0]
    if not over:
        return f"All {len(judged)} budgets hold."
    return f"{len(over)} of {len(judged)} budgets do not hold: {', '.join(over)}."


if __name__ == "__main__":
    sys.exit(main())

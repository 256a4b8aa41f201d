"""Memory and CPU of each daemon with its pattern host: seven running attraction at 5 Hz lidar.

From /proc: RSS counts shared pages fully, PSS shares them out among their users. CPU is what each
daemon and its host used over the window, in % of one core. Attraction has led the robots to each
other before the window begins: a scan with neighbours near costs the most.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table
from tests.support.processes import children

ROBOTS = 7
SECONDS = 25.0
GATHERING = 15.0  # s until the robots are near each other
KINDS = "Rss", "Pss"
MEMORY_BUDGETS = {"Rss": "90 MB", "Pss": "45 MB"}
IDLE_BUDGET, CPU_BUDGET = "1.2 %", "2.2 %"
TICK = os.sysconf("SC_CLK_TCK")


def cpu_seconds(pid: int) -> float:
    """User and system time so far in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def memory(pid: int, kind: str) -> float:
    """`Rss` or `Pss` in MB."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith(f"{kind}:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise LookupError(f"no {kind} of process {pid}")


def rows(seconds: float = SECONDS) -> Iterator[Row]:
    with Swarm(ROBOTS) as swarm:
        swarm.run("attraction")
        time.sleep(GATHERING)
        assert swarm.world is not None
        pairs = [(d.pid, children(d.pid)[-1]) for d in swarm.daemons.values()]
        pids = [swarm.world.pid, *(pid for pair in pairs for pid in pair)]
        before, start = {pid: cpu_seconds(pid) for pid in pids}, time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - start
        used = {pid: 100.0 * (cpu_seconds(pid) - before[pid]) / passed for pid in pids}
        rss, pss = ([[memory(pid, kind) for pid in pair] for pair in pairs] for kind in KINDS)
    for kind, both in zip(KINDS, (rss, pss), strict=True):
        sums, budget = [sum(pair) for pair in both], MEMORY_BUDGETS[kind]
        yield Row(f"{kind.upper()}, daemon + host", sums, budget, unit="MB")
        yield Row(f"{kind.upper()}, daemon", [daemon for daemon, _ in both], unit="MB")
        yield Row(f"{kind.upper()}, host", [host for _, host in both], unit="MB")
    note = f"of one core, over {passed:.0f} s"
    cpu = [(used[daemon], used[host]) for daemon, host in pairs]
    yield Row("CPU, daemon + host", [sum(pair) for pair in cpu], CPU_BUDGET, note, "%")
    yield Row("CPU, daemon", [daemon for daemon, _ in cpu], unit="%")
    yield Row("CPU, host", [host for _, host in cpu], unit="%")
    yield Row("CPU, world of 7", [used[swarm.world.pid]], unit="%")
    yield Row("CPU, everything", [sum(used.values())], unit="%")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    print_table("Memory and CPU, 7 live daemons", rows(parser.parse_args(arguments).seconds))


if __name__ == "__main__":
    main()

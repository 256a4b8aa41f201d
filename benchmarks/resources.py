"""Memory, CPU and wake-ups of each daemon with its pattern host: seven at 5 Hz lidar.

From /proc: RSS counts shared pages fully, PSS shares them out among their users. CPU is what each
daemon and its host used over a window, in % of one core. A wake-up is a voluntary context switch of
the main thread, so the count hardly depends on the load of the machine. The first window is idle.
Before the second one, attraction has led the robots to each other: a scan with neighbours near
costs the most.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table
from tests.support.processes import children

ROBOTS = 7
SECONDS = 25.0
SETTLING = 3.0  # s after the start, until the robots rest
GATHERING = 15.0  # s until the robots are near each other
KINDS = "Rss", "Pss"
MEMORY_GOALS = {"Rss": "90 MB", "Pss": "45 MB"}
IDLE_GOAL, CPU_GOAL = "1.2 %", "2.2 %"
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


def wake_ups(pid: int) -> int:
    """How often the main thread has waited so far."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("voluntary_ctxt_switches:"):
            return int(line.split()[1])
    raise LookupError(f"no context switches of process {pid}")


class Usage(NamedTuple):
    """What each process used over a window, by its id."""

    cpu: dict[int, float]
    """% of one core."""
    wake_ups: dict[int, float]
    """A second."""


def usage(pids: Sequence[int], seconds: float) -> Usage:
    """What the processes use in the next `seconds`."""
    start = time.monotonic()
    before = {pid: (cpu_seconds(pid), wake_ups(pid)) for pid in pids}
    time.sleep(seconds)
    passed = time.monotonic() - start
    return Usage(
        {pid: 100.0 * (cpu_seconds(pid) - before[pid][0]) / passed for pid in pids},
        {pid: (wake_ups(pid) - before[pid][1]) / passed for pid in pids},
    )


def rows(seconds: float = SECONDS) -> Iterator[Row]:
    with Swarm(ROBOTS) as swarm:
        assert swarm.world is not None
        pairs = [(d.pid, children(d.pid)[-1]) for d in swarm.daemons.values()]
        pids = [swarm.world.pid, *(pid for pair in pairs for pid in pair)]
        time.sleep(SETTLING)
        idle = usage(pids, seconds)
        swarm.run("attraction")
        time.sleep(GATHERING)
        driving = usage(pids, seconds)
        rss, pss = ([[memory(pid, kind) for pid in pair] for pair in pairs] for kind in KINDS)
    for kind, both in zip(KINDS, (rss, pss), strict=True):
        sums, goal = [sum(pair) for pair in both], MEMORY_GOALS[kind]
        yield Row(f"{kind.upper()}, daemon + host", sums, goal, unit="MB")
        yield Row(f"{kind.upper()}, daemon", [daemon for daemon, _ in both], unit="MB")
        yield Row(f"{kind.upper()}, host", [host for _, host in both], unit="MB")
    note = f"of one core, over {seconds:.0f} s"
    for what, used, goal in (("idle", idle, IDLE_GOAL), ("driving", driving, CPU_GOAL)):
        cpu, waked = used
        sums = [cpu[daemon] + cpu[host] for daemon, host in pairs]
        yield Row(f"CPU, daemon + host, {what}", sums, goal, note, "%")
        yield Row(f"CPU, daemon, {what}", [cpu[daemon] for daemon, _ in pairs], unit="%")
        yield Row(f"CPU, host, {what}", [cpu[host] for _, host in pairs], unit="%")
        yield Row(f"CPU, world of 7, {what}", [cpu[swarm.world.pid]], unit="%")
        yield Row(f"CPU, everything, {what}", [sum(cpu.values())], unit="%")
        waked_daemons = [waked[daemon] for daemon, _ in pairs]
        yield Row(f"wake-ups of a daemon, {what}", waked_daemons, note="a second", unit="")
        waked_hosts = [waked[host] for _, host in pairs]
        yield Row(f"wake-ups of a host, {what}", waked_hosts, note="a second", unit="")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    seconds = parser.parse_args(arguments).seconds
    print_table("Memory, CPU and wake-ups, 7 live daemons", rows(seconds))


if __name__ == "__main__":
    main()

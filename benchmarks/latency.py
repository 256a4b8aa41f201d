"""Latency from a scan to its command: seven live daemons and one world on this machine.

Reflex: the time from the sending of a scan by the world to the arrival, at the world, of the first
command that was decided on this scan. Full: the time to the arrival of the first command whose
requested command, from the pattern, used this scan. The bases apply a command at the next 100 Hz
step, up to 10 ms later; this delay is not counted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table
from swarmd.core.messages import State, Status

ROBOTS = 7
REFLEX_GOAL, FULL_GOAL = "p50 1.2 ms, p99 4 ms", "p50 1.8 ms, p99 6 ms"
SECONDS = 62.0  # 5 Hz: over 300 scans of each robot
CYCLES = 10  # of run, endless loops, quarantine, reset
KILL_TIME = 1.5  # s after which the last looping host has been killed

Times = Mapping[tuple[str, int], int]
"""By robot and scan: a stamp in ns."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """The times at which the world sent each scan, and received its first command."""

    put: Times
    safe_back: Times
    requested_back: Times


def read_stamps(swarm: Swarm) -> Stamps:
    """The stamps of a closed swarm."""
    with np.load(swarm.folder / "world.npz") as file:
        scans, commands = file["scans"].tolist(), file["commands"].tolist()
    safe: dict[tuple[str, int], int] = {}
    requested: dict[tuple[str, int], int] = {}
    for at, robot, scan_seq, requested_scan_seq in commands:
        safe.setdefault((robot, scan_seq), at)
        requested.setdefault((robot, requested_scan_seq), at)
    return Stamps({(robot, seq): at for at, robot, seq in scans}, safe, requested)


def between(start: Times, end: Times, span: Sequence[int]) -> tuple[list[float], int]:
    """Seconds from start to end of all scans put within `span`, and how many never ended."""
    chosen = [key for key, at in start.items() if span[0] <= at < span[1]]
    return [(end[key] - start[key]) / 1e9 for key in chosen if key in end], sum(
        key not in end for key in chosen
    )


def run_for(swarm: Swarm, pattern: str, seconds: float) -> tuple[tuple[int, int], list[float]]:
    """Run a pattern for `seconds`; the span in ns without the first second, and wake-up delays.

    The delays in s by which this process, which only sleeps, wakes up late at 100 Hz: how late the
    machine itself is.
    """
    swarm.run(pattern)
    time.sleep(1.0)
    start = time.monotonic_ns()
    late = []
    for due in range(start, start + round(seconds * 1e9), 10_000_000):
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
        late.append((time.monotonic_ns() - due) / 1e9)
    return (start, time.monotonic_ns() - 100_000_000), late


def row(what: str, goal: str, timing: tuple[list[float], int], note: str = "") -> Row:
    samples, lost = timing
    if lost:
        note = f"{note}; {lost} scans without" if note else f"{lost} scans without"
    return Row(what, samples, goal, note)


def healthy(seconds: float) -> Iterator[Row]:
    """Reflex and full while all patterns run as they should."""
    with Swarm(ROBOTS) as swarm:
        span, late = run_for(swarm, "attraction", seconds)
        swarm.close()
        stamps = read_stamps(swarm)
    reflex = between(stamps.put, stamps.safe_back, span)
    full = between(stamps.put, stamps.requested_back, span)
    yield row("reflex, 7 live daemons", REFLEX_GOAL, reflex)
    yield row("full, 7 live daemons", FULL_GOAL, full)
    yield Row("lateness of a bare 100 Hz timer meanwhile", late, note="yardstick")


def looping(cycles: int) -> Iterator[Row]:
    """Reflex while every pattern loops for ever.

    Each host is killed after 1 s of silence and started again, into the next endless loop; with
    the fourth the pattern is quarantined. Then all are reset and told to run again.
    """
    spans: list[tuple[str, int, int]] = []
    with Swarm(ROBOTS) as swarm:
        for _ in range(cycles):
            swarm.run("endless")
            start, ran = time.monotonic_ns(), dict[str, int]()

            def is_over(seen: Mapping[str, Status], ran: dict[str, int] = ran) -> bool:
                running = [r for r in swarm.robots if seen[r].state is State.RUNNING]
                ran.update(dict.fromkeys(running, time.monotonic_ns()))
                return not running

            swarm.wait(is_over, "end of the runs")
            # A robot that stands answers no scan: its zero is repeated by ticks.
            spans += [(robot, start, end - 100_000_000) for robot, end in ran.items()]
            time.sleep(KILL_TIME)
            swarm.reset()
        swarm.close()
        stamps = read_stamps(swarm)
    timings = [
        between({k: at for k, at in stamps.put.items() if k[0] == robot}, stamps.safe_back, span)
        for robot, *span in spans
    ]
    samples = [value for timing, _ in timings for value in timing]
    lost = sum(lost for _, lost in timings)
    note = "hosts loop for 1 s, are killed and replaced, and loop again"
    yield row("reflex, all 7 patterns loop", "p99 20 ms", (samples, lost), note)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--cycles", type=int, default=CYCLES)
    options = parser.parse_args(arguments)
    print_table("Latency", healthy(options.seconds))
    print_table("Latency beside endless loops", looping(options.cycles))


if __name__ == "__main__":
    main()

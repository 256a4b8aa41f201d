"""swarmctl beside many robots: `members` of 100, the processor time of each, a stop without acks.

The robots are a `Crowd`, which answers looks and acks nothing.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from subprocess import run
from typing import NamedTuple

from benchmarks.cli import swarmctl
from benchmarks.crowd import Crowd
from benchmarks.table import Row, print_table

ROBOTS = 100
STOPPED = 20
RUNS = 10
STOPS = 2  # each waits for 3 s


class Timed(NamedTuple):
    """A command that has ended."""

    wall: float  # s
    cpu: float  # s of processor time
    out: str


def timed(command: Sequence[str]) -> Timed:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    done = run(command, capture_output=True, text=True, timeout=60, check=False)
    wall = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    user = after.ru_utime - before.ru_utime
    system = after.ru_stime - before.ru_stime
    return Timed(wall, user + system, done.stdout)


def looked(count: int, runs: int, prefix: Sequence[str]) -> list[Timed]:
    """`members` of `count` robots; SystemExit if one is missing."""
    with Crowd(count) as crowd:
        looks = [
            timed([*prefix, *swarmctl("members", "--swarm", crowd.swarm)]) for _ in range(runs)
        ]
    for look in looks:
        if f"{count}/{count} alive" not in look.out or "no answer" in look.out:
            sys.exit(f"members of {count}: {look.out[-200:]}")
    return looks


def rows(runs: int = RUNS, prefix: Sequence[str] = ()) -> Iterator[Row]:
    """`prefix`: words before each timed command, such as `chrt -f 5`."""
    one = statistics.median(look.cpu for look in looked(1, runs, prefix))
    many = looked(ROBOTS, runs, prefix)
    yield Row(f"swarmctl members, {ROBOTS} robots", [look.wall for look in many], "0.5 s")
    each = [(look.cpu - one) / (ROBOTS - 1) for look in many]
    note = "beyond the processor time of members of one robot"
    yield Row(f"CPU of members, each of {ROBOTS} robots", each, "2 ms", note)
    with Crowd(STOPPED) as crowd:
        command = [*prefix, *swarmctl("stop", "--swarm", crowd.swarm)]
        stops = [timed(command).cpu for _ in range(STOPS)]
    yield Row(f"CPU of a stop, {STOPPED} robots without acks", stops, "0.25 s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    print_table("Many robots", rows(parser.parse_args().runs))


if __name__ == "__main__":
    main()

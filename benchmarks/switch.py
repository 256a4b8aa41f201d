"""A swarm-wide switch from the key press: `swarmctl run PATTERN --all` with 20 running daemons.

The time begins with the start of the swarmctl process and ends with its line `20 targeted, 20
applied`: every robot has loaded the pattern. All hosts are warm. `stop` and `members` likewise.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import cycle
from pathlib import Path

from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table

ROBOTS = 20
RUNS = 30


def timed(swarm: Swarm, prefix: Sequence[str], *words: str) -> float:
    """Seconds until swarmctl has the replies of all robots; SystemExit if one is missing."""
    command = [
        *prefix,
        str(Path(sys.executable).with_name("swarmctl")),
        *words,
        "--swarm",
        swarm.name,
    ]
    seconds, text = 0.0, ""
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            seconds, text = time.perf_counter() - start, line
    if process.returncode:
        sys.exit(f"{' '.join(words)} ended with {process.returncode}: {text}")
    return seconds


def rows(robots: int = ROBOTS, runs: int = RUNS, prefix: Sequence[str] = ()) -> Iterator[Row]:
    """`prefix`: words before each timed command, such as `chrt -f 5`."""
    patterns = cycle(("attraction", "dispersion", "random_walk"))
    with Swarm(robots) as swarm:
        for _ in range(3):  # what each host imports, it imports once
            swarm.run(next(patterns))
        switches = [timed(swarm, prefix, "run", next(patterns), "--all") for _ in range(runs)]
        requests = [swarm.run(next(patterns)).seconds for _ in range(runs)]
        stops = [timed(swarm, prefix, "stop") for _ in range(runs)]
        looks = [timed(swarm, prefix, "members") for _ in range(runs)]
    note = "process start to answer"
    yield Row(f"swarmctl run --all, {robots} daemons", switches, "0.25 s", f"{note}, all acked")
    yield Row(f"its request alone, {robots} daemons", requests, note="in an open session")
    yield Row(f"swarmctl stop, {robots} daemons", stops, note=note)
    yield Row(f"swarmctl members, {robots} daemons", looks, "0.2 s", note)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--runs", type=int, default=RUNS)
    options = parser.parse_args(arguments)
    print_table("Switching a swarm", rows(options.robots, options.runs))


if __name__ == "__main__":
    main()

"""swarmctl cold, as a user types it: `--help` and `members`, beside a Python that opens a session.

Seven daemons without a world are its members.
"""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.table import Row, print_table
from benchmarks.yardsticks import OPENED

RUNS = 30
ROBOTS = 7

Process = subprocess.Popen[bytes]


def swarmctl(*words: str) -> list[str]:
    return [str(Path(sys.executable).with_name("swarmctl")), *words]


def start(robot: str, swarm: str, folder: Path) -> Process:
    """A daemon that is tied to this process."""
    command = [sys.executable, "-m", "swarmd.operator.cli.daemon", "--id", robot, "--swarm", swarm]
    command += ["--state-dir", str(folder), "--die-with-parent", str(os.getpid())]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


def timed(command: Sequence[str]) -> tuple[float, str]:
    """Seconds from start to end of a command, and what it printed."""
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return time.perf_counter() - begin, done.stdout


def rows(runs: int = RUNS, prefix: Sequence[str] = ()) -> Iterator[Row]:
    """The yardstick first. `prefix`: words before each timed command, such as `chrt -f 5`."""
    swarm = f"bench-{secrets.token_hex(4)}"
    with tempfile.TemporaryDirectory() as folder:
        daemons = [start(f"r{i}", swarm, Path(folder)) for i in range(1, ROBOTS + 1)]
        try:
            members = swarmctl("members", "--swarm", swarm)
            deadline = time.monotonic() + 30.0
            while f"{ROBOTS}/{ROBOTS} alive" not in timed(members)[1]:
                if time.monotonic() > deadline:
                    sys.exit(f"no {ROBOTS} daemons within 30 s")
            looks, bare, helped = [], [], []
            for _ in range(runs):
                looks.append(timed([*prefix, *members]))
                bare.append(timed([*prefix, *OPENED])[0])
                helped.append(timed([*prefix, *swarmctl("--help")])[0])
        finally:
            for daemon in daemons:
                daemon.terminate()
            for daemon in daemons:
                daemon.wait(timeout=10)
    complete = sum(f"{ROBOTS}/{ROBOTS} alive" in text for _, text in looks)
    yield Row("a Python that opens a Zenoh session", bare, note="yardstick")
    yield Row("swarmctl --help", helped, "0.08 s")
    note = f"all {ROBOTS} robots named in {complete} of {runs} runs"
    yield Row("swarmctl members, cold", [seconds for seconds, _ in looks], "0.12 s", note)


def main() -> None:
    print_table("swarmctl from start to end", rows())


if __name__ == "__main__":
    main()

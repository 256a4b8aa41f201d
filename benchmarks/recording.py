"""Cost of a recording: CPU of one daemon and its recorder process, and lateness of its loop.

One robot with 360 rays at 10 Hz runs random_walk, and records in every second window. CPU is the
time of daemon, pattern host and recorder process in a window, in % of one core, from /proc.
Lateness is the 99th percentile of the delays with which the daemon's loop wakes, as its status
reports. Both depend on the load of the machine, so compare only windows of one run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table
from swarmd.core.verbs import RecordRequest
from tests.support.processes import children

SECONDS = 20.0
ROUNDS = 3
PLATFORM = "jackal"
SETTLING = 8.0  # s between a request and the window


def cpu_seconds(pid: int) -> float:
    """User and system time of all threads so far in s, by the scheduler's own ns."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(schedstat.read_text().split()[0]) for schedstat in threads) * 1e-9


class Window:
    """A window: CPU by role of the process in % of one core, and lateness in s."""

    def __init__(self, swarm: Swarm, seconds: float) -> None:
        (daemon,) = swarm.daemons.values()
        roles = {pid: _role(pid) for pid in (daemon.pid, *children(daemon.pid))}
        before, start = {pid: cpu_seconds(pid) for pid in roles}, time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - start
        self.cpu = {
            role: 100.0 * (cpu_seconds(pid) - before[pid]) / passed for pid, role in roles.items()
        }
        (status,) = swarm.statuses().values()
        self.late = status.health.loop_p99
        self.dropped = 0 if status.recording is None else status.recording.dropped


def rows(seconds: float = SECONDS, rounds: int = ROUNDS) -> Iterator[Row]:
    off, on = [], []
    with Swarm(1, PLATFORM) as swarm:
        swarm.run("random_walk")
        for _ in range(rounds):
            _record(swarm, "stop")
            off.append(Window(swarm, seconds))
            _record(swarm, "start")
            on.append(Window(swarm, seconds))
        files = list((swarm.folder / "state").rglob("*.mcap"))
        size = sum(file.stat().st_size for file in files)
        passed = rounds * (seconds + SETTLING)
    more = [sum(b.cpu.values()) - sum(a.cpu.values()) for a, b in zip(off, on, strict=True)]
    note = f"of one core, windows of {seconds:.0f} s"
    yield Row("CPU, everything, more while it records", more, "1 %", note, "%")
    for role in ("daemon", "recorder"):
        yield Row(
            f"CPU, {role}, not recording", [window.cpu.get(role, 0.0) for window in off], unit="%"
        )
        yield Row(f"CPU, {role}, recording", [window.cpu.get(role, 0.0) for window in on], unit="%")
    yield Row("lateness of the loop (p99), not recording", [window.late for window in off])
    yield Row("lateness of the loop (p99), recording", [window.late for window in on])
    yield Row("disk, a minute", [size / 1e6 / passed * 60.0], unit="MB")
    yield Row("entries dropped", [window.dropped for window in on], unit="x")


def _record(swarm: Swarm, action: Literal["start", "stop"]) -> None:
    epochs = swarm.operator.members().epochs(swarm.robots)
    swarm.operator.request(RecordRequest, epochs, action=action)
    time.sleep(SETTLING)


def _role(pid: int) -> str:
    command = Path(f"/proc/{pid}/cmdline").read_bytes()
    if b"swarmd.daemon.recording.process" in command:
        return "recorder"
    return "daemon" if b"swarmd.operator.cli.daemon" in command else "host"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    given = parser.parse_args(arguments)
    print_table("Cost of a recording", rows(given.seconds, given.rounds))


if __name__ == "__main__":
    main()

"""Cost of keys: `python -m benchmarks.keys`. Two swarms of daemons without bases, on loopback.

One swarm has keys, the other swarm does not. `swarmctl members` and `swarmctl run drive --all` of
both are measured in turn, as processes from their start to their end, then the opening of a link,
and the memory and CPU of an idle daemon.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from benchmarks.resources import cpu_seconds, memory
from benchmarks.table import machine, markdown
from swarmd.core.values import Value
from swarmd.network.carriers.session import open_operator_session
from swarmd.network.settings import NetworkSettings
from swarmd.security.identity import Identity
from tests.support.keys import SwarmKeys
from tests.support.processes import DaemonProcess, free_endpoint, unique_swarm

OPERATOR = "alice"
VERBS = {"members": ("members",), "run --all": ("run", "drive", "--all")}
IDLE_TIME = 10.0  # s
LINKS = 30
STARTING = 3  # daemons at a time


class Side:
    """One swarm of daemons, with keys or without."""

    def __init__(self, folder: Path, count: int, *, is_secured: bool) -> None:
        self.name = unique_swarm()
        robots = [f"r{number:02d}" for number in range(1, count + 1)]
        self.folder = folder
        self.keys = (
            SwarmKeys(folder / "keys", self.name, robots, operators=[OPERATOR])
            if is_secured
            else None
        )
        self.endpoint = free_endpoint()
        self.robots = robots
        self.daemons: list[DaemonProcess] = []

    def start(self, left: contextlib.ExitStack) -> None:
        """Start the daemons, a few at a time."""
        for at, robot in enumerate(self.robots):
            listen: Value = [self.endpoint] if at == 0 else []
            daemon = DaemonProcess(
                self.folder / robot,
                swarm=self.name,
                robot=robot,
                endpoint="tcp/127.0.0.1:9",
                options={"listen": listen, **self._keys(robot)},
            )
            self.daemons.append(left.enter_context(daemon))
            self.daemons[max(0, at - STARTING)].wait_ready()
        for daemon in self.daemons:
            daemon.wait_ready()

    def _keys(self, name: str) -> Mapping[str, str]:
        return {} if self.keys is None else {"identity": str(self.keys.folder_of(name))}

    @property
    def identity(self) -> Identity | None:
        return None if self.keys is None else self.keys[OPERATOR]

    def time(self, words: Sequence[str]) -> tuple[float, float]:
        """Seconds of one swarmctl, and of its CPU; SystemExit unless it succeeds."""
        given = () if self.keys is None else ("--identity", str(self.keys.folder_of(OPERATOR)))
        command = [sys.executable, "-c", "from swarmd.cli.entry import swarmctl; swarmctl()"]
        environ = {**os.environ, "HOME": str(self.folder), "SWARM": self.name}
        began, cpu = time.perf_counter(), _cpu_of_children()
        done = subprocess.run(
            [*command, *given, *words], env=environ, capture_output=True, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"{words}: {done.returncode} {done.stdout} {done.stderr}")
        return time.perf_counter() - began, _cpu_of_children() - cpu

    def time_link(self) -> float:
        """Seconds from the opening of a session until it is linked to one robot."""
        settings = NetworkSettings(swarm=self.name)
        began = time.perf_counter()
        session = open_operator_session(settings, [self.endpoint], self.identity)
        while not list(session.info.peers_zid()):
            time.sleep(0.0002)
        took = time.perf_counter() - began
        session.close()
        return took

    def cpu(self) -> float:
        """Seconds of CPU that all daemons have used."""
        return sum(cpu_seconds(daemon.process.pid) for daemon in self.daemons)

    def memory(self) -> float:
        """Resident memory of a daemon in MB, the median."""
        return statistics.median(memory(daemon.process.pid, "Rss") for daemon in self.daemons)


@contextlib.contextmanager
def sides(count: int) -> Iterator[tuple[Side, Side]]:
    """A swarm without keys and one with them, ready."""
    with contextlib.ExitStack() as left:
        made = []
        for is_secured in (False, True):
            folder = Path(left.enter_context(tempfile.TemporaryDirectory()))
            side = Side(folder, count, is_secured=is_secured)
            side.start(left)
            made.append(side)
        yield made[0], made[1]


def measure(count: int, rounds: int, verbs: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """A row for each figure: without keys, with keys, and their ratio."""
    with sides(count) as both:
        for name in verbs:
            words = VERBS[name]
            for side in both:
                side.time(words)  # the first one loads
            times = [[side.time(words) for side in both] for _ in range(rounds)]
            for place, what in enumerate(("ms", "ms of CPU")):
                pairs = [[one[place] for one in pair] for pair in times]
                yield _row(f"{count} robots: {name}, {what}", 1000.0, pairs)
        links = [[side.time_link() for side in both] for _ in range(LINKS)]
        yield _row(f"{count} robots: link to one, ms", 1000.0, links)
        before = [side.cpu() for side in both]
        time.sleep(IDLE_TIME)
        used = [side.cpu() - one for side, one in zip(both, before, strict=True)]
        share = [100.0 * one / IDLE_TIME / count for one in used]
        yield _row(f"{count} robots: CPU of a daemon, % of a core", 1.0, [share])
        yield _row(f"{count} robots: memory of a daemon, MB", 1.0, [[s.memory() for s in both]])


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _row(what: str, scale: float, pairs: Sequence[Sequence[float]]) -> tuple[str, ...]:
    without, keyed = (statistics.median(column) * scale for column in zip(*pairs, strict=True))
    return what, f"{without:.1f}", f"{keyed:.1f}", f"{keyed / without:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[6, 20])
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--verbs", nargs="+", default=list(VERBS), choices=VERBS)
    options = parser.parse_args()
    print(f"Measured on {machine()}. Medians of {options.rounds} rounds; budget: a ratio of 1.5.")
    rows = [
        row for count in options.robots for row in measure(count, options.rounds, options.verbs)
    ]
    print(markdown([("", "without keys", "with keys", "ratio"), *rows]))


if __name__ == "__main__":
    main()

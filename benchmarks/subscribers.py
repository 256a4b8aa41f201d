"""CPU of an idle daemon while a Zenoh session subscribes to keys of its robot.

One Waffle Pi with a lidar of 5 Hz runs no pattern. CPU is that of all threads of the daemon, from
/proc in nanoseconds, in % of one core. Each window begins once a payload of each key has come.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import zenoh

from benchmarks.swarm import POLL_PERIOD, READY_TIMEOUT, Swarm
from benchmarks.table import Row, print_table
from swarmd.core.keys import STATE, build
from swarmd.network.carriers.session import open_operator_session
from swarmd.network.settings import NetworkSettings

SECONDS = 20.0
ALL = "*"
CASES: Sequence[tuple[str, ...]] = (
    (),
    ("status",),
    ("motion",),
    ("decision",),
    ("scan",),
    (ALL,),
    (),
)
"""Subscribed names of each window; an idle robot publishes nothing on some keys of `*`."""
AWAITED: Mapping[str, tuple[str, ...]] = {ALL: ("status", "motion", "decision", "scan")}


def busy_seconds(pid: int) -> float:
    """Time in s that all threads of a process have been on a processor."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / 1e9


class Subscriber:
    """A session that subscribes to the keys of one robot; counts payloads and bytes by name."""

    def __init__(self, swarm: Swarm, names: Sequence[str]) -> None:
        (robot,) = swarm.robots
        settings = NetworkSettings(swarm=swarm.name)
        endpoints = sorted(swarm.operator.endpoints().values())
        self.payloads, self.size = Counter[str](), 0
        self._session = open_operator_session(settings, endpoints)
        keys = [build(swarm.name, robot, STATE, name) for name in names]
        self._kept = [self._session.declare_subscriber(key, self._take) for key in keys]
        awaited = {one for name in names for one in AWAITED.get(name, (name,))}
        deadline = time.monotonic() + READY_TIMEOUT
        while awaited - self.payloads.keys():
            if time.monotonic() > deadline:
                raise SystemExit(f"no payload of {', '.join(awaited - self.payloads.keys())}")
            time.sleep(POLL_PERIOD)

    def _take(self, sample: zenoh.Sample) -> None:
        self.payloads[str(sample.key_expr).rpartition("/")[2]] += 1
        self.size += len(sample.payload)

    def close(self) -> None:
        self._session.close()


def rows(seconds: float = SECONDS) -> Iterator[Row]:
    with Swarm(1) as swarm:
        (daemon,) = swarm.daemons.values()
        seen = False
        for names in CASES:
            subscriber = Subscriber(swarm, names) if names else None
            first = (0, 0) if subscriber is None else (subscriber.payloads.total(), subscriber.size)
            before, start = busy_seconds(daemon.pid), time.monotonic()
            time.sleep(seconds)
            passed = time.monotonic() - start
            share = 100.0 * (busy_seconds(daemon.pid) - before) / passed
            what, note = "after they have gone" if seen else "no subscriber", ""
            if subscriber is not None:
                what = "a subscriber to all" if names == (ALL,) else f"one to `{names[0]}`"
                count = (subscriber.payloads.total() - first[0]) / passed
                size = (subscriber.size - first[1]) / passed / 1000.0
                note = f"{count:.1f} payloads and {size:.1f} kB a second"
                subscriber.close()
                seen = True
            yield Row(f"CPU, idle daemon, {what}", [share], "", note, "%")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    print_table("Subscribers of one robot", rows(parser.parse_args(arguments).seconds))


if __name__ == "__main__":
    main()

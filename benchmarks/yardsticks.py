"""Work of a fixed size that shows how fast the machine is at the moment, for `make budget`.

An absolute figure changes by a factor of two with the machine and its other work. The ratio of a
figure to one of these yardsticks, measured in turn with it, changes far less. A loop of pure Python
is no yardstick: it stays in the first cache, and was off by a factor of 1.5 where `mixed` was off
by 1.03.

`python -m benchmarks.yardsticks` is the process behind `Peer`.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Self

import numpy as np

POOL, TOUCHED = 100_000, 4_000  # objects that are kept, and that one unit of `mixed` replaces
ROWS, RAYS = 2_000, 360
PERIOD, FILL = 0.025, 3_000  # s and bytes of the messages of a peer
ZENOH = (
    "import zenoh; c = zenoh.Config(); c.insert_json5('scouting/multicast/enabled', 'false');"
    " c.insert_json5('listen/endpoints', '[\"tcp/127.0.0.1:0\"]'); zenoh.open(c).close()"
)
OPENED = [sys.executable, "-c", ZENOH]
"""A Python that opens a Zenoh session: the yardstick of commands."""


def mixed() -> Callable[[], float]:
    """A function that does a unit of work, some 10 ms, and gives its processor time in s.

    Half the unit replaces objects of a pool that no cache holds, half computes on rows of rays.
    """
    pool = [(float(number), {"at": number}) for number in range(POOL)]
    order = np.random.default_rng(0).permutation(POOL).tolist()
    rows = np.random.default_rng(1).uniform(0.1, 3.5, (ROWS, RAYS))
    begin = 0

    def unit() -> float:
        nonlocal begin
        start = time.process_time()
        for index in order[begin : begin + TOUCHED]:
            value, record = pool[index]
            pool[index] = (value + 0.5 * record["at"], {"at": record["at"] + 1})
        begin = (begin + TOUCHED) % POOL
        for first in range(0, ROWS, 100):
            some = rows[first : first + 100]
            np.minimum(some, np.roll(some, 1, axis=1)).min(axis=1)
        return time.process_time() - start

    return unit


class Peer:
    """A context manager: an asyncio process that sends itself 3 kB of JSON at 40 Hz."""

    def __enter__(self) -> Self:
        command = [sys.executable, "-m", "benchmarks.yardsticks"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.pid = self._process.pid
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        out = self._process.communicate(timeout=10.0)[0]
        self.hop = float(out)
        """Median time in s from the sending of a message until it is decoded."""


async def _peer() -> float:
    loop, hops, ended = asyncio.get_running_loop(), list[float](), asyncio.Event()

    class Receiver(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: object) -> None:
            hops.append(time.perf_counter() - json.loads(data)["at"])

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    loop.call_later(600.0, ended.set)  # s, should its parent be killed
    transport, _ = await loop.create_datagram_endpoint(Receiver, ("127.0.0.1", 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(transport.get_extra_info("sockname"))
        while not ended.is_set():
            sender.send(
                json.dumps({"at": time.perf_counter(), "fill": [0.5] * (FILL // 5)}).encode()
            )
            await asyncio.sleep(PERIOD)
    transport.close()
    return statistics.median(hops) if hops else 0.0


@contextmanager
def real_time(priority: int) -> Iterator[bool]:
    """Give this process and its children real-time priority; yields whether it is granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


if __name__ == "__main__":
    print(asyncio.run(_peer()))

"""The world process, stamping each scan as it is published and each command as it arrives.

`python -m benchmarks.stamped_world FILE.npz ...` with the arguments of `swarmd.sim.live.server`.
Stamps are in ns on CLOCK_MONOTONIC, taken just before a scan is sent, and by the kernel when a
command has arrived: the bases apply a command with the next 100 Hz step. A thread reads commands at
once, since the kernel tells the time of the newest of those that wait.
"""

from __future__ import annotations

import select
import sys
import threading
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from time import monotonic_ns

import numpy as np

from swarmd.driver_api.hw_codec import decode_command, decode_scan
from swarmd.settings.platforms import load_platform
from swarmd.sim.live import server
from swarmd.sim.live.link import WorldLink


class StampedLink(WorldLink):
    """A world's link that stamps scans and commands."""

    def __init__(self, swarm: str, ids: Iterable[str], endpoint: str, *, path: Path) -> None:
        self._path = path
        self._puts: list[tuple[int, str, bytes]] = []
        self._came: list[tuple[int, str, bytes]] = []
        self._reading, self._is_over = threading.Lock(), False
        super().__init__(swarm, ids, endpoint)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while not self._is_over:
            if select.select([self._robots], [], [], 0.1)[0]:
                self.receive()

    def receive(self) -> None:
        with self._reading:
            super().receive()

    def publish(self, robot: str, name: str, payload: bytes) -> None:
        if name == "scan":
            self._puts.append((monotonic_ns(), robot, payload))
        super().publish(robot, name, payload)

    def _on_command(self, robot: str, payload: bytes, arrival: float) -> None:
        self._came.append((round(1e9 * arrival), robot, payload))
        super()._on_command(robot, payload, arrival)

    def close(self) -> None:
        self._is_over = True
        self._reader.join()
        super().close()
        spec = load_platform("waffle_pi").scan
        puts = [(at, robot, decode_scan(scan, spec).seq) for at, robot, scan in self._puts]
        came = []
        for at, robot, payload in self._came:
            command = decode_command(payload)
            came.append((at, robot, command.scan_seq, command.requested_scan_seq))
        scans = np.array(puts, dtype=[("at", "i8"), ("robot", "U64"), ("seq", "i8")])
        kind = [("at", "i8"), ("robot", "U64"), ("scan_seq", "i8"), ("requested_scan_seq", "i8")]
        np.savez(self._path, scans=scans, commands=np.array(came, dtype=kind))


def main() -> int:
    link = partial(StampedLink, path=Path(sys.argv[1]))
    setattr(server, "WorldLink", link)  # noqa: B010  # all else is the server as it is
    return server.main(sys.argv[2:])


if __name__ == "__main__":
    sys.exit(main())

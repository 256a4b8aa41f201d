"""Floods a robot with links: `python -m tests.support.link_flood FOLDER ENDPOINT COUNT SECONDS`.

COUNT sessions with the identity in FOLDER are opened and kept; a link that the robot ends is
dialled again by Zenoh. It prints `begun` once all were opened, or after
20 s.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path

import zenoh

from swarmd.core.errors import NetworkError
from swarmd.link.carriers.session import open_with, operator_options
from swarmd.link.keys.identity import load_identity
from swarmd.link.settings import NetworkSettings

THREADS = 4
BEGIN_TIME = 5.0  # s for each thread: a robot that ends links gives no place to so many


def main(folder: Path, endpoint: str, count: int, seconds: float) -> None:
    """Keep `count` sessions open for some seconds."""
    identity = load_identity(folder)
    options = {
        **operator_options(NetworkSettings(), [endpoint], identity),
        "mode": "client",
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 1000,
            "period_max_ms": 4000,
            "period_increase_factor": 2.0,
        },
    }
    until = time.monotonic() + seconds
    held: list[zenoh.Session] = []

    def dial() -> None:
        while len(held) < count and time.monotonic() < until:
            try:
                held.append(open_with(options, "a link"))
            except NetworkError:
                continue

    threads = [threading.Thread(target=dial) for _ in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(BEGIN_TIME)
    print("begun", flush=True)
    time.sleep(max(until - time.monotonic(), 0.0))
    os._exit(0)  # 1000 sessions take long to close


if __name__ == "__main__":
    place, robot, number, duration = sys.argv[1:]
    main(Path(place), robot, int(number), float(duration))

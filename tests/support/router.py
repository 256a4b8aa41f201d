"""A Zenoh router in a process of its own: `python -m tests.support.router LISTEN [CONNECT...]`.

With a JSON file in place of LISTEN the router has that configuration. It stands in for `zenohd`,
which PyPI and Debian do not have: the same router, from Python.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import zenoh

ROOT = Path(__file__).parents[2]


class Router:
    """The process; ready when it is made."""

    def __init__(self, listen: str, *connect: str) -> None:
        self.endpoint = listen
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.router", listen, *connect],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        """End it without a word; more than once is harmless."""
        with self.process:
            self.process.kill()


def main(listen: str, *connect: str) -> None:
    from swarmd.link.carriers.session import open_with

    if listen.endswith(".json"):
        session = zenoh.open(zenoh.Config.from_file(listen))
        print("ready", flush=True)
        signal.sigwait({signal.SIGTERM, signal.SIGINT})
        session.close()
        return
    options = {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [listen],
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "transport/link/tx/lease": 2000,
    }
    session = open_with(options, "a router")
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM, signal.SIGINT})
    session.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

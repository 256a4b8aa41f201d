"""The daemon of a simulated robot as a fork, with a pattern host that is a fork, too."""

from __future__ import annotations

from swarmd.cli import daemon
from swarmd.core.fork_server import SERVER_PATH
from swarmd.pattern_host.forked import fork_host


def main() -> None:
    """Run `swarmd` with the arguments of this process."""
    fork_host(SERVER_PATH)  # without the folder of the program that wants a fleet
    daemon.main()

"""The daemon of a simulated robot as a fork, with a pattern host that is a fork, too."""

from __future__ import annotations

from swarmd.core.fork_server import SERVER_PATH
from swarmd.operator.cli import daemon
from swarmd.pattern_host.forked import fork_host
from swarmd.plugins import DRIVERS, entry_points_of, pattern_names
from swarmd.settings.platforms import load_platform

# The server of the forks imports this module. Its forks then have the metadata of packages, and the
# caches of types that a platform's file fills: 20 ms of CPU less for each daemon.
pattern_names(None)
entry_points_of(DRIVERS)
load_platform("burger")


def main() -> None:
    """Run `swarmd` with the arguments of this process."""
    fork_host(SERVER_PATH)  # without the folder of the program that wants a fleet
    daemon.main()

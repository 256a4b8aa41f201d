"""The daemon of a simulated fleet whose later pattern hosts are forks, too."""

from __future__ import annotations

import os

from swarmd.sim.live import forked_daemon
from tests.support.forked_python import fork_hosts

EXECUTED_HOSTS = "SWARMD_TEST_EXECUTED_HOSTS"
"""In the environment of a daemon: its pattern hosts start from nothing, as those of users."""


def main() -> None:
    """Run `swarmd` with the arguments of this process."""
    if EXECUTED_HOSTS not in os.environ:
        fork_hosts()
    forked_daemon.main()

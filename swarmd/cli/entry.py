"""Where the commands begin: Ctrl-C ends them without a traceback, even while they are imported."""

from __future__ import annotations

import sys  # and no more: what this file imports is not covered

INTERRUPTED = 130


def swarmctl() -> None:
    """Run swarmctl and exit with its code."""
    try:
        from swarmd.cli.swarmctl import main

        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def swarmd() -> None:
    """Run swarmd and exit with its code."""
    try:
        from swarmd.cli.daemon import main

        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)

"""Entry points of the commands: Ctrl-C ends them without a traceback, also during imports."""

from __future__ import annotations

import sys  # no other import: an interrupt during imports of this file is not caught

INTERRUPTED = 130


def _exit_interrupted() -> None:
    print("error: interrupted", file=sys.stderr)
    sys.exit(INTERRUPTED)


def swarmctl() -> None:
    """Run swarmctl and exit with its code."""
    try:
        import gc

        gc.set_threshold(20_000)  # 30 collections during the imports would free next to nothing
        from swarmd.cli.swarmctl import main

        main()
    except KeyboardInterrupt:
        _exit_interrupted()


def swarmd() -> None:
    """Run swarmd and exit with its code."""
    try:
        from swarmd.core.processes import without_openssl

        with without_openssl():
            import secrets  # noqa: F401  # the daemon imports it after this block

            from swarmd.cli.daemon import main

        main()
    except KeyboardInterrupt:
        _exit_interrupted()

"""Entry points of the commands: Ctrl-C ends them without a traceback, also during imports."""

from __future__ import annotations

import os
import sys  # no other import: an interrupt during imports of this file is not caught

INTERRUPTED = 130


def _exit_interrupted() -> None:
    print("error: interrupted", file=sys.stderr)
    sys.exit(INTERRUPTED)


def _keep_docstrings() -> None:
    """Start this program again if PYTHONOPTIMIZE drops docstrings, of which all help is made."""

    if sys.flags.optimize > 1 and os.environ.get("PYTHONOPTIMIZE", "1") != "1":
        os.environ["PYTHONOPTIMIZE"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def _exit_with(error: Exception) -> None:
    """End with one line for an error of a module of PYTHONPATH; returns for any other error."""

    if not os.environ.get("PYTHONPATH"):
        return
    from swarmd.core.python_path import import_fault

    if fault := import_fault(error):
        print(f"error: {fault} {os.path.basename(sys.argv[0])}", file=sys.stderr)
        sys.exit(2)


def swarmctl() -> None:
    """Run swarmctl and exit with its code."""
    try:
        _keep_docstrings()
        import atexit
        import gc

        from swarmd.core.openssl import without_openssl

        gc.set_threshold(60_000)  # collections during the imports would free next to nothing
        # Python's end searches all objects for cycles, some 15 ms; what is frozen is left out.
        atexit.register(gc.freeze)
        with without_openssl():
            # Verbs import these after this block.
            import hashlib  # noqa: F401
            import hmac  # noqa: F401
        from swarmd.operator.cli.swarmctl import main

        main()
    except KeyboardInterrupt:
        _exit_interrupted()
    except Exception as error:
        _exit_with(error)
        raise


def swarmd() -> None:
    """Run swarmd and exit with its code."""
    try:
        _keep_docstrings()
        from swarmd.core.openssl import without_openssl

        with without_openssl():
            import secrets  # noqa: F401  # the daemon imports it after this block

            from swarmd.operator.cli.daemon import main

        main()
    except KeyboardInterrupt:
        _exit_interrupted()
    except Exception as error:
        _exit_with(error)
        raise

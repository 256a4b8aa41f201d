"""The processes that the running test has started, as tests/conftest.py asks."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Sequence
from multiprocessing.process import BaseProcess
from typing import Any

STARTED: list[str] = []
"""What was started since the last test began, without HELPERS."""
HELPERS = {"git", "fc-list"}
"""Programs that code runs for some milliseconds: for a commit, for the first list of fonts."""
WORKERS = ("swarmd.sim.experiments.pool", "forked_python.py")
"""The worker in which `simulate` does its runs, and the server that forks it here: the first call
of a process starts one for all calls, so that it belongs to no test."""


def _noticed(start: Callable[..., Any]) -> Callable[..., Any]:
    """A method that starts a process, and keeps its first argument in STARTED."""

    def noticed(self: Any, *words: Any, **options: Any) -> Any:
        command = words[0] if words else options.get("args", self)
        if not (isinstance(command, list | tuple) and _is_exempt(command)):
            STARTED.append(repr(command))
        return start(self, *words, **options)

    return noticed


def _is_exempt(command: Sequence[Any]) -> bool:
    """Whether a command is one of HELPERS or of WORKERS."""
    words = [os.path.basename(word) for word in command if isinstance(word, str)]
    return command[0] in HELPERS or any(word in WORKERS for word in words)


# An audit hook would be called for each import and each open file, too.
subprocess.Popen.__init__ = _noticed(subprocess.Popen.__init__)  # type: ignore[method-assign]
BaseProcess.start = _noticed(BaseProcess.start)  # type: ignore[method-assign]
os.register_at_fork(before=lambda: STARTED.append("a fork"))

"""The processes that the running test has started, as tests/conftest.py asks."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

STARTED: list[str] = []
"""What was started since the last test began, without HELPERS."""
HELPERS = {"git", "fc-list"}
"""Programs that code runs for some milliseconds: for a commit, for the first list of fonts."""
WORKER = "swarmd.sim.experiments.pool"
"""The module of the worker in which `simulate` does its runs: the first call of a process starts
one for all calls, so that it belongs to no test."""


def _noticed(start: Callable[..., Any]) -> Callable[..., Any]:
    """A method that starts a process, and keeps its first argument in STARTED."""

    def noticed(self: Any, *words: Any, **options: Any) -> Any:
        command = words[0] if words else options.get("args", self)
        is_list = isinstance(command, list | tuple)
        if not (is_list and (command[0] in HELPERS or WORKER in command)):
            STARTED.append(repr(command))
        return start(self, *words, **options)

    return noticed


# An audit hook would be called for each import and each open file, too.
subprocess.Popen.__init__ = _noticed(subprocess.Popen.__init__)  # type: ignore[method-assign]
BaseProcess.start = _noticed(BaseProcess.start)  # type: ignore[method-assign]
os.register_at_fork(before=lambda: STARTED.append("a fork"))

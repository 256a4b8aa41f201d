"""Tells a process that was forked from one that uses Zenoh: it lacks the threads of Zenoh."""

from __future__ import annotations

import os
from functools import cache

from swarmd.core.errors import ForkedError


def check_not_forked(what: str) -> None:
    """ForkedError in a fork of the process that first used Zenoh; its text names `what` is asked.

    Zenoh keeps its threads for all sessions of a process. A session that a fork opens was seen
    to hang for 15 s (once, zenoh 1.10.2), and a session of its parent is silent there.
    """
    process = _process_of_zenoh()
    if process != os.getpid():
        raise ForkedError(
            f"{what}: this process was forked from process {process}, which uses Zenoh, and a fork"
            " lacks its threads; only stop and estop work here, without routers; for the rest begin"
            " a process of its own (multiprocessing.get_context('spawn')) and connect there"
        )


@cache
def _process_of_zenoh() -> int:
    """The process that was the first to use Zenoh; a fork inherits the answer."""
    return os.getpid()

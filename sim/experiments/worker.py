"""A process that does one job after another: `python -m swarmd.sim.experiments.worker FD PARENT`.

Jobs come and outcomes go by the connection of descriptor FD; on the way to an outcome it says now
and then which share has been simulated. It is a program of its own rather than a multiprocessing
child, so that a script needs no `if __name__ == "__main__"`. Each job is done by a fork of it: what
one run does to its process, no other run sees.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from swarmd.processes import die_with_parent

if TYPE_CHECKING:
    from swarmd.sim.experiments.job import Job

BEAT = 0.25  # s between two words of progress


def main(descriptor: int, parent: int) -> None:
    """Do jobs until there are no more."""
    die_with_parent(parent)
    import swarmd.sim.experiments.job  # noqa: F401  # once, for all the forks

    with Connection(descriptor) as connection:
        while True:
            try:
                job = connection.recv()
            except EOFError:
                return
            _do_apart(job, connection)


def _do_apart(job: Job, connection: Connection) -> None:
    """Do the job in a fork; if that ends before it has an outcome, end in the same way."""
    ours, theirs = os.pipe()
    worker = os.getpid()
    child = os.fork()
    if child == 0:
        die_with_parent(worker)
        os.register_at_fork(after_in_child=connection.close)  # a pattern's fork has no say
        _do(job, connection)
        os.write(theirs, b"1")
        os._exit(0)  # whatever a pattern has left to be waited for
    os.close(theirs)
    _, status = os.waitpid(child, 0)
    os.set_blocking(ours, False)
    with suppress(BlockingIOError):  # what the pattern forked has the other end still
        if os.read(ours, 1):
            os.close(ours)
            return
    _end_with(os.waitstatus_to_exitcode(status))


def _do(job: Job, connection: Connection) -> None:
    from swarmd.sim.experiments.job import perform

    next_beat = 0.0

    def tell(share: float) -> None:
        nonlocal next_beat
        now = time.monotonic()
        if now >= next_beat or share == 1.0:
            next_beat = now + BEAT
            connection.send(share)

    connection.send(perform(job, tell))


def _end_with(code: int) -> None:
    if code < 0:
        with suppress(OSError, ValueError):  # SIGKILL knows no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))

"""A process that does one job after another: `python -m swarmd.sim.lab.worker FD PARENT`.

Jobs come and outcomes go by the connection of descriptor FD. It is a program of its own rather
than a fork or a multiprocessing child, so that a script needs no `if __name__ == "__main__"`, and
what one run does to its process no other run sees but those after it in the same worker.
"""

from __future__ import annotations

import sys
from multiprocessing.connection import Connection

from swarmd.processes import die_with_parent


def main(descriptor: int, parent: int) -> None:
    """Do jobs until there are no more."""
    die_with_parent(parent)
    from swarmd.sim.lab.job import perform

    with Connection(descriptor) as connection:
        while True:
            try:
                job = connection.recv()
            except EOFError:
                return
            connection.send(perform(job))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))

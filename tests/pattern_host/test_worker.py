"""The process of a pattern host without its daemon's runner."""

from __future__ import annotations

import os
import select
import subprocess
import sys

import pytest

from swarmd.pattern_host.forked import host_sockets
from tests.support.processes import CAP

pytestmark = pytest.mark.integration


def test_a_host_whose_daemon_ends_with_an_unread_answer_prints_nothing() -> None:
    ours, theirs = host_sockets()
    command = (sys.executable, "-m", "swarmd.pattern_host", str(theirs.fileno()), str(os.getpid()))
    with subprocess.Popen(
        (*command, "[[], []]"), pass_fds=(theirs.fileno(),), stderr=subprocess.PIPE
    ) as host:
        theirs.close()
        assert select.select([ours], [], [], CAP)[0], "the host reports its sandbox"
        ours.close()  # the kernel resets the connection, since the report was not read
        printed = host.communicate(timeout=CAP)[1]
    assert (host.returncode, printed) == (0, b"")


FORKS = """
import os, random, socket
import numpy as np
from swarmd.pattern_host import worker

def show(*folders):
    print(random.random(), np.random.random(), flush=True)
    os._exit(0)

worker.confine = show  # the next step after the generators
for _ in range(2):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    pid = os.fork()
    if not pid:
        worker.run(theirs.fileno(), os.getppid(), b"[[], []]")
    os.waitpid(pid, 0)
"""


def test_forked_hosts_draw_other_random_numbers() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FORKS], capture_output=True, text=True, timeout=CAP, check=True
    )
    first, second = (line.split() for line in done.stderr.splitlines())
    assert [one == other for one, other in zip(first, second, strict=True)] == [False, False]

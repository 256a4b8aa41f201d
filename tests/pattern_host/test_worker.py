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

"""Forks a pattern host from the process that becomes its daemon, so that both share their imports.

The memory of daemon and host (PSS: shared pages count in parts) is 5 MB (8 %) less than with a host
that starts by exec. A module that the host does not need must not be imported before the fork: the
daemon writes to the pages of the module, so the host keeps copies of them, and the PSS rises.

The fork happens before the daemon reads settings and keys, opens a session or starts a thread. The
host keeps no file descriptor of the daemon, and waits until the daemon uses it as its first host.
"""

from __future__ import annotations

import gc
import os
import socket
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec

from swarmd.core.processes import die_with_parent

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
_VARIABLE = "SWARMD_FORKED_HOST"


class ForkedHost:
    """A forked child process, with the methods of `subprocess.Popen` that `HostProcess` uses."""

    def __init__(self, pid: int) -> None:
        self.pid = pid

    def wait(self) -> int:
        """Wait for the end of the child; returns the exit code, negative for a signal."""
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def host_sockets() -> tuple[socket.socket, socket.socket]:
    """The daemon's and the host's end of a new socket pair."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
    return pair


def fork_host(path: Sequence[str]) -> None:
    """Fork a host with the import path `path` for this process, which then becomes a daemon.

    Called before the process reads a secret. Without effect if a host is forked already, or if a
    thread runs, since a lock that the thread holds would stay locked in the host.
    """
    if _VARIABLE in os.environ or len(os.listdir("/proc/self/task")) > 1:
        return
    from swarmd.pattern_host import worker  # noqa: F401  # the host shares the pages of the imports

    gc.freeze()  # a garbage collection would write to shared pages, and so copy them
    ours, theirs = host_sockets()
    parent = os.getpid()
    pid = os.fork()
    if not pid:
        try:
            _become_host(theirs.detach(), parent, path)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)
    theirs.close()
    os.environ[_VARIABLE] = f"{pid} {ours.detach()}"


@contextmanager
def forked_host(path: Sequence[str]) -> Iterator[None]:
    """Fork a host as `fork_host` does; end an unused host after the block."""
    fork_host(path)
    try:
        yield
    finally:
        pid, _, fd = os.environ.pop(_VARIABLE, "").partition(" ")
        if fd:
            os.close(int(fd))
            os.waitpid(int(pid), 0)


def take_forked_host(
    folders: Sequence[Sequence[str]], printed: int
) -> tuple[ForkedHost, socket.socket] | None:
    """(the forked host, its socket) at the first call; None later, or without a forked host.

    `folders` and `printed`: as for a host that is started by exec.
    """
    pid, _, fd = os.environ.pop(_VARIABLE, "").partition(" ")
    if not fd:
        return None
    ours = socket.socket(fileno=int(fd))
    socket.send_fds(ours, [msgspec.json.encode(folders)], [printed])
    return ForkedHost(int(pid)), ours


def _become_host(fd: int, parent: int, path: Sequence[str]) -> None:
    from swarmd.pattern_host import worker  # which `fork_host` has loaded

    die_with_parent(parent)
    os.setsid()
    Path("/proc/self/comm").write_text("swarmd-host")
    # No standard input, and no file descriptor of the daemon except the host's socket.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    os.closerange(3, fd)
    os.closerange(fd + 1, os.sysconf("SC_OPEN_MAX"))
    sys.path[:] = path
    os.environ.update(ONE_THREAD)
    # The first packet: the folders of the sandbox, and the file that takes what patterns print.
    with socket.socket(fileno=os.dup(fd)) as daemon:
        folders, descriptors, _, _ = socket.recv_fds(daemon, 1 << 18, 1)
    if not descriptors:  # the daemon ended before it used the host
        os._exit(0)
    os.dup2(descriptors[0], 2)
    os.close(descriptors[0])
    worker.run(fd, parent, folders)
    sys.stdout.flush()
    os._exit(0)

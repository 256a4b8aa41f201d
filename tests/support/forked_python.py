"""`python -m MODULE` as a fork of a server that has the imports of the module.

A worker of an experiment that starts from nothing takes 0.6 s of CPU, and its run of two robots
and 2 s takes 0.07 s. The fork is a child of the test's process, as a started process is.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import inspect
import json
import os
import runpy
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

MODULES = (
    *("swarmd.pattern_host.plugin_inspector", "swarmd.sim.experiments.pool"),
    *("swarmd.sim.live.server", "swarmd.pattern_host"),
)
HOSTS = MODULES[-1:]
"""The module of pattern hosts, which a daemon starts after its first host."""
COMM = "test-forks"
"""The name of a server that is a child of a daemon, in /proc/PID/comm."""
_LAZY_IMPORTS = (
    *("scipy.sparse.csgraph", "scipy.spatial", "swarmd.pattern_host.worker"),
    "swarmd.testing.pattern_contract",
)
_READ_AT_START = ("SWARMD_COMPILED", "PYTHONPATH", "PYTHONHASHSEED", "LD_PRELOAD")
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER: orphans of descendants become children of this process
_MAX_REQUEST = 1 << 18  # bytes, of an environment
_MAX_DESCRIPTORS = 16
_ABOVE = 64  # descriptors of a request are moved above those that the fork asks for
_SIGNATURE = inspect.signature(subprocess.Popen._execute_child)  # type: ignore[attr-defined]


class ForkedPython(subprocess.Popen[Any]):
    """A `subprocess.Popen` that forks `python -P -m MODULE` and starts all other commands."""

    server: ClassVar[Server]

    def _execute_child(self, *args: Any, **options: Any) -> None:
        given = _SIGNATURE.bind(self, *args, **options).arguments
        command, environ = given["args"], given["env"]
        environ = dict(os.environ if environ is None else environ)
        if not self.server.has_imports_of(command, environ):
            super()._execute_child(*args, **options)  # type: ignore[misc]
            return
        pipe_ends = [given[name] for name in ("p2cread", "c2pwrite", "errwrite")]
        streams = [end if end >= 0 else number for number, end in enumerate(pipe_ends)]
        passed = sorted(given["pass_fds"])
        request = {
            "words": [os.fsdecode(word) for word in command[3:]],
            "folder": os.fsdecode(given["cwd"] or os.getcwd()),
            "environ": environ,
            "parent": os.getpid(),
            "group": given["process_group"],
            "session": given["start_new_session"],
            "targets": [0, 1, 2, *passed],
        }
        self.pid = self.server.fork(request, [*streams, *passed])
        self._child_created = True
        names = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(given[name] for name in names))  # type: ignore[attr-defined]


class Server:
    """The other end of a process from which commands that run one of `modules` are forked."""

    def __init__(self, connect: Callable[[], socket.socket], modules: Sequence[str]) -> None:
        """`connect` gives the connection, when the first command is forked."""
        self._environ = {name: os.environ.get(name) for name in _READ_AT_START}
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._connect, self._modules = connect, modules

    def has_imports_of(self, command: Any, environ: dict[str, str]) -> bool:
        """Whether the command runs one of the modules, with what Python reads at its start."""
        return (
            list(command[:3]) == [sys.executable, "-P", "-m"]
            and command[3] in self._modules
            and all(environ.get(name) == value for name, value in self._environ.items())
        )

    def fork(self, request: dict[str, Any], descriptors: list[int]) -> int:
        """The process id of a fork that runs the command."""
        with self._lock:
            if self._socket is None:
                self._socket = self._connect()
            _become_subreaper(True)
            try:
                socket.send_fds(self._socket, [json.dumps(request).encode()], descriptors)
                return int(self._socket.recv(100))
            finally:
                _become_subreaper(False)


def _connection() -> tuple[socket.socket, socket.socket]:
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


@contextmanager
def forked_python() -> Iterator[type[ForkedPython]]:
    """The class that takes the place of `subprocess.Popen`, with a server until the end.

    The server starts with the first command that is forked.
    """
    with contextlib.ExitStack() as left:

        def connect() -> socket.socket:
            from swarmd.core.pin import pinned_environment

            ours, theirs = _connection()
            with theirs:
                process = subprocess.Popen(
                    [sys.executable, "-P", __file__, str(theirs.fileno())],
                    pass_fds=(theirs.fileno(),),
                    stdin=subprocess.DEVNULL,
                    # Workers of experiments are pinned, which acts at the start of a process alone.
                    env={**pinned_environment(), "OPENBLAS_NUM_THREADS": "1"},
                    process_group=0,
                )
            left.callback(process.wait)
            left.callback(ours.close)
            return ours

        yield type("ForkedPython", (ForkedPython,), {"server": Server(connect, MODULES)})


def fork_hosts() -> None:
    """Let all pattern hosts of this process be forks of a fork that has their imports.

    Called before this process, which becomes a daemon, starts a thread. A host that starts from
    nothing takes 0.15 s of CPU, and most tests of daemons end a run, after which another begins.
    """
    from swarmd.core.processes import die_with_parent
    from swarmd.pattern_host import worker  # noqa: F401  # what a host imports

    ours, theirs = _connection()
    daemon = os.getpid()
    if os.fork() == 0:
        code = 1
        try:
            ours.close()
            die_with_parent(daemon)
            Path("/proc/self/comm").write_text(COMM)
            _serve_and_run(theirs, HOSTS)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            with contextlib.suppress(OSError):
                sys.stdout.flush()
            os._exit(code)
    theirs.close()
    server = Server(lambda: ours, HOSTS)
    subprocess.Popen = type("ForkedPython", (ForkedPython,), {"server": server})  # type: ignore[assignment, misc]


def _become_subreaper(value: bool) -> None:
    assert ctypes.CDLL(None).prctl(_SUBREAPER, int(value), 0, 0, 0) == 0


def _serve_and_run(connection: socket.socket, modules: Sequence[str]) -> None:
    """Fork for each request until the other side ends; a fork runs its module."""
    with connection:
        module = _serve(connection, modules)
    if module is not None:
        runpy.run_module(module, run_name="__main__", alter_sys=True)


def _serve(connection: socket.socket, modules: Sequence[str]) -> str | None:
    """Fork for each request until the other side ends; in a fork, the name of its module."""
    for name in modules:
        __import__(name)
    for name in modules:
        if not hasattr(sys.modules[name], "__path__"):  # each fork runs its own, as a process does
            del sys.modules[name]
    gc.freeze()  # a collection of garbage would write to the pages that all forks share
    while True:
        text, descriptors, _, _ = socket.recv_fds(connection, _MAX_REQUEST, _MAX_DESCRIPTORS)
        if not text:
            return None
        request = json.loads(text)
        if os.fork() == 0:
            if os.fork() > 0:
                os._exit(0)
            if request["session"]:
                os.setsid()
            elif request["group"] >= 0:
                os.setpgid(0, request["group"])
            while os.getppid() != request["parent"]:
                time.sleep(0.001)
            connection.send(str(os.getpid()).encode())
            connection.close()
            _enter(request, descriptors)
            return str(request["words"][0])
        os.wait()
        for descriptor in descriptors:
            os.close(descriptor)


def _enter(request: dict[str, Any], descriptors: list[int]) -> None:
    """Give this fork what a started process has."""
    import numpy as np

    Path("/proc/self/comm").write_text("python")
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environ"])
    moved = [fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, _ABOVE) for number in descriptors]
    for descriptor in descriptors:
        os.close(descriptor)
    for source, target in zip(moved, request["targets"], strict=True):
        os.dup2(source, target)
        os.close(source)
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)
    sys.argv = request["words"]
    np.random.seed()  # a process that starts takes it from the system, too


if __name__ == "__main__":
    Path("/proc/self/comm").write_text(COMM)  # `children` does not count it; forks have their own
    for lazy in _LAZY_IMPORTS:
        __import__(lazy)
    _serve_and_run(socket.socket(fileno=int(sys.argv[1])), MODULES)

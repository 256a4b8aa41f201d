"""`python -m MODULE` as a fork of a server that has the imports of the module.

A worker of an experiment that starts from nothing takes 0.6 s of CPU, and its run of two robots
and 2 s takes 0.07 s. The fork is a child of the test's process, as a started process is.
"""

from __future__ import annotations

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
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

MODULES = (
    *("swarmd.pattern_host.plugin_inspector", "swarmd.sim.experiments.pool"),
    "swarmd.sim.live.server",
)
_LAZY_IMPORTS = ("scipy.sparse.csgraph", "scipy.spatial", "swarmd.testing.pattern_contract")
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
    """The process from which commands are forked."""

    def __init__(self) -> None:
        self._environ = {name: os.environ.get(name) for name in _READ_AT_START}
        self._lock = threading.Lock()
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                process_group=0,
            )

    def has_imports_of(self, command: Any, environ: dict[str, str]) -> bool:
        """Whether the command runs one of MODULES, with what Python reads at its start."""
        return (
            list(command[:3]) == [sys.executable, "-P", "-m"]
            and command[3] in MODULES
            and all(environ.get(name) == value for name, value in self._environ.items())
        )

    def fork(self, request: dict[str, Any], descriptors: list[int]) -> int:
        """The process id of a fork that runs the command."""
        with self._lock:
            _become_subreaper(True)
            try:
                socket.send_fds(self._socket, [json.dumps(request).encode()], descriptors)
                return int(self._socket.recv(100))
            finally:
                _become_subreaper(False)

    def end(self) -> None:
        """End the server."""
        self._socket.close()
        self._process.wait()


@contextmanager
def forked_python() -> Iterator[type[ForkedPython]]:
    """The class that takes the place of `subprocess.Popen`, with a server until the end."""
    server = Server()
    try:
        yield type("ForkedPython", (ForkedPython,), {"server": server})
    finally:
        server.end()


def _become_subreaper(value: bool) -> None:
    assert ctypes.CDLL(None).prctl(_SUBREAPER, int(value), 0, 0, 0) == 0


def _serve(connection: socket.socket) -> str | None:
    """Fork for each request until the other side ends; in a fork, the name of its module."""
    for name in (*MODULES, *_LAZY_IMPORTS):
        __import__(name)
    for name in MODULES:
        del sys.modules[name]  # each fork runs its own, as a started process does
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
    with socket.socket(fileno=int(sys.argv[1])) as ours:
        module = _serve(ours)
    if module is not None:
        runpy.run_module(module, run_name="__main__", alter_sys=True)

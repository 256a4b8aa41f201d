"""Processes of Python that share their imports: forks of a server that has imported them.

The server is that of `multiprocessing`: a process without threads, which ends with this one. Seven
daemons are ready after a third of the time that they take one by one with imports of their own.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import forkserver, resource_tracker
from multiprocessing.util import get_temp_dir
from pathlib import Path
from types import ModuleType

# Of the server. Safe path: a random.py where this is called is not to shadow a module. A BLAS with
# threads would not outlive a fork.
_ENVIRON = {"PYTHONSAFEPATH": "1", "OPENBLAS_NUM_THREADS": "1"}
SERVER_PATH = tuple(sys.path)
"""In a fork: the import path of the server, without the folder of the program that started it."""


_SERVER_IS_GONE = 255  # no main() of swarmd ends with this code


class ForkedProcess:
    """A process that `fork_main` began, with the methods of `subprocess.Popen`."""

    stdout = None

    def __init__(self, process: multiprocessing.process.BaseProcess) -> None:
        self._process = process
        self.pid = process.pid or 0

    @property
    def returncode(self) -> int | None:
        """The exit code, less than 0 for a signal; None while it runs."""
        return self.poll()

    def poll(self) -> int | None:
        """The exit code; None while it runs.

        If the server is gone, multiprocessing gives 255; the kernel has killed the process then.
        """
        code = self._process.exitcode
        return -signal.SIGKILL if code == _SERVER_IS_GONE else code

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; TimeoutExpired after `timeout` s."""
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended: the server may know that first."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def start_server(modules: Iterable[str]) -> None:
    """Start the server, which imports these modules; it is not waited for.

    The server and its forks begin with SIGINT blocked. They belong to the process group of this
    process until a fork has a session of its own, and a Ctrl-C of the terminal reaches the whole
    group: an import of the server that it interrupts prints a traceback.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, *modules])
    resource_tracker.ensure_running()  # before SIGINT is blocked: its start unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with _environment(_ENVIRON):
            forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # a SIGINT of meanwhile arrives here


def remove_folder() -> None:
    """Remove the server's socket and its folder, before a process ends without doing so."""
    shutil.rmtree(get_temp_dir(), ignore_errors=True)


def fork_main(
    name: str, module: str, arguments: Iterable[str], *, stdout: Path | None, stderr: Path
) -> ForkedProcess:
    """Run `main()` of a module in a fork of the server, which was started.

    `name` is what `ps` shows and `pgrep -x` finds; its command line is that of the server.
    The process has a session of its own, and the folder and the environment of this process; what
    the imported modules read of the environment was read by the server. It gets `arguments` and
    `--die-with-parent` with the id of the server, appends to the files `stdout` (None: nowhere) and
    `stderr`, and reads nothing.
    """
    out, err = (os.path.abspath(path or os.devnull) for path in (stdout, stderr))
    for path in (out, err):
        open(path, "a").close()  # it is there when this returns
    words = (name, module, tuple(arguments), out, err, os.getcwd(), dict(os.environ))
    process = multiprocessing.get_context("forkserver").Process(target=_run, args=words)
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")  # else the fork runs the caller's again
    try:
        process.start()
    finally:
        sys.modules["__main__"] = main
    return ForkedProcess(process)


def _run(
    name: str,
    module: str,
    arguments: tuple[str, ...],
    out: str,
    err: str,
    folder: str,
    environ: dict[str, str],
) -> None:
    # The server ends once this pipe has no writer any more: the first process alone is one.
    os.close(forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # discards a SIGINT from before the session
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    Path("/proc/self/comm").write_text(name)  # of which the kernel takes 15 characters
    os.chdir(folder)
    for number, path in enumerate((os.devnull, out, err)):
        flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT | os.O_APPEND
        file = os.open(path, flags, 0o644)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environ)
    sys.argv = [module, *arguments, "--die-with-parent", str(os.getppid())]
    gc.freeze()  # a collection writes to pages that are shared
    import_module(module).main()


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Add variables to those of this process, for what it starts meanwhile."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

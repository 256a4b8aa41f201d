"""Starts Python processes that share their imports, as forks of a server with these imports.

The server is the fork server of `multiprocessing`: a process without threads, which ends with this
process. Seven daemons are ready in a third of the time that they take with imports of their own.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import forkserver, resource_tracker
from multiprocessing.util import get_temp_dir
from pathlib import Path
from types import ModuleType

# Environment of the server. Safe path: a random.py in the current folder must not shadow a module.
# The threads of a BLAS library would not survive a fork.
_ENVIRON = {"PYTHONSAFEPATH": "1", "OPENBLAS_NUM_THREADS": "1"}
SERVER_PATH = tuple(sys.path)
"""In a fork: the import path of the server, without the folder of the program that started it."""


_MAX_TEMP = 70
"""Bytes: a Unix socket's path has at most 107, and multiprocessing adds two names of up to 18."""
_SERVER_IS_GONE = 255  # no main() of swarmd ends with this code


class ForkedProcess:
    """A process that `fork_main` began, with the methods of `subprocess.Popen`."""

    stdout = None

    def __init__(self, process: multiprocessing.process.BaseProcess) -> None:
        self._process = process
        self.pid = process.pid or 0

    @property
    def returncode(self) -> int | None:
        """The exit code, negative for a signal; None while the process runs."""
        return self.poll()

    def poll(self) -> int | None:
        """The exit code; None while the process runs.

        If the server has ended, the kernel has killed its forks with SIGKILL (`--die-with-parent`).
        multiprocessing does not know this, and gives the code 255. This method then returns the
        code of SIGKILL.
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
        """Send a signal, unless the process has ended, which the server may notice first."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


def start_server(modules: Iterable[str]) -> None:
    """Start the server, which imports `modules`; returns without waiting for the imports.

    The server and its forks begin with SIGINT blocked. They belong to the process group of this
    process until a fork makes a session of its own. A Ctrl-C in the terminal reaches the whole
    group, and would interrupt an import of the server with a traceback.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, *modules])
    resource_tracker.ensure_running()  # before SIGINT is blocked: its start unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    use_short_folder()
    try:
        with _environment(_ENVIRON):
            forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # delivers a SIGINT that was blocked


def use_short_folder() -> None:
    """Let the server's socket be in /tmp if the path of the usual temporary folder is too long."""
    if len(os.fsencode(tempfile.gettempdir())) > _MAX_TEMP:
        usual = tempfile.tempdir
        tempfile.tempdir = "/tmp"
        try:
            get_temp_dir()  # made here, and kept for this process
        finally:
            tempfile.tempdir = usual


def remove_folder() -> None:
    """Remove the server's socket and its folder, before a process ends without doing so."""
    shutil.rmtree(get_temp_dir(), ignore_errors=True)


def fork_main(
    name: str, module: str, arguments: Iterable[str], *, stdout: Path | None, stderr: Path
) -> ForkedProcess:
    """Run `main()` of a module in a fork of the started server.

    - `name`: the name of the fork in `ps` and `pgrep -x`, which show the server's command line.
    - `arguments`: the arguments of `main()`. The fork adds `--die-with-parent` with the id of the
      server.
    - `stdout`, `stderr`: the files to which the output is appended; None: the output is dropped.
      The standard input is empty.

    The fork has a session of its own, and the current folder and environment of the caller. But
    modules that the server imported may have read the environment of the server.
    """
    stdout_path, stderr_path = (os.path.abspath(path or os.devnull) for path in (stdout, stderr))
    for path in (stdout_path, stderr_path):
        open(path, "a").close()  # the file exists once this function returns
    run_arguments = (
        name,
        module,
        tuple(arguments),
        stdout_path,
        stderr_path,
        os.getcwd(),
        dict(os.environ),
    )
    process = multiprocessing.get_context("forkserver").Process(target=_run, args=run_arguments)
    main_module = sys.modules["__main__"]
    # Keeps multiprocessing from running the caller's main module again in the fork.
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        process.start()
    finally:
        sys.modules["__main__"] = main_module
    return ForkedProcess(process)


def _run(
    name: str,
    module: str,
    arguments: tuple[str, ...],
    stdout: str,
    stderr: str,
    folder: str,
    environment: dict[str, str],
) -> None:
    """In the fork: set up a process of its own, then run `main()` of `module`.

    Args:
        name: the name that `ps` shows.
        module: the module with `main()`.
        arguments: the command line behind the name of the module.
        stdout, stderr: files to which standard output and error are appended.
        folder: the current folder.
        environment: the environment.
    """
    # 1. The server ends when all writers of its "alive" pipe have closed the pipe. So a fork closes
    #    the pipe: the server must end with the process that started it, not with the last fork.
    os.close(forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]

    # 2. A session of its own, and a name. The fork begins with SIGINT blocked (`start_server`).
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # discards a SIGINT from before the session
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    Path("/proc/self/comm").write_text(name)  # the kernel keeps 15 characters

    # 3. Folder, streams, environment and arguments; then the program.
    os.chdir(folder)
    for descriptor, stream_path in enumerate((os.devnull, stdout, stderr)):
        flags = os.O_RDONLY if descriptor == 0 else os.O_WRONLY | os.O_CREAT | os.O_APPEND
        file = os.open(stream_path, flags, 0o644)
        os.dup2(file, descriptor)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments, "--die-with-parent", str(os.getppid())]
    gc.freeze()  # a garbage collection would write to shared pages, and so copy them
    import_module(module).main()


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within the block, for processes that are started there."""
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

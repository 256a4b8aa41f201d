"""Stalls on purpose: processes of a test run stand still for a moment, as on a busy machine.

`make test-all STALLS=1` starts one process of this module for each worker of pytest, which
stops some process of the worker's tree again and again. The number is the seed of the moments,
the lengths and the choices. Without `STALLS` in the environment nothing here runs.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

LONG = (0.3, 1.5)
"""s, of a stall of pytest, a world, a bridge or a hub."""
COMMAND = (0.3, 0.9)
"""s, of a stall of a `swarmctl`: after a stall of 1 s it refuses to start a run. A test of that
refusal stops the process itself."""
SHORT = (0.05, 0.25)
"""s, of a stall of a daemon and its processes. A robot whose daemon stands still for longer must
hold: a test of that stops its daemon itself."""
GAP = (0.5, 4.0)
"""s, between two stalls of a worker's tree."""
_ALONE = 0.7
"""How often one process stands still; else all of its kind do, or all with the length SHORT."""
_LONG_PROGRAMS = ("python", "zenoh", "ros2-router", "rosmaster", "roscore")
_DAEMON_MODULES = (
    "swarmd.cli.daemon",  # of an earlier version
    "swarmd.operator.cli.daemon",
    "swarmd.pattern_host",
    "swarmd.driver_api.watchdog",
    "ros1/adapter_process.py",
    "tests.support.other_version",
)
_OPERATORS = ("swarmctl", "python", "pt_main_thread", "test-forks")
_FORK_SERVER = "multiprocessing.forkserver"


class Stalls:
    """The stalls of this worker's tree; `stop` ends them, and every stopped process goes on."""

    def __init__(self, seed: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="stalls-")
        self.lock, self.log = (Path(self._folder.name, name) for name in ("lock", "log"))
        self.lock.touch()
        self.log.touch()
        words = (str(os.getpid()), seed, self._folder.name)
        subprocess.run([sys.executable, "-P", __file__, *words], check=True)
        self._kill = os.kill
        os.kill = self._kill_between_stalls

    def stop(self) -> None:
        """No stall from now on; a stall that goes on ends first, since it writes to the folder."""
        os.kill = self._kill
        with _locked(self.lock):
            self._folder.cleanup()

    def said(self) -> str:
        """The last stalls, one a line, with the CLOCK_MONOTONIC of their begin."""
        return "\n".join(self.log.read_text().splitlines()[-20:])

    def _kill_between_stalls(self, pid: int, number: int) -> None:
        """`os.kill`: a process that a test stops is not stopped, and so not continued, by a stall.

        Returns once a process that is stopped by SIGSTOP stands still.
        """
        if number != signal.SIGSTOP or pid == os.getpid():
            self._kill(pid, number)
            return
        with _locked(self.lock):
            self._kill(pid, number)
            deadline = time.monotonic() + 1.0
            while _state(pid) not in ("T", "Z", "") and time.monotonic() < deadline:
                os.sched_yield()


@contextmanager
def _locked(lock: Path) -> Iterator[None]:
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _stat(pid: int) -> list[str]:
    """The fields of /proc/PID/stat from the state on; none if the process has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _state(pid: int) -> str:
    return "".join(_stat(pid)[:1])


def tree(root: int) -> dict[int, int]:
    """The parent of each descendant of `root`, parents first, and of `root` itself."""
    found = {root: 0}
    waiting = [root]
    while waiting:
        parent = waiting.pop()
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            for path in Path(f"/proc/{parent}/task").glob("*/children"):
                with contextlib.suppress(OSError):  # this thread has ended meanwhile
                    for child in map(int, path.read_text().split()):
                        found[child] = parent
                        waiting.append(child)
    return found


def kinds(root: int) -> dict[int, tuple[float, float]]:
    """LONG, COMMAND or SHORT for each process of the tree that may stand still.

    What descends from a daemon is SHORT, too. A fork of the server has the command line of the
    server and, if it is a daemon, the name of its robot.
    """
    found = dict[int, tuple[float, float]]()
    for pid, parent in tree(root).items():
        try:
            name = Path(f"/proc/{pid}/comm").read_text().strip()
            line = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        is_fork = _FORK_SERVER in line and not name.startswith(_OPERATORS)
        if found.get(parent) == SHORT or is_fork or any(one in line for one in _DAEMON_MODULES):
            found[pid] = SHORT
        elif name.startswith("swarmctl"):
            found[pid] = COMMAND
        elif any(one in Path(line.split("\0")[0]).name for one in _LONG_PROGRAMS):
            found[pid] = LONG
    return found


def _stall(root: int, draw: random.Random, folder: Path, notes: TextIO) -> None:
    """Let one process, or all of a kind, stand still once; FileNotFoundError without the folder."""
    found = kinds(root)
    if not found:
        return
    chosen = [draw.choice(sorted(found))]
    length = found[chosen[0]]
    if draw.random() > _ALONE:
        chosen = [pid for pid, one in found.items() if one == length]
    seconds = draw.uniform(*length)
    with _locked(folder / "lock"), contextlib.ExitStack() as opened:
        if not (folder / "log").exists():  # removed while this process waited for the lock
            raise FileNotFoundError(folder)
        stopped = dict[int, int]()
        for pid in chosen:
            with contextlib.suppress(OSError):
                descriptor = os.pidfd_open(pid)
                opened.callback(os.close, descriptor)
                if _state(pid) in ("R", "S", "D") and pid in tree(root):
                    stopped[pid] = descriptor
        print(*stopped, file=notes, flush=True)
        try:
            began = time.monotonic()
            for descriptor in stopped.values():
                with contextlib.suppress(OSError):
                    signal.pidfd_send_signal(descriptor, signal.SIGSTOP)
            time.sleep(seconds)
        finally:
            for descriptor in stopped.values():
                with contextlib.suppress(OSError):
                    signal.pidfd_send_signal(descriptor, signal.SIGCONT)
        print(file=notes, flush=True)
        names = [_name(pid) for pid in stopped]
        with (folder / "log").open("a") as file:
            file.write(f"{began:.3f} {time.monotonic() - began:.3f} s: {', '.join(names)}\n")


def _name(pid: int) -> str:
    try:
        return f"{Path(f'/proc/{pid}/comm').read_text().strip()} ({pid})"
    except OSError:
        return f"({pid})"


def _keep(notes: int) -> None:
    """Continue what the process that makes stalls had stopped when it ended."""
    stopped = ""
    with os.fdopen(notes) as lines:
        for line in lines:
            stopped = line
    for pid in map(int, stopped.split()):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGCONT)


def _run(root: int, seed: str, folder: Path) -> None:
    """Make stalls until `root` has ended or its folder has gone."""
    draw = random.Random(seed)
    reader, writer = os.pipe()
    if os.fork() == 0:
        os.setsid()
        os.close(writer)
        _keep(reader)
        return
    os.close(reader)
    notes = os.fdopen(writer, "w")
    ended = os.pidfd_open(root)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)  # a short stall stays short
    while not select.select([ended], [], [], draw.uniform(*GAP))[0]:
        try:
            _stall(root, draw, folder, notes)
        except FileNotFoundError:
            return


if __name__ == "__main__":
    # Neither a child of the worker, whose children tests count, nor of its session.
    starter = os.getpid()
    if os.fork() == 0:
        os.setsid()
        while os.getppid() == starter:  # as long as it lives, this process is in the worker's tree
            time.sleep(0.01)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for stream in (0, 1, 2):
            os.dup2(os.open(os.devnull, os.O_RDWR), stream)
        _run(int(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))

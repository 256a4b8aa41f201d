"""One run over several processes: each works out an equal share of the robots.

Bodies meet in MuJoCo alone, which gives the same bits in each process. So each process advances the
whole world, with all clocks and the radio, and works out sensors, robots and patterns of its own
rows only. Once a step the processes exchange what their robots put out. What is exchanged lies in
memory that they share; a semaphore for each pair of processes says that it is there.
"""

from __future__ import annotations

import mmap
import os
import pickle
import signal
import struct
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Semaphore
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import SwarmError
from swarmd.core.processes import die_with_parent, how_it_ended

T = TypeVar("T")

TIMEOUT = 50.0
"""Limit in s of wall time for one step of a process; a bit below that of a step of a whole run."""

_SPIN = 50e-6  # s of asking before a process sleeps, which takes about as long to end
_POLL_PERIOD = 0.25  # s between two looks at processes that one waits for
_CHUNK = 1 << 20  # bytes of each process that one round exchanges
_HEAD = struct.Struct("q")
_SLOT = _HEAD.size + _CHUNK
_MAX_ERROR = 1 << 16  # bytes, which a pipe holds without a reader


class RunProcess:
    """Process `index` of the `count` of a run, with the robots that `share` gives it."""

    def __init__(self, index: int = 0, count: int = 1) -> None:
        self.index, self.count = index, count
        self.rows_of: Sequence[NDArray[np.intp]] = ()
        """The rows of the robots of each process, in order."""
        self._own = frozenset[int]()

    def share(self, order: NDArray[np.intp]) -> None:
        """Give the robots to the processes in turn; all processes call it with the same `order`.

        A step waits for the process with the most work. Robots whose work falls into the same step
        should follow each other in `order`: the steps of half of the robots are then equally long.
        """
        self.rows_of = [np.sort(order[index :: self.count]) for index in range(self.count)]
        self._own = frozenset(self.rows.tolist())

    def owns(self, row: int) -> bool:
        """True if this process works out robot `row`."""
        return row in self._own

    @property
    def rows(self) -> NDArray[np.intp]:
        """The rows of its robots, in order."""
        return self.rows_of[self.index]

    def own(self, rows: list[int]) -> list[int]:
        """Those of `rows` that are its own, in order."""
        return rows if self.count == 1 else [row for row in rows if row in self._own]

    def exchange(self, part: T) -> list[T]:
        """The parts of all processes, in their order; each calls it equally often."""
        return [part]

    def collect(self, part: T) -> list[T]:
        """As `exchange` for the first process; empty for the others."""
        return self.exchange(part)


class _Member(RunProcess):
    """A process beside others."""

    def __init__(
        self,
        index: int,
        memory: mmap.mmap,
        ready: list[list[Semaphore]],
        watch: Callable[[int, float], None],
    ) -> None:
        """`ready[a][b]`: process a has written what b may read. `watch(process, seconds)` is
        called while this one waits for `process`, with the time since the call before; it may
        raise."""
        super().__init__(index, len(ready))
        self._memory = memory
        self._ready = ready
        self._watch = watch
        # The halves take turns: before a process writes a half again, all have read that half.
        self._half = 0
        self._pid: int | None = None

    def exchange(self, part: T) -> list[T]:
        received = self._exchange_bytes(pickle.dumps(part, pickle.HIGHEST_PROTOCOL), keeps=True)
        return self._loaded(received, part)

    def collect(self, part: T) -> list[T]:
        if self.index == 0:
            return self._loaded(self._exchange_bytes(b"", keeps=True), part)
        self._exchange_bytes(pickle.dumps(part, pickle.HIGHEST_PROTOCOL), keeps=False)
        return []

    def _loaded(self, received: list[bytearray], own: T) -> list[T]:
        return [own if i == self.index else pickle.loads(data) for i, data in enumerate(received)]

    def _exchange_bytes(self, data: bytes, *, keeps: bool) -> list[bytearray]:
        """The data of all other processes, in rounds of `_CHUNK` until each has sent its all."""
        self._pid = self._pid or os.getpid()
        if self._pid != os.getpid():  # forked by a pattern: it has no part in the run
            os._exit(0)
        others = [process for process in range(self.count) if process != self.index]
        received = [bytearray() for _ in range(self.count)]
        done, longest = 0, 1
        while done < longest:
            self._write(len(data), data[done : done + _CHUNK])
            for process in others:
                self._ready[self.index][process].release()
            longest = len(data)
            for process in others:
                self._wait(process)
                at = self._slot(process)
                (size,) = _HEAD.unpack_from(self._memory, at)
                longest = max(longest, size)
                if keeps:
                    begin, end = at + _HEAD.size, at + _HEAD.size + min(_CHUNK, size - done)
                    received[process] += self._memory[begin : max(begin, end)]
            done += _CHUNK
            self._half = 1 - self._half
        return received

    def _write(self, size: int, chunk: bytes) -> None:
        at = self._slot(self.index)
        _HEAD.pack_into(self._memory, at, size)
        self._memory[at + _HEAD.size : at + _HEAD.size + len(chunk)] = chunk

    def _slot(self, process: int) -> int:
        return (self._half * self.count + process) * _SLOT

    def _wait(self, process: int) -> None:
        ready = self._ready[process][self.index]
        end = time.perf_counter() + _SPIN
        while time.perf_counter() < end:
            if ready.acquire(False):
                return
        before = time.monotonic()
        while not ready.acquire(True, _POLL_PERIOD):
            now = time.monotonic()
            # Time in which this process did not run either, as if suspended, does not count.
            self._watch(process, min(now - before, 2.0 * _POLL_PERIOD))
            before = now
        self._watch(process, 0.0)


class _Children:
    """All processes of a run but the first."""

    def __init__(self, count: int, timeout: float) -> None:
        self._count, self._timeout = count, timeout
        self._silence = 0.0
        self._pids: dict[int, int] = {}
        self._errors: dict[int, int] = {}

    def fork(self, process: int, work: Callable[[], object]) -> None:
        """Do the work of a process in a fork."""
        ours, theirs = os.pipe()
        parent = os.getpid()
        sys.stdout.flush()
        sys.stderr.flush()
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                die_with_parent(parent)
                work()
                code = 0
            except BaseException as error:
                os.write(theirs, _dumped(error))
            finally:
                with suppress(OSError, ValueError):
                    sys.stdout.flush()
                    sys.stderr.flush()
                os._exit(code)
        os.close(theirs)
        os.set_blocking(ours, False)
        self._pids[process], self._errors[process] = pid, ours

    def watch(self, process: int, seconds: float) -> None:
        """Raise the error that ended a process, or SwarmError if a process ended without one.

        `process` is waited for, and was for `seconds` more; 0 if it is there.
        """
        if seconds == 0.0:
            self._silence = 0.0
            return
        for number, pid in list(self._pids.items()):
            has_ended, code = _ended(pid)
            if has_ended:
                del self._pids[number]
                raise self._error(number, code)
        self._silence += seconds
        if self._silence >= self._timeout:
            raise SwarmError(
                f"{self._name(process)} made no progress in {self._timeout:g} s; a pattern may not"
                " return"
            )

    def end(self) -> None:
        """End all that still run."""
        for pid in self._pids.values():
            if not _ended(pid)[0]:
                os.kill(pid, signal.SIGKILL)
                with suppress(ChildProcessError):  # a pattern ignores SIGCHLD
                    os.waitpid(pid, 0)
        for pipe in self._errors.values():
            os.close(pipe)

    def _name(self, process: int) -> str:
        return f"process {process + 1} of the {self._count} of this run"

    def _error(self, process: int, code: int | None) -> BaseException:
        with suppress(BlockingIOError):
            written = os.read(self._errors[process], _MAX_ERROR)
            if written:
                error: BaseException = pickle.loads(written)
                return error
        hint = " (out of memory, or killed by hand)" if code == -signal.SIGKILL else ""
        return SwarmError(f"{self._name(process)} {how_it_ended(code)}{hint}")


def _ended(pid: int) -> tuple[bool, int | None]:
    """Whether a child has ended, and its exit code; None if a pattern ignores or took it."""
    try:
        ended, status = os.waitpid(pid, os.WNOHANG)
    except ChildProcessError:
        return True, None
    return ended != 0, os.waitstatus_to_exitcode(status) if ended else None


def _dumped(error: BaseException) -> bytes:
    """The error for another process, as SwarmError if it cannot be sent itself."""
    with suppress(Exception):
        data = pickle.dumps(error)
        pickle.loads(data)
        if isinstance(error, Exception) and len(data) <= _MAX_ERROR:
            return data
    return pickle.dumps(SwarmError(f"{type(error).__name__}: {error}"[:1000]))


def run_processes(work: Callable[[RunProcess], T], count: int, timeout: float = TIMEOUT) -> T:
    """What `work` returns for the first of `count` processes; the others are forks of this one.

    Raises what `work` raises in any of them, and SwarmError with the number of a process that ended
    or that made no progress for `timeout` s, or if /dev/shm cannot be written. No process is left
    behind.
    """
    if count == 1:
        return work(RunProcess())
    context = get_context("fork")
    memory = mmap.mmap(-1, 2 * count * _SLOT)
    try:
        ready = [[context.Semaphore(0) for _ in range(count)] for _ in range(count)]
    except OSError as error:  # sem_open(3) makes a file there, and names none
        text = f"/dev/shm: {error.strerror}; the {count} processes of a run keep semaphores there"
        raise SwarmError(f"{text}: mount it as tmpfs with some room, or take --cores 1") from error
    children = _Children(count, timeout)
    try:
        for index in range(1, count):
            # A child waits as long as its parent lives, which watches all of them.
            child = _Member(index, memory, ready, lambda process, seconds: None)
            children.fork(index, partial(work, child))
        return work(_Member(0, memory, ready, children.watch))
    finally:
        children.end()

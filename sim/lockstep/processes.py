"""One lockstep run over several processes: each process simulates an equal share of the robots.

Bodies interact in MuJoCo alone, which gives equal bits in each process. So each process advances
the whole world, all schedules and the radio, but simulates the sensors, robots and patterns of its
own rows only. Once per step the processes exchange the outputs of their robots through shared
memory. A semaphore for each pair of processes (writer, reader) signals that data are ready.
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
"""Limit in s of wall time for one step of a process; below STEP_TIMEOUT, the limit of a run."""

# s of busy waiting before a process sleeps: more than the shares of a step differ. To wake up takes
# about 50 us, often twice in a step of 1 ms.
_SPIN = 1e-3
_POLL_PERIOD = 0.25  # s between two checks of processes while one waits
_CHUNK = 1 << 20  # bytes of each process that one round exchanges
_HEAD = struct.Struct("q")
_SLOT = _HEAD.size + _CHUNK
_MAX_ERROR = 1 << 16  # bytes, which a pipe holds without a reader


def _nothing() -> None:
    pass


class RunProcess:
    """Process `index` of the `count` of a run, with the robots that `share` gives it."""

    def __init__(self, index: int = 0, count: int = 1) -> None:
        self.index = index
        self.count = count
        self.rows_of: Sequence[NDArray[np.intp]] = ()
        """The rows of the robots of each process, in order."""
        self._own = frozenset[int]()

    def share(self, order: NDArray[np.intp]) -> None:
        """Deal the robots of `order` (n,), row numbers, to the processes in turn.

        All processes call this with equal arguments. Each step waits for the process with the most
        work. So robots whose work falls into the same step should follow each other in `order`:
        they go to different processes, which then have equal parts of the work of a step.
        """
        self.rows_of = [np.sort(order[index :: self.count]) for index in range(self.count)]
        self._own = frozenset(self.rows.tolist())

    def owns(self, row: int) -> bool:
        """True if this process simulates robot `row`."""
        return row in self._own

    @property
    def rows(self) -> NDArray[np.intp]:
        """The rows of this process's robots, in order."""
        return self.rows_of[self.index]

    def own(self, rows: list[int]) -> list[int]:
        """The rows among `rows` that this process simulates, in order."""
        return rows if self.count == 1 else [row for row in rows if row in self._own]

    def exchange(self, part: T, meanwhile: Callable[[], None] = _nothing) -> list[T]:
        """Give `part` to all processes; the parts of all processes in the order of processes.

        Blocks until all processes have made this call, so each must make it equally often. With
        several processes, `meanwhile` is called once, before this process waits for the others.
        """
        return [part]

    def collect(self, part: T) -> list[T]:
        """As `exchange`, but only the first process receives the parts; [] in the others."""
        return self.exchange(part)


class _Member(RunProcess):
    """A process of a run with several processes."""

    def __init__(
        self,
        index: int,
        memory: mmap.mmap,
        ready: list[list[Semaphore]],
        children: _Children | None = None,
    ) -> None:
        """`ready[a][b]` is released when process a has written data for process b.

        `memory`: shared by all processes. `children`: the other processes, which this process
        checks while it waits; None: this process waits without a limit.
        """
        super().__init__(index, len(ready))
        self._memory = memory
        self._ready = ready
        self._children = children
        self._half = 0  # the half of the memory that is in use (see `_exchange_bytes`)
        self._pid: int | None = None  # of this process, from the first exchange on

    def exchange(self, part: T, meanwhile: Callable[[], None] = _nothing) -> list[T]:
        data = pickle.dumps(part, pickle.HIGHEST_PROTOCOL)
        return self._loaded(self._exchange_bytes(data, meanwhile, keeps=True), part)

    def collect(self, part: T) -> list[T]:
        if self.index == 0:
            return self._loaded(self._exchange_bytes(b"", _nothing, keeps=True), part)
        data = pickle.dumps(part, pickle.HIGHEST_PROTOCOL)
        self._exchange_bytes(data, _nothing, keeps=False)
        return []

    def _loaded(self, received: list[bytearray], own: T) -> list[T]:
        return [own if i == self.index else pickle.loads(data) for i, data in enumerate(received)]

    def _exchange_bytes(
        self, data: bytes, meanwhile: Callable[[], None], *, keeps: bool
    ) -> list[bytearray]:
        """Exchange `data` in rounds of _CHUNK bytes until the longest data are sent.

        Returns the data by process, empty for this process; empty for all processes unless `keeps`.
        `meanwhile` is called once, before this process waits for the others.

        Rounds use the two halves of the memory in turn. When a process writes round k, all peers
        have written round k - 1. So they have read round k - 2, whose half is overwritten.
        """
        # A process that a pattern has forked is no part of the run.
        if self._pid is None:
            self._pid = os.getpid()
        if self._pid != os.getpid():
            os._exit(0)
        peers = [process for process in range(self.count) if process != self.index]
        received = [bytearray() for _ in range(self.count)]
        sent = 0  # bytes of each process
        is_done = False
        while not is_done:
            self._write(len(data), data[sent : sent + _CHUNK])
            for process in peers:
                self._ready[self.index][process].release()
            if sent == 0:
                meanwhile()
            longest = len(data)
            for process in peers:
                self._wait(process)
                size, chunk = self._read(process, sent)
                longest = max(longest, size)
                if keeps:
                    received[process] += chunk
            sent += _CHUNK
            self._half = 1 - self._half
            is_done = sent >= longest
        return received

    def _read(self, process: int, sent: int) -> tuple[int, bytes]:
        """The size of all data of a process, and the chunk behind the first `sent` bytes of them.

        The chunk is empty if the data are shorter; the round then serves other processes.
        """
        slot = self._slot(process)
        (size,) = _HEAD.unpack_from(self._memory, slot)
        begin = slot + _HEAD.size
        left = max(size - sent, 0)
        return size, self._memory[begin : begin + min(_CHUNK, left)]

    def _write(self, size: int, chunk: bytes) -> None:
        at = self._slot(self.index)
        _HEAD.pack_into(self._memory, at, size)
        self._memory[at + _HEAD.size : at + _HEAD.size + len(chunk)] = chunk

    def _slot(self, process: int) -> int:
        """The byte at which the data of a process begin in the half that is in use."""
        return (self._half * self.count + process) * _SLOT

    def _wait(self, process: int) -> None:
        ready = self._ready[process][self.index]
        end = time.perf_counter() + _SPIN
        while time.perf_counter() < end:
            if ready.acquire(False):
                return
            os.sched_yield()  # to the awaited process, if it has no core of its own
        before = time.monotonic()
        while not ready.acquire(True, _POLL_PERIOD):
            now = time.monotonic()
            if self._children is not None:
                # Limited, since time in which this process was suspended does not count.
                self._children.check(process, min(now - before, 2.0 * _POLL_PERIOD))
            before = now
        if self._children is not None:
            self._children.end_silence()


class _Children:
    """The child processes of a run: all but the first process, which forks and watches them."""

    def __init__(self, count: int, timeout: float) -> None:
        self._count = count
        self._timeout = timeout
        self._silence = 0.0  # s for which the first process has waited for a process
        self._pids: dict[int, int] = {}
        self._errors: dict[int, int] = {}

    def fork(self, process: int, work: Callable[[], object]) -> None:
        """Fork a child that does `work`; an exception of `work` is sent to this process."""
        ours, theirs = os.pipe()
        parent = os.getpid()
        sys.stdout.flush()  # else both processes would print what waits
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
        self._pids[process] = pid
        self._errors[process] = ours

    def check(self, process: int, seconds: float) -> None:
        """Check the children while the first process waits for `process`.

        `seconds`: the waiting time since the last call. If a child has ended, raises the error that
        ended it, or SwarmError for a child without an error. SwarmError also if the first process
        has waited for `process` as long as the time-out.
        """
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

    def end_silence(self) -> None:
        """Begin to count anew: the awaited process has answered."""
        self._silence = 0.0

    def end(self) -> None:
        """Kill the children that still run."""
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
    """Whether a child has ended, and its exit code.

    The code is None while the child runs, and if a pattern ignores SIGCHLD or has taken the code.
    """
    try:
        ended, status = os.waitpid(pid, os.WNOHANG)
    except ChildProcessError:
        return True, None
    return ended != 0, os.waitstatus_to_exitcode(status) if ended else None


def _dumped(error: BaseException) -> bytes:
    """The pickled error for the first process; a SwarmError if the error cannot be pickled."""
    with suppress(Exception):
        data = pickle.dumps(error)
        pickle.loads(data)
        if isinstance(error, Exception) and len(data) <= _MAX_ERROR:
            return data
    return pickle.dumps(SwarmError(f"{type(error).__name__}: {error}"[:1000]))


def run_processes(work: Callable[[RunProcess], T], count: int, timeout: float = TIMEOUT) -> T:
    """Call `work` in `count` processes; return its result in the first process, which is this one.

    The other processes are forks of this process, and none is left at the end. Raises an error that
    `work` raises in any process. SwarmError with the number of a process that ended or made no
    progress for `timeout` s, and if /dev/shm cannot be written.
    """
    if count == 1:
        return work(RunProcess())
    context = get_context("fork")
    # Shared with the forks. Each process has a slot in each half (see `_exchange_bytes`).
    memory = mmap.mmap(-1, 2 * count * _SLOT)
    try:
        # By writer and reader of the data.
        ready = [[context.Semaphore(0) for _ in range(count)] for _ in range(count)]
    except OSError as error:  # sem_open(3) makes a file in /dev/shm, and the error does not name it
        text = f"/dev/shm: {error.strerror}; the {count} processes of a run keep semaphores there"
        raise SwarmError(f"{text}: mount it as tmpfs with some room, or take --cores 1") from error
    children = _Children(count, timeout)
    try:
        for index in range(1, count):
            # A child waits without a limit: the first process checks all children.
            child = _Member(index, memory, ready)
            children.fork(index, partial(work, child))
        return work(_Member(0, memory, ready, children))
    finally:
        children.end()

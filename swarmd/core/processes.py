"""Settings of the own process (Linux): end with the parent, limits, tracing, time slices."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4

OUT_OF_MEMORY = 77
"""Exit code of a pattern host that needs more memory than it may have."""
MAX_OUTPUT = 1 << 24
"""Bytes that code of others may print into a file."""
LOAD_GROWTH = 1 << 30
STEP_GROWTH = 1 << 28
"""Bytes by which a pattern host may grow while it loads a pattern, and after that."""


def die_with_parent(parent: int) -> None:
    """End this process at once when its parent ends, even by kill -9.

    `parent`: the id of the expected parent; if the parent has already ended, this process exits
    now. The kernel sends the signal when the *thread* that spawned this process ends, so the parent
    must spawn from a thread that stays. Without prctl(2), as on macOS, no signal is sent: the
    process notices the end of its parent by a pipe.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "prctl") and libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:
        sys.exit(0)


@contextmanager
def noted_signals(*numbers: int) -> Iterator[list[int]]:
    """Yield a list to which each of these signals is added; restores the handlers at the end."""
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in numbers
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def keep_from_tracing() -> None:
    """Deny other processes of this user to trace this process, or read its memory or environment.

    The process then writes no core dump. exec of another program undoes this protection.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_DUMPABLE)")


def how_it_ended(returncode: int | None) -> str:
    """The end of a process in words: `was killed by SIGKILL`, `ended with code 3`."""
    if returncode is None:
        return "ended"
    if returncode < 0:
        try:
            return f"was killed by {signal.Signals(-returncode).name}"
        except ValueError:
            return f"was killed by signal {-returncode}"
    return f"ended with code {returncode}"


def limit_growth(growth: int, pid: int | None = None) -> None:
    """Limit the address space of a process to its present size plus `growth` bytes.

    Beyond the limit the process gets a MemoryError. Without `pid` the call limits this process,
    which cannot raise its limit again. With `pid` the call limits another process of the same user,
    and a later call may change the limit. ProcessLookupError or FileNotFoundError if the other
    process has ended.
    """
    import resource  # not on Windows, where lockstep runs without workers

    with open(f"/proc/{pid or 'self'}/statm") as file:
        limit = growth + int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.prlimit(pid or 0, resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    pair = (limit, limit if pid is None else hard)
    resource.prlimit(pid or 0, resource.RLIMIT_AS, pair)


def limit_files(size: int = MAX_OUTPUT) -> None:
    """Limit each file that this process and its children write to `size` bytes, for ever.

    A write beyond the limit raises OSError, since Python ignores SIGXFSZ.
    """
    import resource  # not on Windows, as above

    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    limit = size if hard == resource.RLIM_INFINITY else min(size, hard)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


def keep_limits() -> None:
    """Fix all resource limits of this process except memory, which `limit_growth` sets."""
    import resource  # not on Windows, as above

    names = [name for name in dir(resource) if name.startswith("RLIMIT_")]
    for limit in {getattr(resource, name) for name in names} - {resource.RLIMIT_AS}:
        soft, _ = resource.getrlimit(limit)
        resource.setrlimit(limit, (soft, soft))


_SET_SCHEDULER = {"x86_64": 314, "aarch64": 274}  # sched_setattr(2), which libc does not offer
SHORT_SLICE = 100_000
"""The shortest slice that Linux grants, in ns."""


def ask_for_slices(slice: int | None) -> None:
    """Request scheduler time slices of `slice` ns; None: the default. Children inherit them.

    A process with short slices gets the processor sooner when it wakes, but no larger share. The
    daemon needs this: if each core has a computing process, the scheduler of Linux 6.6 and later
    otherwise delays the daemon by milliseconds before the daemon reads the answer to a step. A
    kernel before 6.12 ignores the request.
    """
    number = _SET_SCHEDULER.get(os.uname().machine)
    if number is not None and os.sched_getscheduler(0) == os.SCHED_OTHER:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, slice or 0, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)

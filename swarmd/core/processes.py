"""This process: its end with its parent, its memory, OpenSSL, slices of the processor (Linux)."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4

OUT_OF_MEMORY = 77
"""Exit code of a pattern host that needs more memory than it may have."""
LOAD_GROWTH, STEP_GROWTH = 1 << 30, 1 << 28
"""Bytes by which a pattern host may grow while it loads a pattern, and after that."""


def die_with_parent(parent: int) -> None:
    """End this process at once when its parent ends, even by kill -9.

    `parent` is the expected parent's id; if it has ended already, this process exits now. The
    kernel sends the signal when the *thread* that spawned this process ends, so spawn from a
    thread that stays. Without prctl(2), as on macOS, the process notices the end by its pipe.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "prctl") and libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:
        sys.exit(0)


def keep_from_tracing() -> None:
    """Deny processes of this user to trace this process, and to read its memory and environment.

    It leaves no core dump, either. A program that this process executes is open again.
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
    """Let a process grow by so many bytes from its present size; beyond it MemoryError.

    Without `pid` this process, for good: it cannot raise the limit again. With it the process `pid`
    of this user, whose limit may be changed again. ProcessLookupError or FileNotFoundError if that
    has ended.
    """
    import resource  # not on Windows, where lockstep runs without workers

    with open(f"/proc/{pid or 'self'}/statm") as file:
        limit = growth + int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.prlimit(pid or 0, resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    pair = (limit, limit if pid is None else hard)
    resource.prlimit(pid or 0, resource.RLIMIT_AS, pair)


def keep_limits() -> None:
    """Let this process raise no limit but that of memory, for which there is `limit_growth`."""
    import resource

    names = [name for name in dir(resource) if name.startswith("RLIMIT_")]
    for limit in {getattr(resource, name) for name in names} - {resource.RLIMIT_AS}:
        soft, _ = resource.getrlimit(limit)
        resource.setrlimit(limit, (soft, soft))


@contextmanager
def without_openssl() -> Iterator[None]:
    """Hide OpenSSL (4 MB) from imports within: asyncio, hashlib, hmac and secrets work without.

    Imports after the block find OpenSSL, such as `import ssl` where a robot has keys. A Python
    without hash functions of its own hides nothing.
    """
    has_own = any(map(find_spec, ("_sha2", "_sha256")))  # of Python 3.12 and later, of 3.11
    hidden = {"ssl", "_ssl", "_hashlib"} - sys.modules.keys() if has_own else set[str]()
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None: ImportError
    try:
        yield
    finally:
        for name in hidden:
            del sys.modules[name]


_SET_SCHEDULER = {"x86_64": 314, "aarch64": 274}  # sched_setattr(2), which libc does not offer
SHORT_SLICE = 100_000
"""The shortest slice that Linux grants, in ns."""


def ask_for_slices(slice: int | None) -> None:
    """Ask for slices of the processor of `slice` ns; None: usual ones. Children inherit them.

    A process with short slices gets the processor sooner when it wakes, and no larger share.
    Without short slices the scheduler of Linux 6.6 and later lets a daemon that has just sent a
    step wait for milliseconds until the daemon reads the answer, once each core has a process that
    computes. A kernel before 6.12 keeps its own slices.
    """
    number = _SET_SCHEDULER.get(os.uname().machine)
    if number is not None and os.sched_getscheduler(0) == os.SCHED_OTHER:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, slice or 0, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)

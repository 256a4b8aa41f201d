"""What processes of one user can do to each other, and what a process asks of the machine."""

from __future__ import annotations

import ctypes
import mmap
import os
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable

import pytest

from swarmd.core.processes import (
    SHORT_SLICE,
    ask_for_slices,
    keep_from_tracing,
    keep_limits,
    limit_growth,
)

pytestmark = pytest.mark.integration

NOBODY = 65534
PR_SET_DUMPABLE = 4


def as_nobody(act: Callable[[], None]) -> int:
    """A process without rights that carries `act` out; it exits with 1 if that raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which the child needs not
        child = os.fork()
    if child:
        return child
    code = 1
    try:
        if os.geteuid() == 0:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 1, 0, 0, 0)  # as after an exec
        act()
        code = 0
    finally:
        os._exit(code)


@pytest.mark.parametrize("is_kept", [False, True])
def test_another_process_of_the_user_reads_its_memory_unless_that_is_denied(is_kept: bool) -> None:
    ready, told = os.pipe()

    def wait() -> None:
        if is_kept:
            keep_from_tracing()
        os.write(told, b".")
        signal.pause()

    target = as_nobody(wait)
    try:
        assert os.read(ready, 1) == b"."

        def read() -> None:
            for name in ("mem", "environ"):
                with open(f"/proc/{target}/{name}", "rb"):
                    pass

        _, status = os.waitpid(as_nobody(read), 0)
        assert os.waitstatus_to_exitcode(status) == int(is_kept)
    finally:
        os.kill(target, signal.SIGKILL)
        os.waitpid(target, 0)
        os.close(ready)
        os.close(told)


def test_a_process_cannot_raise_the_limit_that_it_has_set_for_good() -> None:
    def grow() -> None:
        limit_growth(1 << 20)
        keep_limits()
        with pytest.raises(OSError, match="memory"):
            mmap.mmap(-1, 1 << 24)
        for limit in (resource.RLIMIT_AS, resource.RLIMIT_NOFILE):
            soft, _ = resource.getrlimit(limit)
            with pytest.raises(ValueError, match="limit"):
                resource.setrlimit(limit, (soft + 1, soft + 1))

    _, status = os.waitpid(as_nobody(grow), 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_short_slices_change_neither_priority_nor_policy() -> None:
    def ask() -> None:
        os.nice(3)
        before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
        ask_for_slices(SHORT_SLICE)
        ask_for_slices(None)
        assert (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)) == before

    _, status = os.waitpid(as_nobody(ask), 0)
    assert os.waitstatus_to_exitcode(status) == 0


@pytest.mark.parametrize(
    ("module", "is_loaded"), [("asyncio", False), ("hmac", False), ("ssl", True)]
)
def test_imports_without_openssl_find_it_later(module: str, is_loaded: bool) -> None:
    lines = (
        "from swarmd.core.openssl import without_openssl",
        "with without_openssl():",
        "    import asyncio, hmac, secrets",
        f"import {module}",
        "assert len(hmac.digest(b'key', b'text', 'sha256')) == 32",
        "print('libssl' in open('/proc/self/maps').read())",
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(is_loaded)

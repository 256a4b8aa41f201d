"""Runs tests on mutants, each in a fork of this process: `python -m studies.mutants.zygote TREE`.

TREE is a copy of the checkout, whose files are mutated. The process has imported the libraries that
tests need, and no module of the copy. A kernel that is changed runs interpreted, with those of its
library; the others run compiled. It reads a `Trial` as a line of JSON, and answers a `Result`.
"""

from __future__ import annotations

import importlib
import os
import resource
import signal
import sys
import time
import traceback
from contextlib import suppress
from importlib.util import cache_from_source
from pathlib import Path

import msgspec
from msgspec import Struct

_OURS = ("swarmd", "tests", "studies", "benchmarks")
_OPTIONS = (
    *("-x", "-q", "--no-header", "-p", "no:cacheprovider"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of libraries imported before the fork
)
_LANE = ("-m", "not integration and not long")
_PATIENCE = 20.0
"""Wall time of a trial to its limit of CPU time: the machine may be busy."""
_FAILED = 1  # exit code of pytest: a test failed


class Trial(Struct, frozen=True):
    """Tests to run on a changed file."""

    path: str
    """The file, relative to the copy."""
    source: str
    tests: tuple[str, ...]
    seconds: float
    """The CPU time after which the tests are ended."""
    is_control: bool = False
    """Whether the file has no mutant: all other files are compiled then."""


class Result(Struct, frozen=True):
    """What came."""

    outcome: str
    """`failed`, `passed`, `timeout`, or `error` if the tests could not be collected."""
    seconds: float
    """CPU time."""
    said: str
    """The last lines of pytest."""


def main(tree: Path) -> None:
    """Answer trials until the standard input ends."""
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    _import_libraries()
    for line in sys.stdin.buffer:
        result = carry_out(tree, msgspec.json.decode(line, type=Trial))
        sys.stdout.buffer.write(msgspec.json.encode(result) + b"\n")
        sys.stdout.buffer.flush()


def _import_libraries() -> None:
    """Import the libraries that tests import, and no module of the copy, which may be mutated."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read_end)
        for name in ("pytest", "tests.conftest", "tests.support.robot_harness", "hypothesis"):
            importlib.import_module(name)
        found = [name for name in sys.modules if name.partition(".")[0] not in _OURS]
        with os.fdopen(write_end, "w") as file:
            file.write("\n".join(found))
            file.flush()
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end) as file:
        names = file.read().split()
    os.waitpid(child, 0)
    for name in names:
        if name not in sys.modules:
            with suppress(ImportError):  # one that only its package imports
                importlib.import_module(name)


def carry_out(tree: Path, trial: Trial) -> Result:
    """Change the file, run the tests in a fork, and put the file back."""
    file = tree / trial.path
    before = file.read_bytes()
    file.write_text(trial.source)
    # Compiled once, without a mutant: the time stamp of a file tells seconds only.
    Path(cache_from_source(str(file))).unlink(missing_ok=True)
    try:
        return _run(tree, trial)
    finally:
        file.write_bytes(before)


def _run(tree: Path, trial: Trial) -> Result:
    log = tree.parent / f"{tree.name}.log"
    began = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = os.fork()
    if child == 0:
        _test(log, trial)
    deadline = time.monotonic() + _PATIENCE * trial.seconds
    is_late = False
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if not is_late and time.monotonic() > deadline:
            is_late = True
            os.kill(child, signal.SIGKILL)
        time.sleep(0.01)
    ended_at = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = ended_at.ru_utime + ended_at.ru_stime - began.ru_utime - began.ru_stime
    code = os.waitstatus_to_exitcode(status)
    said = " | ".join(log.read_text(errors="replace").strip().splitlines()[-2:])[-300:]
    if is_late or code in (-signal.SIGXCPU, -signal.SIGKILL):
        return Result("timeout", spent, said)
    if code == 0:
        return Result("passed", spent, said)
    return Result("failed" if code == _FAILED else "error", spent, said)


def _test(log: Path, trial: Trial) -> None:
    """Run pytest in this fork, and end it."""
    code = 70
    try:
        os.setpgid(0, 0)
        limit = int(trial.seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 2))
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for target, source in ((0, nothing), (1, output), (2, output)):
            os.dup2(source, target)
        sys.dont_write_bytecode = not trial.is_control
        import pytest

        code = int(pytest.main([*_OPTIONS, *_LANE, *trial.tests]))
    except BaseException:  # the fork must never go on in the loop of `main`
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Runs tests on mutants: `python -m studies.mutants.zygote TREE`.

TREE is a copy of the checkout. This process has imported the libraries that tests need, and no
module of the copy. It reads a `Trial` as a line of JSON, and answers a `Result`.

Most of a trial was the import of the code and the collection of its tests, so it is done once: a
*bench* is a fork that has collected the tests of several modules and has run them without a mutant.
For a mutant within functions the bench forks, gives these functions their changed code, and runs
the tests that call one of them, until one fails. The tests that killed most mutants of the module
run first, then the others of the same file by their CPU time. The bench has the kernels of the
mutated unit interpreted, and all others compiled.

A change beyond functions, such as of a constant, is put into the file, and a fork imports all anew:
so is one of a function that is called while modules are imported. CPython then interprets all
kernels of the library of a changed kernel.
"""

from __future__ import annotations

import gc
import importlib
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import cache_from_source
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, NamedTuple, NoReturn

import msgspec
from msgspec import Struct

from studies.mutants.changed_code import Place, changed_functions, functions_of, outermost

_OURS = ("swarmd", "tests", "studies", "benchmarks")
_OPTIONS = (
    *("-q", "--no-header", "--tb=native", "-p", "no:cacheprovider", "-o", "timeout=0"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of libraries imported before the fork
)
_LANE = ("-m", "not integration and not long")
_PATIENCE = 20.0
"""Wall time to the limit of CPU time: the machine may be busy."""
_LEAST = 2.0  # s of CPU time of a test
_SLOWER = 5.0  # times the CPU time without a mutant, after which a mutant hangs
_UNKNOWN = 30.0  # s of CPU time of a test that did not run without a mutant, and of an import
_MOST = 3600.0  # s of CPU time of a bench's tests without a mutant
UNCHANGED = "unchanged"
"""How a `Result` begins to say that a test fails without a mutant."""
_FAILED = 1
_ERROR = 70


class Trial(Struct, frozen=True):
    """Tests to run on a changed file."""

    path: str
    """The file, relative to the copy."""
    source: str
    tests: tuple[str, ...]
    """Files of tests that may kill it, those first that kill most."""
    bench: tuple[str, ...]
    """Files of tests that the bench has collected: those of all trials with these kernels."""
    changed: tuple[str, ...]
    """The files that these trials change."""
    interpreted: tuple[str, ...] = ()
    """Kernels that run interpreted, the changed one among them."""


class Result(Struct, frozen=True):
    """What came."""

    outcome: str
    """`failed`, `passed`, `timeout`, or `error` if the tests could not be collected."""
    seconds: float
    """CPU time."""
    said: str
    """The test that failed, and the last line of its error."""


class Control(Struct):
    """What the tests did without a mutant."""

    seconds: dict[str, float] = {}
    """The CPU time by the id of a test."""
    called: dict[str, list[tuple[str, str]]] = {}
    """By the id of a test: the outermost functions that it called, each with its file."""
    at_import: list[tuple[str, str]] = []
    """The functions that were called before the first test."""
    failed: str = ""
    spent: float = 0.0
    """The CPU time of the bench until here."""


class Serving(NamedTuple):
    """A bench: its process, what it reads and writes, and its tests without a mutant."""

    process: int
    requests: int
    answers: int
    control: Control


def main(tree: Path) -> None:
    """Answer trials until the standard input ends."""
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    _import_libraries()
    zygote = Zygote(tree)
    for line in sys.stdin.buffer:
        result = zygote.carry_out(msgspec.json.decode(line, type=Trial))
        sys.stdout.buffer.write(msgspec.json.encode(result) + b"\n")
        sys.stdout.buffer.flush()
    zygote.end_bench()


def _import_libraries() -> None:
    """Import the libraries that tests import, and no module of the copy, which may be mutated."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read_end)
        for name in ("pytest", "tests.conftest", "tests.support.robot_harness", "hypothesis"):
            with suppress(ImportError):  # a tree without tests of robots
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


class Zygote:
    """The process that has the libraries, and the bench of the latest trial."""

    def __init__(self, tree: Path) -> None:
        self._tree = tree
        self._bench: Serving | None = None
        self._bench_of: tuple[tuple[str, ...], tuple[str, ...]] | None = None
        # By path: the tests that killed mutants.
        self._killers: dict[str, Counter[str]] = {}

    def carry_out(self, trial: Trial) -> Result:
        """Run the tests on a mutant; the CPU time includes that of a new bench."""
        seconds = 0.0
        if self._bench_of != (trial.interpreted, trial.bench):
            self.end_bench()
            self._bench = _open_bench(self._tree, trial)
            self._bench_of = trial.interpreted, trial.bench
            seconds = self._bench.control.spent
        began = _spent()
        bench = self._bench
        assert bench is not None
        if bench.control.failed:
            return Result("error", seconds, f"{UNCHANGED}: {bench.control.failed}")
        names = self._changed(trial, bench.control)
        chosen = self._chosen(trial, names, bench.control)
        result = None
        if names is not None:
            result = _ask(bench, trial, chosen)
            seconds += result.seconds
        if result is None or result.outcome == "error":  # no such function is left in the bench
            result = self._with_file(trial, chosen)
        if result.outcome == "failed":
            killer = result.said.partition(" | ")[0]
            self._killers.setdefault(trial.path, Counter())[killer] += 1
        return msgspec.structs.replace(result, seconds=seconds + _spent() - began)

    def _changed(self, trial: Trial, control: Control) -> frozenset[str] | None:
        """The functions whose code a bench can change; None if more is to change."""
        file = self._tree / trial.path
        places = changed_functions(file.read_text(), trial.source, str(file))
        if places is None:
            return None
        names = frozenset(name for _, name, _ in places)
        is_late = any((trial.path, name) in control.at_import for name in names)
        return None if is_late else names

    def _chosen(
        self, trial: Trial, names: frozenset[str] | None, control: Control
    ) -> Sequence[str]:
        """The tests that can kill a mutant, those first that are likely to, and cheap."""
        can = set(control.seconds)
        if names is not None:
            wanted = {(trial.path, name) for name in names}
            can = {test for test in can if not wanted.isdisjoint(control.called[test])}
        killers = self._killers.get(trial.path, Counter())
        rank = {name: number for number, name in enumerate(trial.tests)}
        of_files = [test for test in can if test.partition("::")[0] in rank]
        return sorted(
            of_files,
            key=lambda test: (
                -killers[test],
                rank[test.partition("::")[0]],
                control.seconds[test],
            ),
        )

    def _with_file(self, trial: Trial, tests: Sequence[str]) -> Result:
        """Put the mutant into the file, run the tests in a fork, and put the file back."""
        assert self._bench is not None
        file = self._tree / trial.path
        before = file.read_bytes()
        file.write_text(trial.source)
        # Compiled once, without a mutant: the time stamp of a file tells seconds only.
        Path(cache_from_source(str(file))).unlink(missing_ok=True)
        seconds = self._bench.control.seconds
        limits = {test: _limit(seconds.get(test)) for test in tests}
        try:
            read_end, write_end = os.pipe()
            child = os.fork()
            if child == 0:
                os.close(read_end)
                sys.dont_write_bytecode = True
                files = dict.fromkeys(test.partition("::")[0] for test in tests)
                _run_pytest(tuple(files) or trial.tests, _Once(tests, limits, write_end))
            os.close(write_end)
            return _awaited(child, read_end, 2.0 * _UNKNOWN + sum(limits.values()))
        finally:
            file.write_bytes(before)

    def end_bench(self) -> None:
        """End the bench, if there is one."""
        if self._bench is not None:
            os.close(self._bench.requests)
            os.close(self._bench.answers)
            os.waitpid(self._bench.process, 0)
        self._bench = None
        self._bench_of = None


def _spent() -> float:
    """The CPU time in s of all children that have ended, and of this process."""
    return sum(os.times()[:4])


def _limit(seconds: float | None) -> float:
    """The CPU time in s after which a test hangs, by that without a mutant."""
    return _UNKNOWN if seconds is None else _LEAST + _SLOWER * seconds


# The bench.


class _Interpreted:
    """Finds the source of some kernels, before the finder of kernels finds their library."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: object = None
    ) -> ModuleSpec | None:
        """The spec of the source; None for any other module."""
        return PathFinder.find_spec(name, path) if name in self._names else None


def _open_bench(tree: Path, trial: Trial) -> Serving:
    """A fork that has collected the tests, and has run each of them once."""
    requests, to_bench = os.pipe()
    from_bench, answers = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(to_bench)
        os.close(from_bench)
        importlib.import_module("swarmd")  # it puts the finder of kernels first
        sys.meta_path.insert(0, _Interpreted(trial.interpreted))
        _run_pytest(trial.bench, _Serve(tree, trial.changed, requests, answers))
    os.close(requests)
    os.close(answers)
    line = _line(from_bench)
    control = msgspec.json.decode(line, type=Control) if line else Control()
    if not control.seconds and not control.failed:
        control.failed = "no test could be collected"
    return Serving(child, to_bench, from_bench, control)


class _Asked(Struct, frozen=True):
    """What a bench shall do."""

    path: str
    source: str
    tests: Sequence[str]


def _ask(bench: Serving, trial: Trial, tests: Sequence[str]) -> Result:
    """What comes of the tests in a fork of the bench."""
    asked = _Asked(trial.path, trial.source, tests)
    with os.fdopen(os.dup(bench.requests), "wb") as file:
        file.write(msgspec.json.encode(asked) + b"\n")
    return msgspec.json.decode(_line(bench.answers), type=Result)


def _line(descriptor: int) -> bytes:
    with os.fdopen(os.dup(descriptor), "rb", buffering=0) as file:
        return file.readline()


class _Plugin:
    """What both plugins do: Hypothesis does not look for shorter examples, which takes long."""

    def pytest_configure(self) -> None:
        """Take effect before test modules are imported, and after tests/conftest.py is."""
        from hypothesis import HealthCheck, Phase, settings

        changed = settings(
            phases=(Phase.explicit, Phase.generate),
            suppress_health_check=[*HealthCheck],  # a bench that traces calls is slow
        )
        settings.register_profile("mutants", changed)
        settings.load_profile("mutants")


class _Once(_Plugin):
    """Runs some of the collected tests in a given order, until one fails."""

    def __init__(self, tests: Sequence[str], limits: Mapping[str, float], said: int) -> None:
        self._order = {test: number for number, test in enumerate(tests)}
        self._limits = limits
        self._said = said
        _limit_cpu(2.0 * _UNKNOWN)

    def pytest_runtestloop(self, session: Any) -> bool:
        """Run them; pytest's own loop does not run."""
        if session.testsfailed:  # a file could not be imported
            os._exit(_ERROR)
        chosen = [item for item in session.items if item.nodeid in self._order]
        _run_items(sorted(chosen, key=lambda item: self._order[item.nodeid]), self._limits)
        os._exit(0)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """End at the first failure."""
        _end_if_failed(report, self._said)


class _Serve(_Plugin):
    """Collects tests, runs them once without a mutant, and then runs some for each mutant."""

    def __init__(self, tree: Path, files: Sequence[str], requests: int, answers: int) -> None:
        self._tree = str(tree)
        self._files = {str(tree / file): file for file in files}
        self._requests = requests
        self._answers = answers
        self._said = -1
        # By the identity of a code object, as its hash is expensive.
        self._called: dict[int, CodeType] = {}
        self._functions: Mapping[Place, Sequence[FunctionType]] = {}
        threading.settrace(self._note)
        sys.settrace(self._note)

    def _note(self, frame: FrameType, event: str, argument: object) -> None:
        """Note the code of a new frame, and trace nothing else of it."""
        self._called[id(frame.f_code)] = frame.f_code

    def pytest_runtestloop(self, session: Any) -> bool:
        """Serve; pytest's own loop does not run."""
        at_import = [*self._called_functions()]
        if session.testsfailed:
            os._exit(_ERROR)
        read_end, write_end = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read_end)
            self._control(session, at_import, write_end)
        os.close(write_end)
        sys.settrace(None)
        threading.settrace(None)
        with os.fdopen(read_end, "rb") as file:
            told = file.read()
        os.waitpid(child, 0)
        control = msgspec.json.decode(told, type=Control) if told else Control(failed="?")
        control.spent = _spent()
        known = control.seconds if not control.failed else {}
        with os.fdopen(self._answers, "wb") as answers:
            answers.write(msgspec.json.encode(control) + b"\n")
            answers.flush()
            self._functions = functions_of([*self._files])
            gc.freeze()  # a fork would copy each page that a collection of garbage visits
            if known:
                items = {item.nodeid: item for item in session.items}
                with os.fdopen(self._requests, "rb") as requests:
                    for line in requests:
                        asked = msgspec.json.decode(line, type=_Asked)
                        result = self._carry_out(asked, items, known)
                        answers.write(msgspec.json.encode(result) + b"\n")
                        answers.flush()
        os._exit(0)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """End a mutant's fork at the first failure."""
        if self._said >= 0:
            _end_if_failed(report, self._said)

    def _called_functions(self) -> Iterator[tuple[str, str]]:
        """The outermost functions of the mutated files that were called since."""
        called = self._called
        self._called = {}  # what runs from here on is noted there
        found = set()
        for code in called.values():
            file = self._files.get(_real_path(code.co_filename))
            if file is not None:
                found.add((file, outermost(code.co_qualname)))
        return iter(sorted(found))

    def _control(self, session: Any, at_import: list[tuple[str, str]], to: int) -> NoReturn:
        """Run all tests, and tell what each of them called."""
        control = Control(at_import=at_import)
        items = session.items
        _limit_cpu(_MOST)
        for number, item in enumerate(items):
            following = items[number + 1] if number + 1 < len(items) else None
            began = time.process_time()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                control.failed = item.nodeid
                break
            control.seconds[item.nodeid] = time.process_time() - began
            control.called[item.nodeid] = [*self._called_functions()]
        with os.fdopen(to, "wb") as file:
            file.write(msgspec.json.encode(control))
        os._exit(0)

    def _carry_out(
        self, asked: _Asked, items: Mapping[str, Any], known: Mapping[str, float]
    ) -> Result:
        """Run tests on a mutant in a fork."""
        file = f"{self._tree}/{asked.path}"
        places = changed_functions(Path(file).read_text(), asked.source, file) or {}
        if not places or not places.keys() <= self._functions.keys():
            return Result("error", 0.0, "")
        changes = [
            (function, code)
            for place, code in places.items()
            for function in self._functions[place]
        ]
        read_end, write_end = os.pipe()
        limits = {test: _limit(known[test]) for test in asked.tests}
        child = os.fork()
        if child == 0:
            os.close(read_end)
            self._said = write_end
            _limit_cpu(_UNKNOWN)
            for function, code in changes:
                function.__code__ = code
            _run_items([items[test] for test in asked.tests], limits)
            os._exit(0)
        os.close(write_end)
        return _awaited(child, read_end, _UNKNOWN + sum(limits.values()))


@cache
def _real_path(file: str) -> str:
    return os.path.realpath(file)


def _run_pytest(tests: Sequence[str], plugin: _Plugin) -> NoReturn:
    """Run pytest in this fork, and end it."""
    code = _ERROR
    try:
        os.setpgid(0, 0)
        nothing = os.open(os.devnull, os.O_RDONLY)
        log = os.open(f"{os.getcwd()}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for target, source in ((0, nothing), (1, log), (2, log)):
            os.dup2(source, target)
        import pytest

        code = int(pytest.main([*_OPTIONS, *_LANE, *tests], plugins=[plugin]))
        code = code or _ERROR  # the plugin ends it otherwise
    except BaseException:  # the fork must never go on in the loop of `main`
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _run_items(items: Sequence[Any], limits: Mapping[str, float]) -> None:
    """Run collected tests, each with its limit of CPU time."""
    for number, item in enumerate(items):
        following = items[number + 1] if number + 1 < len(items) else None
        _limit_cpu(limits[item.nodeid])
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


def _limit_cpu(seconds: float) -> None:
    """End this process after so much more CPU time, rounded up."""
    soft = int(time.process_time() + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))


def _end_if_failed(report: Any, said: int) -> None:
    if report.failed:
        crash = getattr(report.longrepr, "reprcrash", None)
        message = str(getattr(crash, "message", "")).partition("\n")[0]
        os.write(said, f"{report.nodeid} | {message}"[:300].encode())
        os._exit(_FAILED)


def _awaited(child: int, said_by: int, seconds: float) -> Result:
    """What came of a fork; it is ended after a multiple of these `seconds` of CPU time."""
    deadline = time.monotonic() + _PATIENCE * seconds
    is_late = False
    while True:
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            break
        if not is_late and time.monotonic() > deadline:
            is_late = True
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)
    with os.fdopen(said_by, "rb") as file:
        said = file.read().decode(errors="replace")
    spent = usage.ru_utime + usage.ru_stime
    code = os.waitstatus_to_exitcode(status)
    if is_late or code in (-signal.SIGXCPU, -signal.SIGKILL):
        return Result("timeout", spent, said)
    if code == 0:
        return Result("passed", spent, said)
    return Result("failed" if code == _FAILED else "error", spent, said)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())

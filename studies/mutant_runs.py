"""Runs the tests of mutants, each in a fork of one process that has collected all tests once.

1. The tests of FOLDERS are collected, interpreted. As a control, forks run each test once on the
   code as it is, and write down which functions of DECIDES it calls and how long it takes. Tests
   that fail there are left out.
2. A mutant of a function: a fork compiles the changed file, replaces the code of the function in
   place, and runs the tests that call it until one fails: first those that are named as the file,
   then the cheapest ones, up to a bound of their CPU time. The test that failed is run once in
   another fork, without the mutant: if it fails there, too, it is left out, and the mutant is
   judged again.
3. What runs at import cannot be replaced in place: tables, constants, defaults of arguments. Such a
   mutant, and one of a function that is also called at import and that survived, is judged in a
   process of its own (`python -m studies.mutant_runs`), which imports the changed file.

A test that takes much longer than without the mutant, or waits for ever, counts as failed.
"""

from __future__ import annotations

import ast
import cProfile
import gc
import hashlib
import importlib.machinery
import json
import os
import resource
import select
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import chain
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, NoReturn, TextIO

import pytest
from _pytest.runner import runtestprotocol

from studies.mutants import ROOT, Mutant, files, mutated

BUILD = ROOT / "build" / "mutants"
LIMITS = "tests/docs/test_safety_limits.py"
"""Compares limits of the page with the code."""
FOLDERS = (
    "tests/protection",
    "tests/robot",
    "tests/steering",
    "tests/sensing",
    "tests/core",
    "tests/driver_api",
    "tests/daemon",
    "tests/network",
    "tests/client",
    "tests/histories",
    "tests/sequences",
    "tests/drivers",
    LIMITS,
)
WITHOUT = "not integration and not evidence and not compiled_only"
ARGUMENTS = [
    "-p", "no:cacheprovider",
    "-p", "no:terminal",
    "--capture=sys",
    "--hypothesis-profile=mutants",
    "-m", WITHOUT,
]  # fmt: skip
STARTS = {"roscore"}
"""Fixtures that start processes, although their tests are not marked `integration`."""
NEAR = {
    "swarmd/protection": ("tests/protection", "tests/robot"),
    "swarmd/robot": ("tests/robot", "tests/sequences", "tests/histories"),
    "swarmd/steering": ("tests/steering", "tests/robot"),
    "swarmd/sensing": ("tests/sensing", "tests/robot"),
    "swarmd/core": ("tests/core", "tests/robot", "tests/sequences"),
    "swarmd/driver_api": ("tests/driver_api", "tests/sequences", "tests/drivers"),
    "swarmd/daemon": ("tests/daemon", "tests/sequences"),
    "swarmd/network": ("tests/network", "tests/histories", "tests/sequences"),
    "swarmd/client": ("tests/client", "tests/histories", "tests/sequences"),
    "drivers": ("tests/drivers", "tests/sequences"),
}
"""By the folder of a file, the tests that judge commits, and what runs at the file's import."""
LIMIT = 10.0, 20.0
"""s of CPU, and multiple of what a test takes in the control, after which it counts as failed."""
SILENCE = 120
"""s in which a test neither ends nor computes, after which it counts as failed."""
MEMORY = 6 << 30
"""bytes of memory that a fork may use."""


@dataclass(frozen=True)
class Control:
    """What the tests do on the code as it is."""

    seconds: dict[str, float]  # by test that passes: CPU time, and half of what it slept
    calls: dict[str, list[str]]  # by function of DECIDES, the tests that call it
    failed: list[str]


@dataclass(frozen=True)
class Verdict:
    """How a mutant fared. `test` is the test that noticed it; `how` says in which way."""

    path: str
    number: int
    text: str
    survived: bool
    how: str
    test: str = ""
    cpu: float = 0.0
    most: float = 0.0  # s of CPU, by the control, of the tests that were run at most


class Work:
    """A plugin of pytest: all tests are collected, and `do` replaces their run."""

    def __init__(self, do: Callable[[pytest.Session], None]) -> None:
        self.do = do

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.do(session)
        return True


def near(path: str) -> tuple[str, ...]:
    """The folders of the tests of a file."""
    found = next(tests for folder, tests in NEAR.items() if path.startswith(f"{folder}/"))
    return (*found, LIMITS)


@cache
def path_of(file: str) -> str:
    """The path of a file in the repository; empty for other files."""
    real = Path(os.path.realpath(file))
    return real.relative_to(ROOT).as_posix() if real.is_relative_to(ROOT) else ""


def name_of(code: CodeType) -> str:
    """How a function is named here: path, line and qualified name."""
    return f"{path_of(code.co_filename)}:{code.co_firstlineno} {code.co_qualname}"


def digest(folders: Sequence[str]) -> str:
    """The digest of the files of DECIDES, of all tests, and of the version of Python."""
    found = hashlib.sha256(f"{sys.version} {' '.join(folders)}".encode())
    for path in [*(ROOT / one for one in files()), *sorted((ROOT / "tests").rglob("*.py"))]:
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


def judge_all(
    mutants: Sequence[Mutant],
    *,
    jobs: int,
    most: float = 20.0,
    folders: Sequence[str] = FOLDERS,
    build: Path = BUILD,
) -> list[Verdict]:
    """The verdicts on the mutants, in their order, by the tests of some folders and files.

    `most`: the s of CPU, by the control, of the tests that judge one mutant. Prints a line for each
    verdict that is not yet kept in the folder `build`. A mutant that survived a smaller `most` is
    judged again.
    """
    build.mkdir(parents=True, exist_ok=True)
    kept = build / f"{digest(folders)}.jsonl"
    lines = kept.read_text().splitlines() if kept.exists() else []
    known = {(one.path, one.number): one for one in (Verdict(**json.loads(x)) for x in lines)}
    missing = [
        one
        for one in mutants
        if (found := known.get((one.path, one.number))) is None
        or (found.survived and found.how != NO_TEST and found.most < most)
    ]
    if missing:
        output = os.fdopen(os.dup(1), "w", buffering=1)
        profile = cProfile.Profile(subcalls=False, builtins=False)

        def work(session: pytest.Session) -> None:
            profile.disable()
            if session.testsfailed:
                raise pytest.UsageError("some tests cannot be collected; try pytest --collect-only")
            judge = Judge(
                session,
                at_import={name_of(one) for one in codes(profile)},
                kept=build / f"{digest(())}.control",  # shared by all choices of tests
                folders=folders,
                jobs=jobs,
                most=most,
                output=output,
            )
            with kept.open("a") as file:
                for verdict in judge.verdicts(missing):
                    known[verdict.path, verdict.number] = verdict
                    print(json.dumps(asdict(verdict)), file=file, flush=True)
                    mark = "SURVIVED" if verdict.survived else "killed  "
                    print(f"{mark}  {verdict.text} ({verdict.how})", file=output)

        os.environ["SWARMD_COMPILED"] = "0"
        profile.enable()
        status = pytest.main([*ARGUMENTS, *folders], plugins=[Work(work)])
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            sys.exit(f"the tests were not run: {status!r}")
    return [known[one.path, one.number] for one in mutants]


DECIDING = frozenset(files())


def codes(profile: cProfile.Profile) -> set[CodeType]:
    """The functions of DECIDES that a profile has seen."""
    seen = (entry.code for entry in profile.getstats())
    return {
        one for one in seen if isinstance(one, CodeType) and path_of(one.co_filename) in DECIDING
    }


class Child:
    """A fork, and what it wrote so far."""

    def __init__(self, work: Callable[[int], None]) -> None:
        """Fork; `work` gets the file descriptor to which it writes lines, the last of them JSON."""
        self.read, write = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            status = 1
            try:
                os.close(self.read)
                hushed = os.open(os.devnull, os.O_RDWR)
                for number in (0, 1, 2):
                    os.dup2(hushed, number)
                work(write)
                status = 0
            except BaseException:
                tell(write, error=traceback.format_exc())
            finally:
                os._exit(status)
        os.close(write)
        self.text = ""
        self.silent = 0.0  # s without news or computation
        self.computed = 0  # ticks of CPU time when it was last looked at
        self.is_stalled = False
        self.cpu = 0.0
        self.signal = 0

    def wait(self, seconds: float) -> bool:
        """Wait for news that long; whether it has ended."""
        ready, _, _ = select.select([self.read], [], [], seconds)
        if ready:
            if data := os.read(self.read, 65536):
                self.text += data.decode()
                self.silent = 0.0
                return False
            os.close(self.read)
            _, status, used = os.wait4(self.pid, 0)
            self.cpu = used.ru_utime + used.ru_stime
            self.signal = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
            return True
        return False

    def end_if_silent(self, seconds: float) -> None:
        """Note that there were no news for so long; end the process if it waits for ever."""
        self.silent += seconds
        if self.silent > SILENCE and not self.is_stalled:
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
            computed = int(fields[11]) + int(fields[12])
            self.silent = 0.0
            self.is_stalled = computed == self.computed
            self.computed = computed
            if self.is_stalled:
                os.kill(self.pid, signal.SIGKILL)


def run(item: pytest.Item) -> str:
    """Run one test with all its fixtures; why it failed, empty if it passed or was skipped."""
    try:
        reports = runtestprotocol(item, log=False, nextitem=None)
    except KeyboardInterrupt:
        os._exit(130)
    except BaseException as error:
        return repr(error) or "an error"
    return "".join(str(report.longrepr) or "failed" for report in reports if report.failed)


def idle() -> float:
    """s that this process has neither computed nor waited for a processor since some instant."""
    computed, queued = map(int, Path("/proc/self/schedstat").read_text().split()[:2])
    return time.monotonic() - (computed + queued) / 1e9


def caches() -> list[Any]:
    """The functions of DECIDES that functools.cache has wrapped."""
    wrapper = type(path_of)
    found = [one for one in gc.get_objects() if type(one) is wrapper]
    return [one for one in found if path_of(one.__wrapped__.__code__.co_filename) in DECIDING]


class Judge:
    """Runs tests on mutants in forks of this process."""

    def __init__(
        self,
        session: pytest.Session,
        *,
        at_import: set[str],
        kept: Path,
        folders: Sequence[str],
        jobs: int,
        most: float,
        output: TextIO,
    ) -> None:
        """Run the control, unless the file `kept` has it."""
        chosen = (one for one in session.items if not STARTS & {*getattr(one, "fixturenames", ())})
        self.items = {item.nodeid: item for item in chosen}
        self.kept = kept
        self.folders = folders
        self.jobs = jobs
        self.most = most
        self.output = output
        gc.unfreeze()  # tests/conftest.py has frozen what the collection made
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of garbage of the collection, in the first test
            gc.collect()
        self.live: dict[str, list[FunctionType]] = {}
        for one in gc.get_objects():
            if type(one) is FunctionType and path_of(one.__code__.co_filename) in DECIDING:
                self.live.setdefault(path_of(one.__code__.co_filename), []).append(one)
        self.caches = caches()
        gc.freeze()
        self.at_import = at_import
        self.control = self.controlled()
        seconds = [self.control.seconds.get(one, 0.0) for one in self.items]
        failed = self.items.keys() & {*self.control.failed}
        print(
            f"{len(self.items)} tests of {sum(seconds):.0f} s of CPU; left out, since they fail in"
            f" a fork: {len(failed)} {sorted(failed)}",
            file=output,
        )
        self.passes_alone: dict[str, bool] = {}

    # --- the code as it is

    def controlled(self) -> Control:
        """What all tests do on the code as it is; goes on where it was ended."""
        lines = self.kept.read_text().splitlines() if self.kept.exists() else []
        known = {json.loads(line)[0] for line in lines}
        missing = [item for name, item in self.items.items() if name not in known]
        parts = [part for n in range(self.jobs) if (part := missing[n :: self.jobs])]
        running = {one.read: one for one in (Child(partial(self.observe, part)) for part in parts)}
        with self.kept.open("a") as file:
            while running:
                ready, _, _ = select.select([*running], [], [])
                for number in ready:
                    child = running[number]
                    if child.wait(0.0):
                        del running[number]
                    whole, _, child.text = child.text.rpartition("\n")
                    if '{"error"' in whole:
                        raise RuntimeError(f"the control of the tests ended: {whole[-500:]}")
                    file.write(f"{whole}\n" if whole else "")
                    file.flush()
        if missing:
            lost = self.items.keys() - {
                json.loads(line)[0] for line in self.kept.read_text().splitlines()
            }
            with self.kept.open("a") as file:
                for name in sorted(lost):
                    print(json.dumps([name, "its process ended", 0.0, []]), file=file)
        return read_control(self.kept)

    def observe(self, items: Sequence[pytest.Item], output: int) -> None:
        """Run tests and write a line for each: name, why it failed, CPU time, functions."""
        names: dict[CodeType, str] = {}
        for item in items:
            for one in self.caches:
                one.cache_clear()
            in_threads: set[CodeType] = set()
            threading.setprofile(partial(note_call, in_threads))
            profile = cProfile.Profile(subcalls=False, builtins=False)
            began, slept = time.process_time(), idle()
            profile.enable()
            why = run(item)
            profile.disable()
            taken = time.process_time() - began + (idle() - slept) / 2
            threading.setprofile(None)
            called = codes(profile)
            called |= {one for one in [*in_threads] if path_of(one.co_filename) in DECIDING}
            for one in called:
                names.setdefault(one, name_of(one))
            line = [item.nodeid, why, taken, sorted(names[one] for one in called)]
            data = (json.dumps(line) + "\n").encode()
            while data:
                data = data[os.write(output, data) :]

    # --- mutants

    def verdicts(self, mutants: Sequence[Mutant]) -> Iterator[Verdict]:
        waiting = [*reversed(mutants)]
        running: dict[int, tuple[Mutant, Child]] = {}
        while waiting or running:
            while waiting and len(running) < self.jobs:
                mutant = waiting.pop()
                child = Child(partial(self.judge, mutant))
                running[child.read] = mutant, child
            began = time.monotonic()
            ready, _, _ = select.select([*running], [], [], 1.0)
            waited = min(time.monotonic() - began, 1.0)  # less if this process was stopped
            for number, (mutant, child) in [*running.items()]:
                if number not in ready:
                    child.end_if_silent(waited)
                elif child.wait(0.0):
                    del running[number]
                    verdict = self.verdict(mutant, child)
                    if verdict.survived or self.is_sound(verdict):
                        yield verdict
                    else:
                        self.control.seconds.pop(verdict.test, None)  # another mutant may have
                        waiting.append(mutant)

    def is_sound(self, verdict: Verdict) -> bool:
        """Whether the test that noticed the mutant passes without it, in a fork, too."""
        if verdict.how != "failed":
            return True
        if verdict.test not in self.passes_alone:
            test = verdict.test
            child = Child(lambda output: tell(output, why=run(self.items[test])))
            while not child.wait(1.0):
                pass
            why = json.loads(child.text or "{}").get("why", "its process ended")
            self.passes_alone[test] = not why
            if why:
                print(f"left out, since it fails alone: {test}: {why[-500:]}", file=self.output)
        return self.passes_alone[verdict.test]

    def tests_of(self, mutant: Mutant, names: Iterable[str]) -> list[str]:
        """The tests that call functions, in their order."""
        seconds = self.control.seconds
        found = {test for name in names for test in self.control.calls.get(name, ())}
        known = found & self.items.keys() & seconds.keys()
        return ordered(known, mutant.path, self.control, self.most)

    def judge(self, mutant: Mutant, output: int) -> None:
        """In a fork: write the text of the mutant, the test that runs, and the verdict."""
        tree, text = mutated(mutant)
        tell(output, text=text)
        names = self.replace(mutant.path, tree)
        if names is None:
            alone(mutant, self.kept, self.folders, self.most, output)
        tests = self.tests_of(mutant, names)
        how = run_until_failure(tests, self.items, self.control.seconds, output)
        if how.startswith("passes") and {*names} & self.at_import:
            alone(mutant, self.kept, self.folders, self.most, output)
        tell(output, how=how if tests else NO_TEST)

    def replace(self, path: str, tree: ast.Module) -> list[str] | None:
        """Replace the code of functions by that of a changed file; None if that is not enough.

        The names of the innermost functions that differ.
        """
        live = self.live.get(path, [])
        file = str(ROOT / path)
        source = (ROOT / path).read_text()
        old = compile(source, file, "exec", dont_inherit=True)
        new = compile(tree, file, "exec", dont_inherit=True)
        pairs = [*zip(walk(old), walk(new), strict=False)]
        if [one.co_qualname for one in walk(old)] != [one.co_qualname for one in walk(new)]:
            return None
        changed = {before: after for before, after in pairs if before != after}
        inner = [one for one in changed if not {*parts(one)} & changed.keys()]
        if any(not one.co_flags & OPTIMIZED for one in inner):  # a module or a class
            return None
        found = [one for one in live if one.__code__ in changed]
        for function in found:
            function.__code__ = changed[function.__code__]
        return [name_of(one) for one in inner] if found else None

    def verdict(self, mutant: Mutant, child: Child) -> Verdict:
        news: dict[str, str] = {}
        for line in child.text.splitlines():
            news |= json.loads(line)
        how = news.get("how", "")
        if "error" in news or not (how or child.signal or "test" in news):
            raise RuntimeError(f"{mutant} was not judged: {news.get('error')}")
        if child.is_stalled:
            how = "a test waits for ever"
        elif child.signal in (signal.SIGPROF, signal.SIGXCPU):
            how = "a test takes too long"
        elif not how:
            how = f"the process of the tests ended ({child.signal})"
        survived = how == NO_TEST or how.startswith("passes")
        return Verdict(
            mutant.path,
            mutant.number,
            news.get("text", ""),
            survived,
            how,
            "" if survived else news.get("test", ""),
            round(child.cpu, 2),
            self.most,
        )


def read_control(path: Path) -> Control:
    """The control that a file has."""
    seconds: dict[str, float] = {}
    calls: dict[str, list[str]] = {}
    failed: list[str] = []
    for line in path.read_text().splitlines():
        test, why, taken, called = json.loads(line)
        if why:
            failed.append(test)
        else:
            seconds[test] = taken
            for name in called:
                calls.setdefault(name, []).append(test)
    return Control(seconds, calls, failed)


NO_TEST = "no test calls it"
OPTIMIZED = 1
"""The flag of the code of functions (inspect.CO_OPTIMIZED); modules and classes have it not."""


def note_call(seen: set[CodeType], frame: FrameType, event: str, _argument: object) -> None:
    """The profile of threads."""
    if event == "call":
        seen.add(frame.f_code)


def parts(code: CodeType) -> Iterator[CodeType]:
    """The functions and classes directly in a code object."""
    return (one for one in code.co_consts if isinstance(one, CodeType))


def walk(code: CodeType) -> Iterator[CodeType]:
    """A code object and all in it."""
    yield code
    for one in parts(code):
        yield from walk(one)


def tell(output: int, **news: str) -> None:
    os.write(output, (json.dumps(news) + "\n").encode())


def ordered(tests: Iterable[str], path: str, control: Control, most: float) -> list[str]:
    """Tests of a file in the order in which they run, up to `most` s of CPU.

    First those that are named as the file, then those that call it, the cheapest ones first.
    """
    own, seconds = f"test_{Path(path).stem}.py", control.seconds
    calling = (found for name, found in control.calls.items() if name.startswith(f"{path}:"))
    callers = {*chain.from_iterable(calling)}
    found = sorted(
        tests,
        key=lambda one: (own not in one, one not in callers, seconds[one], one),
    )
    spent = 0.0
    for count, test in enumerate(found):
        spent += seconds[test]
        if spent > most:
            return found[: count + 1]
    return found


def run_until_failure(
    tests: Sequence[str], items: dict[str, pytest.Item], seconds: dict[str, float], output: int
) -> str:
    """`failed`, or how many passed; SIGPROF ends the process if a test takes too long."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    for test in tests:
        tell(output, test=test)
        signal.setitimer(signal.ITIMER_PROF, LIMIT[0] + LIMIT[1] * seconds[test])
        if run(items[test]):
            return "failed"
    return f"passes {len(tests)} tests"


# --- a process of its own


def alone(mutant: Mutant, kept: Path, folders: Sequence[str], most: float, output: int) -> NoReturn:
    """Go on as a process that imports the changed file, and runs the tests of NEAR."""
    chosen = [one for one in near(mutant.path) if one in folders] or folders
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    os.set_inheritable(output, True)
    command = [sys.executable, "-m", "studies.mutant_runs"]
    command += [mutant.path, str(mutant.number), str(kept), str(most), str(output), *chosen]
    os.chdir(ROOT)
    os.execv(sys.executable, command)


def main() -> None:
    """Judge one mutant, as `alone` asks."""
    path, number, kept, most, output, *folders = sys.argv[1:]
    judge_imported(Mutant(path, int(number)), Path(kept), folders, float(most), int(output))


def judge_imported(
    mutant: Mutant, kept: Path, folders: Sequence[str], most: float, output: int
) -> NoReturn:
    """Import the changed file, run tests of some folders, and write the verdict."""
    os.set_inheritable(output, False)
    tree, _ = mutated(mutant)
    usual = importlib.machinery.SourceFileLoader.get_code

    def get_code(self: Any, name: str) -> CodeType | None:
        file = self.get_filename(name)
        if path_of(file) == mutant.path:
            return compile(tree, file, "exec", dont_inherit=True)
        return usual(self, name)

    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[assignment,method-assign]
    control = read_control(kept)
    how = ["an import fails"]

    def work(session: pytest.Session) -> None:
        if not session.testsfailed:
            items = {item.nodeid: item for item in session.items}
            tests = ordered(items.keys() & control.seconds.keys(), mutant.path, control, most)
            how[0] = run_until_failure(tests, items, control.seconds, output)

    pytest.main([*ARGUMENTS, *folders], plugins=[Work(work)])
    tell(output, how=how[0])
    os._exit(0)


if __name__ == "__main__":
    main()

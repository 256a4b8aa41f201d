"""What tests of several folders need: profiles, marks, CPU times, loops and a browser."""

from __future__ import annotations

import asyncio
import faulthandler
import gc
import inspect
import json
import os
import signal
import subprocess
from collections import Counter
from collections.abc import Generator, Iterator
from multiprocessing import forkserver
from pathlib import Path, PurePath
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage

import pytest
from hypothesis import settings
from xdist.workermanage import WorkerController

from swarmd.core.clock import boottime
from swarmd.core.kernels import describe_kernels
from swarmd.sim.experiments.run_store import OFF, VARIABLE
from swarmd.sim.live import fleet
from swarmd.testing.pattern_contract import PatternContract
from tests.support.chromium import FOUND, Browser, Page, chromium
from tests.support.examples import FULL
from tests.support.forked_python import ForkedPython, forked_python
from tests.support.pages import SUMMARY
from tests.support.read_when_run import (
    PROCESS_FIXTURES,
    EndOfFile,
    Progress,
    ReadWhenRun,
    is_told,
    is_wanted,
)
from tests.support.scheduling import NICENESS, MixedScheduling, computes, order
from tests.support.stalls import Stalls
from tests.support.started import STARTED

# A machine may be busy: how long an example takes is no property. A property test draws an eighth
# of its examples in `make test`, the same ones for everybody, and all of them in `make evidence`,
# other ones each time. What these find becomes an `@example` of the test.
settings.register_profile(
    "test", deadline=None, max_examples=FULL // 8, derandomize=True, database=None
)
settings.register_profile("evidence", deadline=None, max_examples=FULL)
# The second pass over the same code, with interpreted kernels (tests/core/test_kernel_forms.py).
settings.register_profile(
    "interpreted", deadline=None, max_examples=FULL // 25, derandomize=True, database=None
)
settings.load_profile("test")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object | None:
    """Deal out files that wait beside files that compute, for `--dist loadfile`."""
    return MixedScheduling(config, log) if config.option.dist == "loadfile" else None


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: WorkerController) -> None:
    """Tell a worker that computes its priority, and each one whether it collects all tests."""
    node.workerinput["reads_when_run"] = is_wanted(node.config)
    is_mixed = node.config.option.dist == "loadfile"
    if is_mixed and computes(node.gateway.id, node.workerinput["workercount"]):
        node.workerinput["niceness"] = NICENESS


OF_A_SHELL = ("SWARM", "SWARM_CONFIG", "SWARM_CONTEXT", "SWARM_PLUGIN_DIR")
"""What a user who works with a swarm may have set; tests name their own swarms."""


def pytest_configure(config: pytest.Config) -> None:
    """Give processes that tests start the usual signals: a shell's background jobs ignore some."""
    if niceness := getattr(config, "workerinput", {}).get("niceness"):
        os.nice(niceness)
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        if signal.getsignal(number) is signal.SIG_IGN:
            usual = signal.default_int_handler if number is signal.SIGINT else signal.SIG_DFL
            signal.signal(number, usual)
    for name in OF_A_SHELL:
        os.environ.pop(name, None)
    os.environ[VARIABLE] = OFF  # a test does what it tests; those of the store name a folder
    # Not for a pytest that a test starts.
    config.stash[COUNTS] = os.environ.pop("LANE_COUNTS", "")
    worker = getattr(config, "workerinput", {}).get("workerid", "")
    if getattr(config, "workerinput", {}).get("reads_when_run"):
        config.pluginmanager.register(ReadWhenRun(_spend_on_collection))
    elif is_wanted(config):
        config.pluginmanager.register(Progress())
    if (seed := os.environ.get("STALLS")) and (worker or not config.getoption("numprocesses", 0)):
        config.stash[STALLS] = Stalls(f"{seed} {worker}")
        config.add_cleanup(config.stash[STALLS].stop)


def pytest_report_header() -> list[str]:
    return [f"kernels: {describe_kernels()}", f"booted: {boottime():.0f} s ago"]


def pytest_unconfigure() -> None:
    """End even if a failed test left a Zenoh session open, which keeps the interpreter for ever.

    A worker of pytest-xdist, which is here as soon as it has nothing left to do, is ended by who
    started it.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        faulthandler.dump_traceback_later(20.0, exit=True)


# The contract of patterns runs on these in `make test` and, marked `long`, in `make test-all`,
# and in `make evidence` on all: a lidar behind the axle whose rays fill the circle, and eight short
# rays at unequal bearings.
CONTRACT_PLATFORMS = {"waffle_pi": (), "epuck2": (pytest.mark.long.mark,)}


@pytest.hookimpl(wrapper=True)
def pytest_generate_tests(metafunc: pytest.Metafunc) -> Iterator[None]:
    """Leave tests of PatternContract on other platforms than CONTRACT_PLATFORMS to `make evidence`.

    A class that names its platforms runs on each of them. `make test` does not even make the
    others, which were half of all tests.
    """
    yield
    kind = metafunc.cls
    if kind is None or not issubclass(kind, PatternContract) or kind.platforms:
        return
    if "subject" in metafunc.fixturenames:
        calls = metafunc._calls
        metafunc._calls = [one for one in calls if one.id in CONTRACT_PLATFORMS]
        for call in metafunc._calls:
            call.marks.extend(CONTRACT_PLATFORMS[call.id])
        if _wants_evidence(metafunc.config):
            long = [one for one in calls if one.id not in CONTRACT_PLATFORMS]
            for call in long:
                call.marks.append(pytest.mark.evidence.mark)
            metafunc._calls += long


def _wants_evidence(config: pytest.Config) -> bool:
    """Whether `-m` or a test's id asks for tests marked `evidence`."""
    return "evidence" in config.option.markexpr or any("::" in one for one in config.args)


@pytest.hookimpl(tryfirst=True)  # before `-m` deselects tests by their marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect tests marked `evidence` unless `-m` or a test's id asks for them; long files first.

    A test that uses one of PROCESS_FIXTURES is marked `integration`; rows of parameters behind
    those that `short_rows` leaves to the short lane are marked `long`.

    A default `-m "not evidence"` in pyproject.toml would be lost under any other `-m`. Files that
    take long start first, so that no worker ends long after the others.
    """
    for item in items:
        if not PROCESS_FIXTURES.isdisjoint(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.integration)
    rows: Counter[str] = Counter()
    for item in items:
        if kept := item.get_closest_marker("short_rows"):
            rows[name := item.nodeid.partition("[")[0]] += 1
            if rows[name] > kept.args[0]:
                item.add_marker(pytest.mark.long)
    if not _wants_evidence(config):
        evidence = [item for item in items if item.get_closest_marker("evidence")]
        config.hook.pytest_deselected(items=evidence)
        items[:] = [item for item in items if not item.get_closest_marker("evidence")]
    waiting = {item.path for item in items if item.get_closest_marker("integration")}
    places = {path: order(path, path in waiting) for path in {item.path for item in items}}
    items.sort(key=lambda item: places[item.path])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test that has started a process, its fixtures included, without a mark.

    So `make test` starts those of its smoke tests alone.
    """
    yield
    if STARTED and not item.get_closest_marker("integration"):
        pytest.fail(f"{STARTED[0]} was started by a test without the mark `integration`")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    STARTED.clear()


# CPU time so far, and what was spent since the last report, by what it was spent on.
CPU_TIME = pytest.StashKey[float]()
CPU_SPENT = pytest.StashKey[dict[str, float]]()
STALLS = pytest.StashKey[Stalls]()
COUNTS = pytest.StashKey[str]()
"""The file for the counts of tests; empty without one."""


def pytest_sessionstart(session: pytest.Session) -> None:
    """Count from the start of this process, whose imports are a part of the collection.

    The collector of garbage finds none among tests that are being collected, and looked at all of
    them again and again: an eighth of the time.
    """
    gc.disable()
    session.config.stash[CPU_TIME] = 0.0
    session.config.stash[CPU_SPENT] = {}


def pytest_collection_finish(session: pytest.Session) -> None:
    """Count the collection for itself."""
    gc.freeze()
    gc.enable()
    _spend_on_collection(session.config)


def _spend_on_collection(config: pytest.Config) -> None:
    _spend(config, "(collection)")


def _spend(config: pytest.Config, subject: str) -> None:
    """Count the CPU time of this process and its ended children since the last call."""
    usages = getrusage(RUSAGE_SELF), getrusage(RUSAGE_CHILDREN)
    now = sum(usage.ru_utime + usage.ru_stime for usage in usages) + _of_fork_server()
    spent = config.stash[CPU_SPENT]
    spent[subject] = spent.get(subject, 0.0) + now - config.stash[CPU_TIME]
    config.stash[CPU_TIME] = now


def _of_fork_server() -> float:
    """The CPU time of the fork server and of its children that have ended."""
    pid = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the CPU time since the last report; pytest-xdist hands a report over with all it has."""
    report = yield
    _spend(item.config, "/".join(PurePath(report.location[0]).parts[:2]))
    if is_told(report) and not isinstance(item, EndOfFile):
        report.user_properties.append(("cpu_spent", item.config.stash[CPU_SPENT]))
        item.config.stash[CPU_SPENT] = {}
    if report.failed and (stalls := item.config.stash.get(STALLS, None)):
        report.sections.append(("stalls", stalls.said()))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show what runs the blocks of the pages, and the CPU time of each folder with --durations.

    Processes of the tests are included. `.ci/lanes` reads the counts of tests.
    """
    if counts := terminalreporter.config.stash[COUNTS]:
        stats = {kind: len(some) for kind, some in terminalreporter.stats.items()}
        failed = stats.get("failed", 0) + stats.get("error", 0)
        kept = {"passed": stats.get("passed", 0), "skipped": stats.get("skipped", 0)}
        Path(counts).write_text(json.dumps({"failed": failed, **kept}))
    seconds: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            properties = dict(getattr(report, "user_properties", ()))
            seconds.update(properties.get("cpu_spent", {}))
            if SUMMARY in properties and report.when == "call":
                terminalreporter.write_line(f"{SUMMARY}: {properties[SUMMARY]}")
    if terminalreporter.config.option.durations:
        terminalreporter.section(f"CPU time by folder, {seconds.total():.0f} s in all")
        for folder, spent in seconds.most_common():
            terminalreporter.write_line(f"{spent:8.1f} s  {folder}")


REAL_POPEN = subprocess.Popen


@pytest.fixture(scope="session")
def forked_popen() -> Iterator[type[ForkedPython]]:
    """The class that forks the modules of `tests/support/forked_python.py`."""
    with forked_python() as made:
        yield made


@pytest.fixture(autouse=True, scope="session")
def forked_hosts() -> Iterator[None]:
    """Daemons of a fleet have pattern hosts that are forks, as `DaemonProcess` has."""
    with pytest.MonkeyPatch.context() as here:
        here.setattr(fleet, "FORKED_DAEMON", "tests.support.forked_fleet_daemon")
        yield


@pytest.fixture(scope="module")
def forked_starts(forked_popen: type[ForkedPython]) -> Iterator[None]:
    """Modules that this process starts are forks, but for tests with `real_starts`."""
    with pytest.MonkeyPatch.context() as here:
        here.setattr(subprocess, "Popen", forked_popen)
        yield


@pytest.fixture
def real_starts(monkeypatch: pytest.MonkeyPatch, forked_starts: None) -> None:
    """Modules that this process starts begin without imports, as for users."""
    monkeypatch.setattr(subprocess, "Popen", REAL_POPEN)


@pytest.fixture
def runner() -> Iterator[asyncio.Runner]:
    """The loop of an asynchronous test, for fixtures that make objects on it."""
    with asyncio.Runner() as made:
        yield made


def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run an `async def` test, on the loop of the fixture `runner` if it has one."""
    test, fixtures = pyfuncitem.obj, pyfuncitem.funcargs
    if not inspect.iscoroutinefunction(test):
        return None
    coroutine = test(**{name: fixtures[name] for name in inspect.signature(test).parameters})
    runner = fixtures.get("runner")
    if isinstance(runner, asyncio.Runner):
        runner.run(coroutine)
    else:
        asyncio.run(coroutine)
    return True


@pytest.fixture(scope="session")
def a_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One browser for all tests: its start takes longer than most of them."""
    if FOUND is None:
        pytest.skip("no Chromium here")
    with chromium(tmp_path_factory.mktemp("chromium")) as one:
        yield one


@pytest.fixture
def page(a_browser: Browser) -> Iterator[Page]:
    """A page without a past."""
    with a_browser.page() as one:
        yield one

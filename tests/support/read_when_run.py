"""Files of tests that a worker of pytest-xdist reads when it runs them.

By itself, each worker of pytest-xdist imports and collects all files before the first test: in a
fresh clone eight workers of two lanes read each file, and one runs it. Here a worker lists the
files, and reads one when it is that file's turn. `-m` and `-k` select among the tests of a file as
they do among all. What passed in little time is told in one report a test, not in three.

The lane of `make test-long` reads no file that names nothing by which a test gets into it
(MARKING). Such a file is read in `make test`, where a test with the mark is an error then.
"""

from __future__ import annotations

import gc
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path

import pytest
from _pytest.mark.expression import Expression
from _pytest.runner import runtestprotocol

from tests.support.scheduling import order

_NEED_ALL = ("lf", "failedfirst", "newfirst", "stepwise", "xmlpath", "collectonly")
"""Options of pytest that choose among all tests, write down each report, or run none."""
_TOLD = 0.1
"""The seconds from which on a setup or the end of a test is told, for `--durations`."""

PROCESS_FIXTURES = {"a_browser", "elsewhere", "hosts", "roscore", "shared_swarm"}
"""Fixtures that start a process or need root; tests/conftest.py marks their tests."""
_LANES = {"integration", "long", "smoke"}
"""The marks by which the Makefile selects tests."""
MARKING = re.compile(
    "|".join([r"mark\.(integration|long|smoke)|short_rows|Contract|@story", *PROCESS_FIXTURES])
)
"""What a file names if one of its tests has a mark of _LANES."""


def may_be_selected(path: Path, expression: str) -> bool:
    """Whether a file may have tests that `-m` selects."""
    if not {*re.findall(r"\w+", expression)} <= _LANES | {"not", "and", "or"} or not expression:
        return True
    return (
        Expression.compile(expression).evaluate(_of_unmarked)
        or MARKING.search(path.read_text()) is not None
    )


def _of_unmarked(name: str, /, **options: str | int | bool | None) -> bool:
    """Whether a test without marks has this one."""
    return False


def is_wanted(config: pytest.Config) -> bool:
    """Whether files are read when they run: whole files are dealt out, and no test is named."""
    option = config.option
    if option.dist != "loadfile" or any("::" in one for one in config.args):
        return False
    return not any(getattr(option, name, False) for name in _NEED_ALL)


def is_told(report: pytest.TestReport) -> bool:
    """Whether a report of a worker goes to the process that deals out."""
    return report.when == "call" or not report.passed or report.duration >= _TOLD


class UnnamedMark(Exception):
    """A test has a mark that its file does not name."""


class UnreadFile(pytest.File):
    """A file of tests of which only the path is known."""

    def collect(self) -> Iterator[pytest.Item]:
        """Two steps; the worker gets the next file between them.

        pytest-xdist begins a step only if it has the next one, for the ends of fixtures. With one
        step a file would wait behind the file that a worker runs, while another has nothing to do.
        """
        tests = AllOfFile.from_parent(self, name="tests")
        tests.add_marker(pytest.mark.timeout(0))  # each test has its own
        yield tests
        yield EndOfFile.from_parent(self, name="end")


class Step(pytest.Item):
    """A part of what a worker does for a file."""

    def runtest(self) -> None: ...


class AllOfFile(Step):
    """All tests of a file."""


class EndOfFile(Step):
    """The end of the fixtures that the next file does not use."""


class ReadWhenRun:
    """A plugin for a worker.

    `on_read` is called after a file has been read.
    """

    def __init__(self, on_read: Callable[[pytest.Config], None]) -> None:
        self._on_read = on_read

    def pytest_pycollect_makemodule(
        self, module_path: Path, parent: pytest.Collector
    ) -> pytest.File:
        return UnreadFile.from_parent(parent, path=module_path)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> Iterator[None]:
        """Keep the steps of files from `-m` and `-k`, and put long files first."""
        steps = [item for item in items if isinstance(item, Step)]
        tests = [item for item in items if not isinstance(item, Step)]
        items[:] = tests
        yield
        for test in tests:
            marked = any(test.get_closest_marker(name) for name in _LANES)
            if marked and not MARKING.search(test.path.read_text()):
                raise UnnamedMark(f"{test.nodeid} is of make test-long, which reads files that"
                                   " tests.support.read_when_run.MARKING finds")  # fmt: skip
        if steps:
            paths = {step.path for step in steps}
            places = {path: order(path, _names_integration(path)) for path in paths
                      if may_be_selected(path, config.option.markexpr)}  # fmt: skip
            steps = [step for step in steps if step.path in places]
            items += sorted(steps, key=lambda step: places[step.path])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        if not isinstance(item, AllOfFile):
            is_test = not isinstance(item, EndOfFile)
            if is_test:
                item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
            for report in runtestprotocol(item, log=False, nextitem=nextitem):
                if is_told(report) if is_test else report.failed:
                    item.ihook.pytest_runtest_logreport(report=report)
            return True
        session = item.session
        tests = self._read(item)
        place = session.items.index(item)
        for test, following in zip(tests, [*tests[1:], nextitem], strict=False):
            session.items[place] = test  # pytest-xdist compares it with the report
            test.ihook.pytest_runtest_protocol(item=test, nextitem=following)
            if session.shouldfail or session.shouldstop:
                break
        session.items[place] = item
        return True

    def _read(self, item: AllOfFile) -> list[pytest.Item]:
        """The tests of a file that `-m` and `-k` leave; those of a broken file are an error."""
        unread = item.parent
        assert unread is not None
        assert unread.parent is not None
        session = item.session
        gc.disable()  # as during a collection of all files
        try:
            module = pytest.Module.from_parent(unread.parent, path=unread.path)
            tests = list(session.genitems(module))
            item.config.hook.pytest_collection_modifyitems(
                session=session, config=item.config, items=tests
            )
        except UnnamedMark as error:  # the other files go on
            report = pytest.CollectReport(item.nodeid, "failed", str(error), None)
            item.ihook.pytest_collectreport(report=report)
            tests = []
        finally:
            gc.enable()
        self._on_read(item.config)
        return tests


def _names_integration(path: Path) -> bool:
    return "pytest.mark.integration" in path.read_text()


class Progress:
    """A plugin for the process that deals files out to workers.

    How many tests there are is known at the end, so percentages are those of files.
    """

    def __init__(self) -> None:
        self._session: pytest.Session | None = None
        self._reported: set[str] = set()
        self._files = 0
        self._last: dict[str, str] = {}
        """The test that began last, by its file."""

    def pytest_sessionstart(self, session: pytest.Session) -> None:
        self._session = session

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: Sequence[str]) -> None:
        self._files = len({one.partition("::")[0] for one in ids})

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._last[nodeid.partition("::")[0]] = nodeid

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        assert self._session is not None
        self._reported.add(report.nodeid)
        expected = len(self._reported) * self._files // max(len(self._last), 1)
        self._session.testscollected = max(expected, len(self._reported) + 1)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtestloop(self, session: pytest.Session) -> Generator[None, object, object]:
        """Without a test, pytest ends with the code for that."""
        result = yield
        session.testscollected = len(self._reported)
        return result

    @pytest.hookimpl(optionalhook=True)
    def pytest_handlecrashitem(self, crashitem: str, report: pytest.TestReport) -> None:
        """Name the test that ended its worker."""
        file = crashitem.partition("::")[0]
        report.nodeid = self._last.get(file, crashitem)
        report.longrepr = f"{report.longrepr}: {report.nodeid}; the rest of the file did not run"

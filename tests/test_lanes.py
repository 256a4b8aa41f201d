"""The lanes of the tests: their marks select them, all run, and no other test starts a process."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
(SHORT,) = re.findall(r"^SHORT = (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)

TESTS = """
import os, subprocess, sys
from multiprocessing import get_context
import pytest

START = {
    "popen": lambda: subprocess.run([sys.executable, "-c", ""]),
    "fork": lambda: os.waitpid(os.fork() or os._exit(0), 0),
    "multiprocessing": lambda: get_context("spawn").Process(target=int).start(),
}

def test_pure(): ...

@pytest.mark.parametrize("how", START)
def test_process(how): START[how]()

@pytest.fixture
def process(): START["popen"]()

def test_fixture(process): ...

@pytest.mark.integration
def test_integration(): START["popen"]()

@pytest.mark.smoke
@pytest.mark.integration
def test_smoke(): START["popen"]()

@pytest.mark.long
def test_long(): ...

@pytest.mark.short_rows(1)
@pytest.mark.parametrize("row", [1, 2, 3])
def test_rows(row): ...

@pytest.fixture
def a_browser(): ...

def test_browser(a_browser): ...
"""


@pytest.mark.integration
@pytest.mark.parametrize(
    ("marks", "passed", "failed"),
    [
        (
            SHORT,
            {"pure", "smoke", "rows[1]"},
            {"process[popen]", "process[fork]", "process[multiprocessing]", "fixture"},
        ),
        (f"not ({SHORT})", {"integration", "long", "rows[2]", "rows[3]", "browser"}, set()),
    ],
    ids=["test", "test-long"],
)
def test_a_test_that_starts_a_process_without_a_mark_fails(
    marks: str, passed: set[str], failed: set[str], tmp_path: Path
) -> None:
    (tmp_path / "test_one.py").write_text(TESTS)
    words = ["-m", "pytest", "-c", "pyproject.toml", "-p", "tests.conftest", "-rA", "-n0"]
    command = [sys.executable, *words, "-m", marks, str(tmp_path)]
    counts = tmp_path / "counts"
    environ = {**os.environ, "LANE_COUNTS": str(counts)}
    done = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True)
    found = re.findall(r"^(PASSED|FAILED|SKIPPED|ERROR) .*?::test_(\S+)", done.stdout, re.MULTILINE)
    assert {name for result, name in found if result == "PASSED"} == passed, done.stdout
    assert {name for result, name in found if result == "FAILED"} == failed, done.stdout
    kept = json.loads(counts.read_text())
    assert kept == {"failed": len(failed), "passed": len(passed), "skipped": 0}


Counts = Mapping[str, int] | None
GREEN = {"failed": 0, "passed": 70, "skipped": 3}
RED = {"failed": 2, "passed": 11, "skipped": 4}


@pytest.mark.parametrize(
    ("results", "status", "line"),
    [
        (
            ((0, GREEN), (0, GREEN)),
            0,
            "all lanes: 0 failed, 140 passed, 6 skipped (test: 0 failed, 70 passed, 3 skipped;"
            " test-long: 0 failed, 70 passed, 3 skipped)",
        ),
        (
            ((2, RED), (0, GREEN)),
            1,
            "all lanes: 2 failed, 81 passed, 7 skipped (test: 2 failed, 11 passed, 4 skipped;"
            " test-long: 0 failed, 70 passed, 3 skipped)",
        ),
        (
            ((2, None), (0, GREEN)),
            1,
            "all lanes: 0 failed, 70 passed, 3 skipped (test: ended without a result;"
            " test-long: 0 failed, 70 passed, 3 skipped)",
        ),
    ],
    ids=["green", "the first is red", "the first was killed"],
)
def test_all_lanes_run_and_the_last_line_sums_them_up(
    results: Sequence[tuple[int, Counts]],
    status: int,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lanes = runpy.run_path(str(ROOT / ".ci" / "lanes"))
    left, made = iter(results), list[str]()

    def run(command: Sequence[str], *, env: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        made.append(command[2])
        code, counts = next(left)
        if counts is not None:
            Path(env["LANE_COUNTS"]).write_text(json.dumps(counts))
        return subprocess.CompletedProcess(command, code)

    monkeypatch.setattr(subprocess, "run", run)
    assert lanes["main"]("make", "test", "test-long") == status
    assert made == ["test", "test-long"]
    assert capsys.readouterr().out.splitlines() == [line]


def planned(*words: str) -> str:
    """The recipes of `make`, which does nothing.

    A `make` that runs this test exports what its command line sets, as `.ci/run` does with YOUNG.
    """
    of_make = {"MAKEFLAGS", "MAKEOVERRIDES", "ALL", "ARGS", "JOBS", "YOUNG"}
    environ = {name: text for name, text in os.environ.items() if name not in of_make}
    command = ["make", "--dry-run", *words]
    return subprocess.run(
        command, cwd=ROOT, env=environ, capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.integration
def test_the_gate_runs_all_lanes_and_the_short_one_on_a_young_machine() -> None:
    assert "make --no-print-directory test-all YOUNG=1" in (ROOT / ".ci" / "run").read_text()
    assert ".ci/young .venv/bin/python -m pytest" in planned("test", "YOUNG=1")
    assert ".ci/young" not in planned("test")
    assert ".ci/young" not in planned("test-long", "YOUNG=1")


CLOCKS = """
import sys, time
print(time.clock_gettime(time.CLOCK_BOOTTIME), time.monotonic())
sys.exit(3)
"""


@pytest.mark.integration
def test_on_a_young_machine_the_clocks_since_boot_begin_at_5_s() -> None:
    command = [str(ROOT / ".ci" / "young"), sys.executable, "-c", CLOCKS]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 3, done.stderr
    if done.stdout.startswith("no time namespace here"):
        pytest.skip(done.stdout.splitlines()[0])
    assert all(5.0 <= float(clock) < 200.0 for clock in done.stdout.split())


def test_each_door_has_one_smoke_test() -> None:
    marked = [
        path.relative_to(ROOT / "tests").as_posix()
        for path in (ROOT / "tests").rglob("test_*.py")
        if path != Path(__file__) and "pytest.mark.smoke" in path.read_text()
    ]
    assert sorted(marked) == [
        "drivers/test_daemons.py",
        "operator/view/test_page_socket.py",
        "sim/cli/test_classroom.py",
        "swarm/test_record.py",
        "swarm/test_rosters.py",
        "swarm/test_verbs.py",
    ]

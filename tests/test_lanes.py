"""The lanes of the tests: their marks select them, and no other test starts a process."""

from __future__ import annotations

import re
import subprocess
import sys
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
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    found = re.findall(r"^(PASSED|FAILED|SKIPPED|ERROR) .*?::test_(\S+)", done.stdout, re.MULTILINE)
    assert {name for result, name in found if result == "PASSED"} == passed, done.stdout
    assert {name for result, name in found if result == "FAILED"} == failed, done.stdout


def test_each_door_has_one_smoke_test() -> None:
    marked = [
        path.relative_to(ROOT / "tests").as_posix()
        for path in (ROOT / "tests").rglob("test_*.py")
        if path != Path(__file__) and "pytest.mark.smoke" in path.read_text()
    ]
    assert sorted(marked) == [
        "drivers/test_daemons.py",
        "sim/cli/test_classroom.py",
        "swarm/test_record.py",
        "swarm/test_rosters.py",
        "swarm/test_verbs.py",
        "view/test_page_socket.py",
    ]

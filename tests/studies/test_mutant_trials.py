"""Trials of mutants: which code is changed, which tests run, and what is said of them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import msgspec
import pytest

from studies.mutants import __main__ as mutants
from studies.mutants.changed_code import changed_functions, outermost
from studies.mutants.subjects import ROOT
from studies.mutants.zygote import UNCHANGED, Result, Trial
from swarmd.core.kernels import KERNELS, UNITS

SOURCE = """
BOUND = 2


class Clip:
    def low(self, value=1):
        return [one for one in (value,) if one < BOUND]


def spin(count):
    while count > 0:
        count -= 1
    return count
"""
TESTS = """
from clip import Clip, spin

def noted(name):
    with open("ran", "a") as file:
        file.write(name + " ")

def test_spin():
    noted("spin")
    assert spin(3) == 0

def test_low():
    noted("low")
    assert Clip().low() == [1]
    assert Clip().low(5) == []
    assert Clip().low(2.5) == []
"""


def test_code_within_functions_is_told_from_what_runs_at_import() -> None:
    def names(was: str, now: str) -> list[str] | None:
        found = changed_functions(SOURCE, SOURCE.replace(was, now), "clip.py")
        return None if found is None else [name for _, name, _ in found]

    assert names("one < BOUND", "one <= BOUND") == ["Clip.low"]
    assert names("count > 0", "count >= 0") == ["spin"]
    assert names("BOUND = 2", "BOUND = 2") == []
    assert names("BOUND = 2", "BOUND = 3") is None
    assert names("value=1", "value=2") is None
    assert outermost("Clip.low.<locals>.<listcomp>") == "Clip.low"
    assert outermost("spin") == "spin"


def test_a_mutated_unit_alone_runs_interpreted() -> None:
    """By the table of units: mutants of the ticker leave protection compiled."""
    assert {*mutants.kernels_beside("swarmd/robot/ticker.py")} == {*UNITS["swarmd.robot._ticker"]}
    barrier = mutants.kernels_beside("swarmd/robot/protection/barrier.py")
    assert "swarmd.robot.protection.constraints" in barrier
    assert "swarmd.robot.steering.steering" not in barrier
    assert "swarmd.robot.steering.steering" in KERNELS
    assert mutants.kernels_beside("swarmd/robot/requests.py") == ()


def test_a_copy_has_the_compiled_kernels_of_either_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without them every trial runs interpreted."""
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    assert mutants.libraries() == []
    built = sorted([f"sim/_world{EXTENSION_SUFFIXES[0]}", "swarmd/_led.abi3.so"])
    for path in (*built, "swarmd/_led.pyd.so"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).touch()
    assert mutants.libraries() == built


@pytest.fixture
def try_change(tmp_path: Path) -> Iterator[Callable[[str, str], Result]]:
    """What comes of a change of SOURCE, in a tree that has it and TESTS alone."""
    (tmp_path / "clip.py").write_text(SOURCE)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_clip.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n  integration\n  long\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "studies.mutants.zygote", str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    answers = process.stdout
    requests = process.stdin

    def ask(was: str, now: str) -> Result:
        tests = ("tests/test_clip.py",)
        changed = SOURCE.replace(was, now)
        trial = Trial("clip.py", changed, tests=tests, bench=tests, changed=("clip.py",))
        requests.write(msgspec.json.encode(trial) + b"\n")
        requests.flush()
        return msgspec.json.decode(answers.readline(), type=Result)

    yield ask
    requests.close()
    answers.close()
    assert process.wait() == 0


@pytest.mark.integration
def test_tests_that_call_the_changed_function_run_until_one_fails(
    try_change: Callable[[str, str], Result], tmp_path: Path
) -> None:
    def ran() -> list[str]:
        words = (tmp_path / "ran").read_text().split()
        (tmp_path / "ran").unlink()
        return words

    killed = try_change("one < BOUND", "one >= BOUND")
    assert killed.outcome == "failed"
    assert killed.said.startswith("tests/test_clip.py::test_low | ")
    assert ran() == ["spin", "low", "low"]  # both without a mutant, then the one that calls it
    assert try_change("one < BOUND", "one <= BOUND").outcome == "passed"
    assert ran() == ["low"]
    assert try_change("count -= 1", "count += 1").outcome == "timeout"
    assert ran() == ["spin"]
    assert try_change("BOUND = 2", "BOUND = 3").outcome == "failed"
    assert ran() == ["low"]  # the test that killed one runs first, and no other after it
    assert (tmp_path / "clip.py").read_text() == SOURCE


@pytest.mark.integration
def test_a_test_that_fails_without_a_mutant_kills_none(
    try_change: Callable[[str, str], Result], tmp_path: Path
) -> None:
    file = tmp_path / "tests" / "test_clip.py"
    file.write_text(TESTS + "    assert False\n")
    found = try_change("one < BOUND", "one <= BOUND")
    assert found.outcome == "error"
    assert found.said == f"{UNCHANGED}: tests/test_clip.py::test_low"

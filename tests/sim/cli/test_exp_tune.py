"""`swarmctl exp tune` as a user runs it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.tune import tune
from tests.sim.conftest import MAIN, Refusal, Swarmctl, write_duo
from tests.support.processes import children, wait_until

SMALL = ("--metric", "path_length:max", "--param", "speed=0.05..0.2", "--set", "duration=0.3")
SIZE = ("--budget", 4, "--seeds", 2, "--candidates", 2, "--held-out", 2, "-j", 2)


def walls(folder: Path) -> dict[str, float]:
    return {row["run"]: row["wall"] for row in load_results(folder).rows}


@pytest.mark.integration
def test_a_killed_tuning_continues_with_the_same_command(
    tmp_path: Path, swarmctl: Swarmctl
) -> None:
    duo, folder = write_duo(tmp_path), tmp_path / "t"
    words = ("exp", "tune", str(duo), *map(str, (*SMALL, *SIZE)), "--out", str(folder))
    first = subprocess.Popen(
        [sys.executable, "-c", MAIN, *words], stderr=subprocess.DEVNULL, cwd=tmp_path
    )
    table = folder / "batches" / "00" / "runs.csv"

    wait_until(lambda: table.exists() and table.read_bytes().count(b"\n") > 1, "a run", 120.0)
    workers = children(first.pid)
    first.kill()
    first.wait()
    kept = walls(folder / "batches" / "00")
    assert kept
    wait_until(lambda: not any(map(is_running, workers)), "the end of the workers")
    done = swarmctl(*words, "-o", "json")
    assert done.returncode == 0, done.stderr
    assert walls(folder / "batches" / "00").items() >= kept.items()  # they are not repeated
    found = json.loads(done.stdout)
    assert found["kind"] == "Tuning"
    serial = tune(
        duo,
        "path_length:max",
        budget=4,
        seeds=2,
        candidates=2,
        held_out=2,
        param=["speed=0.05..0.2"],
        set={"duration": 0.3},
    )
    assert found["best"]["values"] == serial.best.values
    assert serial.gain is not None
    assert found["gain"]["difference"] == serial.gain.difference
    assert (folder / "tuned.yaml").read_text() == serial.document


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("nowhere", "--metric", "path_length:max"), "no scenario 'nowhere'"),
        (("dispersion", "--metric", "path_length"), "path_length:min"),
        (("dispersion", "--metric", "path_lenth:min"), "did you mean 'path_length'"),
        (("dispersion", "--metric", "path_length:min", "--param", "sped"), "'speed'"),
        (("dispersion", "--metric", "path_length:min", "--held-out", "3"), ""),
        (("dispersion", "--metric", "path_length:min", "--seeds", "x"), "--seeds 'x'"),
    ],
)
def test_a_wrong_word_is_one_line(
    words: tuple[str, ...], expected: str, tmp_path: Path, refusal: Refusal
) -> None:
    if not expected:
        words = (*words, "--seeds", "2", "--budget", "3")
        expected = "budget is 3 runs; expected 4"
    assert expected in refusal("exp", "tune", *words)
    assert not list(tmp_path.glob("experiments/*"))

"""`swarmctl exp tune` as a user runs it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from swarmd.sim.cli.exp_tune import short_names, table
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.tune import Candidate, Look, tune
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
    table = folder / "races" / "01" / "runs.csv"
    wait_until(lambda: table.exists() and table.read_bytes().count(b"\n") > 1, "a run")
    workers = children(first.pid)
    first.kill()
    first.wait()
    kept = walls(folder / "races" / "01")
    assert kept
    wait_until(lambda: not any(map(is_running, workers)), "the end of the workers")
    done = swarmctl(*words, "-o", "json")
    assert done.returncode == 0, done.stderr
    assert walls(folder / "races" / "01").items() >= kept.items()  # they are not repeated
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


def look(*values: Mapping[str, object]) -> Look:
    found = tuple(
        Candidate(n, dict(one), {}, {}, losses=[1.0, 2.0], is_out=n > 1)
        for n, one in enumerate(values)
    )
    return Look(2, 30, 200, 1, found, "share_in:disc:1.2:0.8:0.8", "min")


def lines(one: Look, width: int) -> list[str]:
    console = Console(width=width, file=StringIO())
    with console.capture() as text:
        console.print(table(one, "race 2: 8 runs to come", width))
    return text.get().rstrip().splitlines()


KEYS = ("sequence.0.until.probability", "sequence.1.until.probability", "fields.0.peak")


def test_keys_are_shown_by_their_shortest_end_that_no_other_has() -> None:
    ends = ["0.until.probability", "1.until.probability", "peak"]
    assert list(short_names(KEYS).values()) == ends
    assert short_names(["speed", "walk.speed"]) == {"speed": "speed", "walk.speed": "walk.speed"}


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_the_live_table_fits_into_the_terminal(width: int) -> None:
    one = look(*({key: 0.1234 + n for key in KEYS} for n in range(4)))
    shown = lines(one, width)
    assert max(map(len, shown)) <= width
    is_wide = width >= 120
    assert any("peak ┃ share_in:disc:1.2:0.8:0.8" in line for line in shown) is is_wide
    # A line for each candidate, whatever its values.
    assert [line.count("│") for line in shown if "│" in line] == [7 if is_wide else 5] * 4
    assert "race 2: 8 runs to come" in shown[-1 if is_wide else -2]


def test_a_narrow_table_has_the_values_of_the_best_in_full() -> None:
    values = {f"part_{n}": "random_walk" for n in range(8)}
    one = look({}, values)
    assert "best: present values" in " ".join(lines(one, 80))
    best = replace(one, candidates=one.candidates[1:])
    text = " ".join(" ".join(lines(best, 80)).split())
    assert " ".join(f"part_{n}=random_walk" for n in range(8)) in text

"""The list of the runs that a program has done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.run_list import VARIABLE, list_runs, unlisted
from swarmd.sim.experiments.store import Row

VARIANTS = (Variant("x=1", {"x": 1}, {"a": 1}), Variant("x=2", {"x": 2}, {"a": 2}))
PLAN = Plan("duo", (7,), VARIANTS, {"duration": 2.0}, {"x": [1, 2]})


def results(plan: Plan = PLAN) -> Results:
    bits = ("0123456789ab", "")  # the second is of a folder of an earlier version
    rows = [
        Row(run, {"gap": 1.0}, 0.5, one, ("barrier", "contact"))
        for run, one in zip(plan.runs, bits, strict=True)
    ]
    return Results(Path("x"), plan, rows, {}, ("gap",))


def lines_of(file: Path) -> list[object]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_a_line_says_how_a_run_is_done_again(tmp_path: Path) -> None:
    file = tmp_path / "listed"
    environ = {VARIABLE: str(file)}
    did = {"seed": 7, "bits": "0123456789ab", "rules": ["barrier", "contact"]}
    list_runs(results(), environ=environ)
    list_runs(results(), is_named=False, environ=environ)
    assert lines_of(file) == [
        {"scenario": "duo", "set": {"duration": 2.0, "x": 1}, **did},
        {"scenario": {"a": 1}, **did},
    ]
    list_runs(results(), environ={})
    assert len(lines_of(file)) == 2


def test_a_path_below_the_present_folder_is_relative(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "listed"
    for place in (tmp_path / "a" / "duo.yaml", tmp_path.parent / "duo.yaml"):
        plan = Plan(str(place), (7,), VARIANTS)
        list_runs(results(plan), environ={VARIABLE: str(file)})
    names = [json.loads(line)["scenario"] for line in file.read_text().splitlines()]
    assert names == ["a/duo.yaml", str(tmp_path.parent / "duo.yaml")]


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SwarmError, match=VARIABLE):
        list_runs(results(), environ={VARIABLE: str(tmp_path)})


def test_some_runs_are_not_listed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "listed"))
    with unlisted():
        list_runs(results())
    assert not (tmp_path / "listed").exists()
    list_runs(results())
    assert (tmp_path / "listed").exists()

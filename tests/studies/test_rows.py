"""Outcomes of rows: their forms, their sources, and how values become outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from studies.films import Shot
from studies.night.jobs import JOBS
from studies.outcomes import rows
from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import PATTERNS, kept_outcomes, patterns_with_rows
from studies.outcomes.rows import RowsOf, forms, outcomes_with_runs
from swarmd.sim.experiments.outcomes import NAME, read_outcomes
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row

TEXT = """\
scenario: drive
seeds: 2
runs:
  own: {}
  other: {set: {duration: 5}}
outcomes:
  - {what: least, runs: own, requirement: min(minimum_gap) >= 1, source: a}
  - {what: mean, runs: own, requirement: mean(minimum_gap) <= 4, source: b}
  - {what: ratio, runs: own, requirement: mean(minimum_gap) >= 2, over: other, source: c}
  - {what: steps, runs: own, requirement: max(minimum_gap) <= 2, less: other, source: d}
  - {what: share, runs: other, requirement: share(one_cluster_at_end) >= 0.5, source: e}
  - {what: none, runs: other, requirement: max(arena_contacts) <= 0, source: f}
"""


def results_of(**metrics: tuple[float, ...]) -> Results:
    count = len(next(iter(metrics.values())))
    plan = Plan("x", tuple(range(count)), (Variant("", {}, {}),))
    table = [
        Row(run, {name: values[at] for name, values in metrics.items()}, 0.1)
        for at, run in enumerate(plan.runs)
    ]
    return Results(Path("x"), plan, table, {}, tuple(metrics))


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of rows, whose runs are not done: they have these values."""
    path = tmp_path / NAME
    path.write_text(TEXT)

    def simulate(
        scenario: str, seeds: object, *, set: Mapping[str, Any], **others: object
    ) -> Results:
        if "duration" in set:
            return results_of(
                minimum_gap=(1.0, 3.0), one_cluster_at_end=(1.0, 0.0), arena_contacts=(0.0, 0.0)
            )
        return results_of(minimum_gap=(2.0, 6.0))

    monkeypatch.setattr(rows, "simulate", simulate)
    return path


def test_values_of_rows_become_outcomes(file: Path) -> None:
    made, results = outcomes_with_runs(read_outcomes(file), "drive", (0, 1))
    assert list(results) == ["own", "other"]
    shown = [(one.what, one.wanted, one.values, one.is_reached, one.source) for one in made]
    assert shown == [
        ("least", ">= 1", (2.0, 6.0), True, "a"),
        ("mean", "<= 4", (4.0,), True, "b"),
        ("ratio", ">= 2", (2.0,), True, "c"),  # (2 + 6) / (1 + 3)
        ("steps", "<= 2", (1.0, 3.0), False, "d"),  # 2 - 1, 6 - 3
        ("share", ">= 0.5", (0.5,), True, "e"),
        ("none", "0", (0.0, 0.0), True, "f"),
    ]
    assert [one.joined.kind if one.joined else "" for one in made] == [
        *("", "mean", "ratio", "", "share", "")
    ]


def test_rows_of_runs_that_a_short_form_leaves_out_are_left_out(file: Path) -> None:
    outcomes = read_outcomes(file)
    made, _ = outcomes_with_runs(outcomes, "drive", (0, 1), sets={"other": None})
    assert [one.what for one in made] == ["least", "mean"]
    (least, _), _ = outcomes_with_runs(
        outcomes, "drive", (0, 1), sets={"other": None}, bounds={"least": 3.0}
    )
    assert (least.wanted, least.is_reached) == (">= 3", False)


def test_forms_name_runs_and_rows_that_there_are() -> None:
    looks = {field.name for field in fields(Shot)}
    for pattern, form in forms().items():
        module = MODULES[pattern]
        assert isinstance(module, RowsOf)
        assert form.short.keys() <= module.file.runs.keys()
        assert form.bounds.keys() <= {row.what for row in module.file.rows}
        assert form.film.keys() <= looks


@pytest.mark.parametrize("pattern", patterns_with_rows())
def test_rows_and_the_kept_table_have_the_same_bounds_and_sources(pattern: str) -> None:
    """In the same order, if the pattern has no outcome in Python."""
    kept = [(one.what, one.source) for one in kept_outcomes()[pattern].outcomes]
    stated = [(row.what, row.source) for row in read_outcomes(PATTERNS / pattern / NAME).rows]
    if isinstance(MODULES[pattern], RowsOf):
        assert stated == kept
    assert [one for one in kept if one in stated] == stated


def test_a_pattern_its_scenario_and_its_rows_are_roots_of_its_table() -> None:
    for pattern in MODULES:
        job = next(job for job in JOBS if job.name == pattern)
        places = {
            f"swarmd.patterns.{pattern}.{name}" for name in ("pattern", "scenario", "outcomes")
        }
        assert places <= {*job.roots}


def test_runs_with_seeds_of_their_own_take_those_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As formations, in which each number of robots has its own seeds."""
    path = tmp_path / NAME
    path.write_text(
        'scenario: drive\nruns: {even: {seeds: "0,2"}, odd: {seeds: "1,3"}, rare: {seeds: "9-9"}}\n'
        "outcomes:\n"
        "  - {what: w, runs: [even, odd], requirement: max(minimum_gap) <= 9, source: a}\n"
        "  - {what: r, runs: rare, requirement: max(minimum_gap) <= 9, source: a}\n"
    )
    asked: list[tuple[int, ...]] = []

    def simulate(scenario: str, seeds: list[int], **others: object) -> Results:
        asked.append(tuple(seeds))
        return results_of(minimum_gap=tuple(map(float, seeds)))

    monkeypatch.setattr(rows, "simulate", simulate)
    made, _ = outcomes_with_runs(read_outcomes(path), "drive", range(4))
    assert asked == [(0, 2), (1, 3)]
    assert [(one.what, one.values) for one in made] == [("w", (0.0, 2.0, 1.0, 3.0))]

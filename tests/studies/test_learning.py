"""Runs of learned policies: each alone gives what it gives after the others."""

from __future__ import annotations

import numpy as np

from studies.keeper import Record
from studies.learning import (
    RANDOM,
    SHIPPED,
    TRAINED,
    Run,
    Values,
    random_actions,
    runs_of,
    shipped,
    table,
)

DECISIONS = 392
"""Of a run: four robots, 19.6 s, five decisions a second."""


def test_random_actions_of_a_run_follow_those_of_the_run_before() -> None:
    rng = np.random.default_rng(0)
    count = shipped().spec.actions
    drawn = [rng.uniform(-1.0, 1.0, count) for _ in range(3 * DECISIONS)]
    for run in range(3):
        act = random_actions(run=run)
        some = [act({}) for _ in range(DECISIONS)]  # type: ignore[arg-type]  # it reads nothing
        np.testing.assert_array_equal(some, drawn[run * DECISIONS : (run + 1) * DECISIONS])


def test_each_kind_of_actions_has_its_seeds_in_both_modes() -> None:
    runs = runs_of([SHIPPED, RANDOM, f"{TRAINED}off"], [5, 6], 23)
    assert len(runs) == 12
    assert [run for run in runs if run.actions == RANDOM] == [
        Run(RANDOM, "barrier", 5, number=0),
        Run(RANDOM, "barrier", 6, number=1),
        Run(RANDOM, "off", 5, number=2),
        Run(RANDOM, "off", 6, number=3),
    ]
    assert {run.generations for run in runs if run.actions == SHIPPED} == {0}
    assert {run.generations for run in runs if run.actions == f"{TRAINED}off"} == {23}


def test_the_table_has_the_means_of_each_kind_and_mode() -> None:
    runs = runs_of([SHIPPED], [0, 1], 0)
    records = [Record(run, Values(float(run.seed), 0.25, 3.0)) for run in runs]
    rows = [row.split("|") for row in table(records).splitlines()[2:]]
    assert [row[2].strip() for row in rows] == ["barrier", "off"]
    assert [row[3].split()[0] for row in rows] == ["0.50", "0.50"]
    assert [row[5].split()[0] for row in rows] == ["3.00", "3.00"]

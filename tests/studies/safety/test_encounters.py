"""The tasks of getting past each other: each is a scenario, and its numbers add up."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies import keeper
from studies.keeper import Traced
from studies.safety import encounters
from studies.safety.encounters import (
    MODES,
    TASKS,
    Found,
    Run,
    carry_out,
    perform,
    scenario_for,
    table,
)
from tests.support.examples import part

pytestmark = pytest.mark.long

LATE = Found(
    arrived=3, robots=8, last=None, goals=4, recovering=0.5, stuck=3, windows=6, touches=1,
    faults=1, cpu=1.0,
)  # fmt: skip


@pytest.mark.parametrize("task", TASKS)
def test_each_task_is_a_scenario_in_each_mode(task: str) -> None:
    robots = {len(scenario_for(task, mode).robots) for mode in MODES}
    assert len(robots) == 1
    assert robots.pop() >= 1


def test_a_ghost_passes_a_parked_robot_and_the_parked_one_does_not_count() -> None:
    found = perform(Run("past a parked robot", "ghost", 0)).found
    assert (found.arrived, found.robots, found.faults) == (1, 1, 0)
    assert found.goals >= 3
    assert found.last is not None
    assert found.last < 16.0


def test_an_interrupted_study_repeats_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[Run] = []

    def simulated(run: Run) -> Traced[Found]:
        done.append(run)
        return Traced(LATE)

    monkeypatch.setattr(encounters, "perform", simulated)
    monkeypatch.setattr(keeper, "code_of", lambda perform: "these sources")
    file, cell = tmp_path / "some" / "runs.jsonl", ("swap of 8", "barrier")
    carry_out(cell[:1], cell[1:], [0], 1, file)
    assert carry_out(cell[:1], cell[1:], [0, 1], 1, file) == {cell: [LATE, LATE]}
    assert done == [Run(*cell, 0), Run(*cell, 1)]
    monkeypatch.setattr(keeper, "code_of", lambda perform: "other sources")
    carry_out(cell[:1], cell[1:], [0], 1, file)
    assert done[2:] == [Run(*cell, 0)]


def test_the_table_has_a_row_for_each_cell_with_the_share_of_ghosts() -> None:
    one = Found(
        arrived=8, robots=8, last=20.0, goals=10, recovering=0.0, stuck=0, windows=6,
        touches=0, faults=0, cpu=1.0,
    )  # fmt: skip
    text = table({("swap of 8", "ghost"): [one], ("swap of 8", "barrier"): [LATE]})
    assert "40%" in text
    assert "3 of 8" in text
    assert "0 of 1 runs" in text


@pytest.mark.evidence
def test_with_true_places_robots_that_meet_pass_each_other() -> None:
    found = perform(Run("two that meet", "orca_true", 3)).found
    assert (found.arrived, found.touches) == (2, 0)
    assert found.goals > perform(Run("two that meet", "barrier", 3)).found.goals


@pytest.mark.parametrize("task", part(["two that meet"], ["past a parked robot"]))
def test_robots_pass_each_other_with_less_recovery_and_without_a_touch(task: str) -> None:
    found = perform(Run(task, "orca", 3)).found
    assert found.arrived == found.robots
    assert found.touches == 0
    assert found.recovering < perform(Run(task, "barrier", 3)).found.recovering

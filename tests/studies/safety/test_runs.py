"""Judged runs of scenes: they are kept, repeat bit by bit, and are added up."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from studies import keeper
from studies.safety import hours, progress
from studies.safety.columns import goals_a_minute, rate, upper_bound
from studies.safety.judgement import Judgement
from studies.safety.runs import Record, Task, carry_out, total
from studies.safety.scenes import FAMILIES, Scene
from swarmd.core.errors import ConfigError

pytestmark = pytest.mark.long

NOTHING = Judgement(
    seconds=3600.0,
    collisions=0,
    faults=0,
    worst=0.0,
    hits=0,
    worst_hit=0.0,
    touches=0,
    touch_faults=0,
    worst_touch=0.0,
    pushed=0,
    goals=0,
    goal_seconds=0.0,
    windows=0,
    stuck=0,
    altered=0.0,
    min_gap=0.1,
)
SHORT = Scene("goals", "burger", mode="ghost", duration=2.0)


@pytest.fixture(autouse=True)
def _same_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """The digest of the sources takes longer than these runs."""
    monkeypatch.setattr(keeper, "code_of", lambda perform: "a")


def record(scene: Scene, seed: int = 0, found: Judgement = NOTHING) -> Record:
    return Record(Task(scene, seed), found, cpu=36.0, day="2026-11-22", commit="1a2b3c4")


def changed(**values: float) -> Judgement:
    return msgspec.structs.replace(NOTHING, **values)


@pytest.mark.integration
def test_runs_are_done_in_processes_and_none_twice(tmp_path: Path) -> None:
    file = tmp_path / "some.jsonl"
    first = carry_out([Task(SHORT, 0)], file, 1)
    both = carry_out([Task(SHORT, 2), Task(SHORT, 1), Task(SHORT, 0)], file, 2)
    assert [one.task.seed for one in both] == [2, 1, 0]
    assert both[2] == first[0]  # with the same processor time: it is the same run
    assert len(file.read_text().splitlines()) == 3
    assert len({one.bits for one in both}) == 3


def test_a_run_that_is_done_again_has_the_same_bits(tmp_path: Path) -> None:
    task = Task(SHORT, 0)
    (record,) = carry_out([task], tmp_path / "some.jsonl", 1)
    again = keeper.again("studies.safety.runs:perform", msgspec.to_builtins(task))
    assert (again.bits, again.rules, again.found) == (record.bits, record.rules, record.found)
    other = msgspec.to_builtins(Task(SHORT, 1))
    assert keeper.again("studies.safety.runs:perform", other).bits != again.bits


def test_an_impossible_scene_is_refused_before_anything_runs(tmp_path: Path) -> None:
    tasks = [Task(SHORT, 0), Task(Scene("poles", "jackal"), 0)]
    with pytest.raises(ConfigError, match="platform"):
        carry_out(tasks, tmp_path / "some.jsonl", 1)
    assert not (tmp_path / "some.jsonl").exists()


def test_numbers_are_added_and_extremes_kept() -> None:
    a = changed(collisions=1, worst=0.03, goals=4, goal_seconds=60.0, min_gap=0.2)
    whole = total([a, changed(collisions=2, worst=0.01), NOTHING])
    assert (whole.seconds, whole.collisions, whole.worst, whole.min_gap) == (10800, 3, 0.03, 0.1)
    assert goals_a_minute(whole) == pytest.approx(4.0)
    assert goals_a_minute(NOTHING) is None


@pytest.mark.parametrize(
    ("count", "bound"),
    # Half the 95 % quantile of chi-squared with 2 (count + 1) degrees of freedom, from tables.
    [(0, 2.996), (1, 4.744), (2, 6.296), (10, 16.962), (100, 118.079)],
)
def test_bounds_are_those_of_poisson(count: int, bound: float) -> None:
    assert upper_bound(count, 1.0) == pytest.approx(bound, rel=0.015)
    assert upper_bound(count, 10.0) == pytest.approx(bound / 10.0, rel=0.015)


def test_rates_come_with_their_upper_bound() -> None:
    assert rate(0, 100 * 3600.0) == "0 (< 0.03)"
    assert rate(3, 10 * 3600.0) == "3 (0.3, < 0.77)"


def test_a_plan_has_the_hours_asked_for_over_all_scenes_with_fresh_seeds() -> None:
    scenes = hours.cells(("goals", "ram", "drive"), ("burger", "mixed"), ("body", "real"),
                         "barrier", 600.0)  # fmt: skip
    assert len(scenes) == 12
    once = hours.plan(0.0, scenes, range(1000, 2000), is_whole=True)
    assert [task.scene for task in once] == scenes
    assert hours.plan(0.0, scenes, range(1000, 2000)) == []
    tasks = hours.plan(100.0, scenes, range(1000, 2000))
    planned = sum(task.scene.protected * task.scene.duration / 3600.0 for task in tasks)
    assert 100.0 <= planned < 102.0
    assert len(set(tasks)) == len(tasks)
    assert {task.seed for task in tasks if FAMILIES[task.scene.family].is_own} == set(
        range(1000, max(task.seed for task in tasks) + 1, 2)
    )


def test_tables_have_a_row_for_each_cell_by_its_options_and_separate_what_is_not_claimed() -> None:
    text = hours.tables(
        [
            record(Scene("goals", "burger"), 7, changed(held=9.0)),
            record(Scene("goals", "burger", "real")),
            record(Scene("ram", "burger"), 7, changed(collisions=5, faults=1, worst=0.031)),
            record(Scene("ram_fast", "burger"), 8, changed(collisions=5, faults=1, worst=0.2)),
        ]
    )
    alone, claimed, beyond, at_fault = text.split("#### ")[1:]
    assert (
        cells(alone, "goals", "body")
        == "1.00 | 0 | 0 | 0 | 3 | - | 0.25% | 0 | 2026-11-22 | 1a2b3c4"
    )
    assert (
        cells(alone, "goals", "real") == "1.00 | 0 | 0 | 0 | 3 | - | - | 0 | 2026-11-22 | 1a2b3c4"
    )
    assert cells(claimed, "ram", "body").startswith("1.00 | 5 | 0 | 1 | 4.7 | 3.1 cm/s |")
    assert "20.0 cm/s" in cells(beyond, "ram_fast", "body")
    assert "`python -m studies.safety one ram burger body barrier 7 --duration 600`" in at_fault


def cells(table: str, family: str, visibility: str) -> str:
    options = f"`--families {family} --platforms burger --visibilities {visibility}`"
    row = next(line for line in table.splitlines() if options in line)
    return " | ".join(cell.strip() for cell in row.strip("| ").split("|")[1:])


def test_progress_is_a_share_of_the_goals_of_ghosts() -> None:
    tasks = progress.plan(("goals",), ("burger",), ("body",), ("barrier",), (0, 1), 60.0)
    assert len(tasks) == 8  # sparse and dense, ghosts and barrier, two seeds
    reached = {"ghost": 100, "barrier": 25}
    records = [
        record(t.scene, t.seed, changed(goals=reached[t.scene.mode], goal_seconds=3600.0))
        for t in tasks
    ]
    text = progress.tables(records)
    assert "### goals, burger, body, 6.0 m2 a robot" in text
    assert "### goals, burger, body, 1.6 m2 a robot" in text
    assert text.count("100%") == text.count("25%") == 2

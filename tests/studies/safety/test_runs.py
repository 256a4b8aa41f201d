"""Runs are stored, resumed and added up; none runs twice, and none of other sources counts."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from studies.safety import hours, progress
from studies.safety.columns import goals_a_minute, rate, upper_bound
from studies.safety.judgement import Judgement
from studies.safety.runs import (
    Record,
    Task,
    carry_out,
    carry_out_missing,
    fingerprint,
    read,
    total,
)
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


def record(scene: Scene, seed: int = 0, found: Judgement = NOTHING) -> Record:
    return Record(
        task=Task(scene, seed), code="c", cpu=36.0, date="2026-11-22", commit="1a2b3c4", found=found
    )


def changed(**values: float) -> Judgement:
    return msgspec.structs.replace(NOTHING, **values)


@pytest.mark.integration
def test_a_finished_run_is_not_repeated(tmp_path: Path) -> None:
    file = tmp_path / "some.jsonl"
    first = carry_out([Task(SHORT, 0)], file, 1)
    both = carry_out([Task(SHORT, 1), Task(SHORT, 0)], file, 2)
    assert [one.task.seed for one in both] == [1, 0]
    assert both[1] == first[0]  # with the same processor time: it is the same run
    assert len(file.read_text().splitlines()) == 2


def test_runs_of_other_sources_do_not_count(tmp_path: Path) -> None:
    file = tmp_path / "some.jsonl"
    file.write_bytes(msgspec.json.encode(record(SHORT)) + b"\n")
    done = carry_out([Task(SHORT, 0)], file, 1)
    assert done[0].code == fingerprint() != "c"
    assert len(read(file, Record)) == 2


def test_a_line_that_a_power_cut_has_halved_is_made_again(tmp_path: Path) -> None:
    file = tmp_path / "some.jsonl"
    tasks = [Task(SHORT, seed) for seed in (0, 1)]

    def perform(task: Task, code: str) -> Record:
        return msgspec.structs.replace(record(task.scene, task.seed), code=code)

    whole = carry_out_missing(tasks, perform, Record, file, 1)
    assert read(file, Record) == whole
    file.write_bytes(file.read_bytes()[:-20])
    assert read(file, Record) == whole[:1]
    assert carry_out_missing(tasks, perform, Record, file, 1) == whole
    assert read(file, Record) == whole


def test_a_file_of_another_format_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "some.jsonl"
    file.write_text("robots\n")
    with pytest.raises(ConfigError, match=r"some\.jsonl: .*take the line out"):
        carry_out([Task(SHORT, 0)], file, 1)


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
            record(Scene("goals", "burger")),
            record(Scene("goals", "burger", "real")),
            record(Scene("ram", "burger"), 7, changed(collisions=5, faults=1, worst=0.031)),
            record(Scene("ram_fast", "burger"), 8, changed(collisions=5, faults=1, worst=0.2)),
        ]
    )
    alone, claimed, beyond, at_fault = text.split("#### ")[1:]
    assert cells(alone, "goals", "body") == "1.00 | 0 | 0 | 0 | 3 | - | 0 | 2026-11-22 | 1a2b3c4"
    assert cells(alone, "goals", "real") == "1.00 | 0 | 0 | 0 | 3 | - | 0 | 2026-11-22 | 1a2b3c4"
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

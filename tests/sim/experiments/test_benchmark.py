"""The suite of benchmark tasks: its files, the patterns that fit, the table, and other programs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import swarmd.config
from studies.benchmark_suite import schema_text
from swarmd.core.errors import ConfigError, UnknownPatternError
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import PlatformFile, platform_of, platform_sources
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments import benchmark
from swarmd.sim.experiments.benchmark import CompleteTaskFile, Task, load_task, task_names
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.catalog import measure

SUITE = Path(swarmd.config.__path__[0]) / "benchmark"
TASKS = {name: load_task(name) for name in task_names()}
DECLARED = ("provides", "sensors", "description", "extends", "drivers", "presets", "mode")
"""What a task may say otherwise than the platform's file, besides fields that do not concern it."""


def data_of(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((SUITE / f"{name}.yaml").read_text())
    return found


def write(folder: Path, change: Callable[[dict[str, Any]], object], name: str = "doorway") -> Path:
    """A changed copy of a file of the suite."""
    data = data_of(name)
    change(data)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def test_there_are_ten_tasks_of_one_version() -> None:
    assert len(TASKS) == 10
    assert {task.file.suite for task in TASKS.values()} == {benchmark.SUITE}
    assert len({task.file.metric.name for task in TASKS.values()}) == 10


@pytest.mark.parametrize("name", TASKS)
def test_a_file_is_complete_and_starts_by_its_seed(name: str) -> None:
    msgspec.convert(data_of(name), CompleteTaskFile)
    scenario = TASKS[name].scenario(TASKS[name].file.candidates[0].pattern)
    np.testing.assert_array_equal(scenario.starts(7), scenario.starts(7))
    has_rule = any("seed" in str(one) or "random" in str(one) for one in _starts(TASKS[name]))
    assert has_rule == (scenario.starts(7) != scenario.starts(8)).any()
    assert TASKS[name].robots == len(scenario.robots)


def _starts(task: Task) -> list[object]:
    return [group["start"] for group in task.file.scenario["groups"].values()]


@pytest.mark.parametrize("name", TASKS)
def test_the_robots_of_a_file_are_those_of_the_platform_files(name: str) -> None:
    for platform, section in TASKS[name].file.scenario["platforms"].items():
        whole = msgspec.to_builtins(Layered(*platform_sources(platform)).build(PlatformFile))
        own = msgspec.to_builtins(msgspec.convert(section, PlatformFile))
        for data in (whole, own):
            data |= {f"protection.{key}": value for key, value in data.pop("protection").items()}
        same = {key for key in whole if key.rpartition(".")[2] not in DECLARED}
        assert {key: own[key] for key in same} == {key: whole[key] for key in same}
        platform_of(platform, Layered((name, section)))  # complete by itself


@pytest.mark.parametrize("name", ["doorway", "pursuit"])
def test_a_seed_reproduces_a_run(name: str) -> None:
    task = TASKS[name]
    scenario = task.scenario("random_walk")
    first, again, other = (
        simulate(scenario, [seed], set={"duration": 2.0}, metrics=[task.file.metric.name])
        for seed in (3, 3, 4)
    )
    (trace,), (same,), (another,) = first.traces, again.traces, other.traces
    np.testing.assert_array_equal(trace.pose, same.pose)
    assert (trace.pose != another.pose).any()
    value = first.metric(task.file.metric.name)[0]
    assert value == measure(same, [task.file.metric.name])[task.file.metric.name]
    low, high = task.file.metric.bounds
    assert low is not None
    assert high is not None
    assert low <= value <= high


def test_candidates_have_their_parameters_and_judged_groups_alone() -> None:
    swap = TASKS["antipodal_swap"].scenario("patrol").effective["groups"]
    assert swap["r1"]["parameters"] == {"recovery": True, "places": "-1.5 0, -1.5 0"}
    assert swap["r3"]["parameters"]["places"] == "0 -1.5, 0 -1.5"
    pursuit = TASKS["pursuit"].scenario("levy_walk").effective["groups"]
    assert (pursuit["pursuers"]["pattern"], pursuit["evaders"]["pattern"]) == (
        "levy_walk", "dispersion",
    )  # fmt: skip


def test_a_pattern_that_does_not_fit_is_named_with_what_is_missing() -> None:
    tasks = [TASKS["doorway"], TASKS["foraging"]]
    entries, misfits = benchmark.entries_of(tasks, ["foraging"])
    assert [(one.task.name, one.pattern) for one in entries] == [("foraging", "foraging")]
    (misfit,) = misfits
    assert (misfit.task, misfit.pattern) == ("doorway", "foraging")
    assert "gripper" in misfit.why
    assert "reading:food" in misfit.why
    assert "\n" not in misfit.why
    with pytest.raises(UnknownPatternError, match="foragin"):
        benchmark.entries_of(tasks, ["foragin"])


def test_without_patterns_the_candidates_are_run() -> None:
    entries, misfits = benchmark.entries_of([TASKS["best_of_n"]])
    assert [one.pattern for one in entries] == [
        "best_of_n", "cross_inhibition", "majority_rule", "voter_model",
    ]  # fmt: skip
    assert not misfits


def test_ranks_follow_the_direction_where_no_intervals_overlap() -> None:
    values = {
        ("a", "far"): {0: 1.0, 1: 3.0},
        ("b", "far"): {0: 2.0, 1: 2.0},
        ("c", "far"): {0: 0.5, 1: 0.6},
        ("d", "far"): {0: math.nan},
        ("b", "good"): {0: 0.1, 1: 0.1},
        ("c", "good"): {0: 0.9, 1: 0.9},
        ("a", "one"): {0: 0.1},
        ("b", "one"): {0: 0.9},
    }
    table = benchmark.table_of(values, {"far": "less", "good": "more", "one": "less"})
    ranks = {row: {task: cell.rank for task, cell in cells.items()} for row, cells in table.items()}
    assert ranks == {
        "c": {"far": 1, "good": 1},
        "b": {"far": None, "good": 2, "one": None},  # one run has no interval
        "a": {"far": None, "one": None},
        "d": {"far": None},
    }
    assert list(ranks) == ["a", "c", "b", "d"]
    places = {row: cells["far"].place for row, cells in table.items()}
    assert places == {"a": 2, "c": 1, "b": 2, "d": math.inf}
    assert table["a"]["far"].summary.median == 2.0
    assert benchmark.cell_text(table["c"]["far"]) == "0.55 (0.5 to 0.6) #1"
    assert benchmark.cell_text(table["b"]["far"]) == "2 (2 to 2)"
    assert benchmark.cell_text(table["d"]["far"]) == "-"
    some = benchmark.table_of({("e", "far"): {0: 1.0, 1: math.nan}}, {"far": "less"})
    assert benchmark.cell_text(some["e"]["far"]) == "1 #1 of 1/2"
    assert benchmark.cell_text(None) == ""


def test_results_of_another_program_are_read_by_row_and_task(tmp_path: Path) -> None:
    path = tmp_path / "argos.csv"
    text = "task,seed,value,name\ndoorway,0,0.5,\ndoorway,1,,\nshelter,0,1,fsm\n"
    path.write_text(text, encoding="utf-8-sig")  # as spreadsheets write it
    found = benchmark.read_results(path, task_names())
    assert found["argos", "doorway"].keys() == {0, 1}
    assert found["argos", "doorway"][0] == 0.5
    assert math.isnan(found["argos", "doorway"][1])
    assert found["fsm", "shelter"] == {0: 1.0}


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("task,value\ndoorway,1\n", ":1: there is no column seed"),
        ("task,seed,value\ndor,0,1\n", ":2: no benchmark task 'dor'"),
        ("task,seed,value\ndoorway,-1,1\n", ":2: seed"),
        ("task,seed,value\ndoorway,0,fast\n", ":2: value is 'fast'"),
        ("task,seed,value\ndoorway,0,1\ndoorway,0,2\n", ":3: "),
        ("task,seed,value\ndoorway,0\n", ":2: expected as many cells"),
        ("task,seed,value\ndoorway,0,1,2\n", ":2: expected as many cells"),
        ("task,seed,value\ndoorway,0,41\n", ":2: value is 41; expected 0.0 to 1.0"),  # per cent
    ],
)
def test_faulty_results_are_one_line_with_file_and_line(
    tmp_path: Path, text: str, subject: str
) -> None:
    path = tmp_path / "other.csv"
    path.write_text(text)
    bounds = {"doorway": load_task("doorway").file.metric.bounds}
    with pytest.raises(ConfigError) as refusal:
        benchmark.read_results(path, task_names(), bounds)
    assert f"{path}{subject}" in str(refusal.value)
    assert "\n" not in str(refusal.value)


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "an unknown key": (lambda d: d.update(goal=1), "goal"),
    "another version": (lambda d: d.update(suite=9), "suite is 9"),
    "an unknown metric": (lambda d: d["metric"].update(name="share_of"), "metric.name"),
    "a metric of a file": (
        lambda d: d["metric"].update(name=f"{__file__}:run"), "a task names no file",
    ),
    "another direction": (lambda d: d["metric"].update(better="less"), "more is better"),
    "an unknown group": (lambda d: d.update(groups=["tem"]), "'tem'"),
    "a judged group with a pattern": (
        lambda d: d["scenario"]["groups"]["team"].update(pattern="drive"), "team.pattern",
    ),
    "a platform that is elsewhere": (
        lambda d: d["scenario"]["platforms"]["burger"].pop("extends"), "extends",
    ),
    "a platform without a scan": (
        lambda d: d["scenario"]["platforms"]["burger"].pop("scan"), "scan",
    ),
    "a wrong key of the scenario": (lambda d: d["scenario"].update(walls=3), "walls"),
    "robots outside the walls": (
        lambda d: d["scenario"]["arena"].update(segments=[{"from": [9, 0], "to": [0, 0]}]), "9",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_is_one_line_with_its_name(tmp_path: Path, fault: str) -> None:
    change, subject = FAULTS[fault]
    path = write(tmp_path, change)
    with pytest.raises(ConfigError) as refusal:
        load_task(str(path))
    assert "mine.yaml: " in str(refusal.value)
    assert subject in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_candidate_of_a_file_that_does_not_fit_is_an_error_of_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, lambda d: d.update(candidates=[{"pattern": "foraging"}]))
    with pytest.raises(ConfigError, match=r"mine\.yaml.*gripper"):
        benchmark.entries_of([load_task(str(path))])


def test_the_schema_in_the_repository_is_that_of_the_struct() -> None:
    assert (SUITE / "schema.json").read_text() == schema_text()


def _short(data: dict[str, Any]) -> None:
    data["seeds"] = 2
    data["scenario"]["duration"] = 1.0
    data["scenario"]["groups"]["team"]["count"] = 1
    data["candidates"] = [{"pattern": "drive"}, {"pattern": "random_walk"}]


@pytest.mark.integration
@pytest.mark.long
def test_bench_prints_one_table_resumes_and_takes_other_results(tmp_path: Path) -> None:
    task = write(tmp_path, _short)
    other = tmp_path / "argos.csv"
    other.write_text("task,seed,value\nmine,0,0.25\nmine,1,0.75\nshelter,0,1\n")
    out = tmp_path / "out"
    words = ["bench", str(task), "--out", str(out), "-j", "1", "--with", str(other)]
    done = CliRunner().invoke(exp, words)
    assert done.exit_code == 0, done.output
    head, *rows = [line.split() for line in done.stdout.splitlines()]
    assert head == ["PATTERN", "MINE"]
    assert [row[0] for row in rows] == ["argos", "drive", "random_walk"]
    assert rows[0][1:] == ["0.5", "(0.25", "to", "0.75)", "#1"]
    assert "only 2 runs" in done.stderr
    assert "4 of 4 runs done" in done.stderr
    rerun = CliRunner().invoke(exp, [*words, "-o", "json"])
    assert rerun.exit_code == 0
    assert "4 of 4 runs done" in rerun.stderr
    found = json.loads(rerun.stdout)
    (listed,) = found["tasks"]
    assert [one["name"] for one in listed["results"]] == ["argos", "drive", "random_walk"]
    assert listed["results"][1]["values"].keys() == {"0", "1"}
    assert (out / "mine" / "drive" / "manifest.json").is_file()


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["dorway"], "doorway"),
        (["doorway", "doorway"], "twice"),
        (["doorway", str(SUITE / "doorway.yaml")], "twice"),
        (["list", "doorway"], "list"),
        (["doorway", "--pattern", "foraging"], "fits none"),
        (["doorway", "--pattern", "mine.py"], "no such file"),
        (["doorway", "--seeds", "x"], "--seeds"),
        (["doorway", "--with", "none.csv"], "none.csv"),
    ],
)
def test_a_wrong_line_is_refused_before_anything_runs(
    tmp_path: Path, words: list[str], subject: str
) -> None:
    out = tmp_path / "out"
    done = CliRunner().invoke(exp, ["bench", *words, "--out", str(out)])
    assert isinstance(done.exception, ConfigError)
    assert subject in str(done.exception)
    assert not out.exists()


def test_the_list_has_all_tasks(tmp_path: Path) -> None:
    done = CliRunner().invoke(exp, ["bench", "list", "-o", "json"])
    listed = json.loads(done.stdout)["tasks"]
    assert [one["name"] for one in listed] == list(task_names())
    assert all(one["robots"] > 0 and one["candidates"] for one in listed)

"""The suite of benchmark tasks: its scenarios, the patterns that fit, the ranks, and the verb."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import swarmd.config
from swarmd.core.errors import ConfigError, UnknownPatternError
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import PlatformFile, platform_sources
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments.benchmark import plan_of_task, row, standings
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row
from swarmd.sim.metrics.catalog import metric_of
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of, task_names

SUITE = Path(swarmd.config.__path__[0]) / "scenarios"
DECLARED = ("provides", "sensors", "description", "extends", "drivers", "presets", "mode")
"""What a task may say otherwise than the platform's file, besides fields that do not concern it."""


def data_of(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((SUITE / f"{name}.yaml").read_text())
    return found


def write(folder: Path, change: Callable[[dict[str, Any]], object]) -> str:
    """A changed copy of the task doorway."""
    data = data_of("benchmark/doorway")
    change(data)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return str(path)


@pytest.mark.parametrize("name", task_names())
def test_a_task_needs_no_other_file_and_starts_by_its_seed(name: str) -> None:
    task = load_scenario(name)
    for platform, section in data_of(name)["platforms"].items():
        assert section["extends"] is None
        whole = msgspec.to_builtins(Layered(*platform_sources(platform)).build(PlatformFile))
        own = msgspec.to_builtins(msgspec.convert(section, PlatformFile))
        for data in (whole, own):
            data |= {f"protection.{key}": value for key, value in data.pop("protection").items()}
        same = {key for key in whole if key.rpartition(".")[2] not in DECLARED}
        assert {key: own[key] for key in same} == {key: whole[key] for key in same}
    np.testing.assert_array_equal(task.starts(7), task.starts(7))
    groups = task.effective["groups"].values()
    has_rule = any(group["start"]["layout"] == "random" for group in groups)
    assert has_rule == (task.starts(7) != task.starts(8)).any()


def test_the_suite_has_ten_tasks_with_a_metric_each() -> None:
    metrics = {metric_of(load_scenario(name).effective["metric"]).name for name in task_names()}
    assert len(task_names()) == len(metrics) == 10


def test_the_pattern_runs_with_its_parameters_in_the_groups_that_have_none() -> None:
    swap = load_scenario("benchmark/antipodal_swap", {"pattern": "patrol"}).effective["groups"]
    assert swap["r1"]["parameters"] == {"recovery": True, "places": "-1.5 0, -1.5 0"}
    assert swap["r3"]["parameters"] == {"recovery": True, "places": "0 -1.5, 0 -1.5"}
    chosen = {"pattern": "levy_walk"}
    pursuit = load_scenario("benchmark/pursuit", chosen).effective["groups"]
    assert (pursuit["pursuers"]["pattern"], pursuit["evaders"]["pattern"]) == (
        "levy_walk", "dispersion",
    )  # fmt: skip


def test_an_override_is_stronger_than_the_parameters_of_the_pattern() -> None:
    chosen = {"pattern": "phototaxis", "groups.team.parameters.bright": 3.5}
    shelter = load_scenario("benchmark/shelter", chosen)
    assert shelter.effective["groups"]["team"]["parameters"] == {"bright": 3.5}
    again = scenario_of(shelter.effective)
    assert again.effective == shelter.effective


def test_a_pattern_that_does_not_fit_is_named_with_what_is_missing() -> None:
    misfits: list[str] = []
    assert plan_of_task("benchmark/doorway", [0], ["foraging"], on_misfit=misfits.append) is None
    (misfit,) = misfits
    assert "doorway" in misfit
    assert "gripper" in misfit
    assert "reading:food" in misfit
    assert "\n" not in misfit
    found = plan_of_task("benchmark/foraging", [0], ["foraging"], on_misfit=misfits.append)
    assert found is not None
    assert len(misfits) == 1
    with pytest.raises(UnknownPatternError, match="foragin"):
        plan_of_task("benchmark/foraging", [0], ["foragin"])


def test_without_patterns_those_of_the_file_are_swept() -> None:
    found = plan_of_task("benchmark/best_of_n", [0, 1])
    assert found is not None
    plan, metric = found
    assert metric.name == "share_reporting:opinion:1"
    assert plan.sweep == {
        "pattern": ["best_of_n", "cross_inhibition", "majority_rule", "voter_model"]
    }
    assert len(plan.runs) == 8


def test_overrides_hold_in_every_run_of_a_task_and_leave_the_pattern_to_its_option() -> None:
    found = plan_of_task("benchmark/doorway", [0], values={"duration": 7.0})
    assert found is not None
    plan, _ = found
    assert [variant.effective["duration"] for variant in plan.variants] == [7.0] * len(
        plan.variants
    )
    with pytest.raises(ConfigError, match="--pattern"):
        plan_of_task("benchmark/doorway", [0], values={"pattern": "patrol"})
    with pytest.raises(ConfigError, match="plugin_dir"):
        plan_of_task("benchmark/doorway", [0], [], Path("mine"), values={"plugin_dir": "yours"})


def results_of(metric: str, values: Mapping[str, Sequence[float | None]]) -> Results:
    """Results of a task: the metric by pattern, in runs with the seeds 0, 1, .."""
    variants = tuple(
        Variant(f"pattern={name}", {"pattern": name}, {"metric": metric}) for name in values
    )
    plan = Plan("benchmark/x", tuple(range(max(map(len, values.values())))), variants)
    rows = [
        Row(run, {metric: values[run.variant.values["pattern"]][run.seed]}, 1.0)
        for run in plan.runs
        if run.seed < len(values[run.variant.values["pattern"]])
    ]
    return Results(Path("x"), plan, rows, {}, (metric,))


@pytest.mark.parametrize(
    ("metric", "values", "ranks"),
    [
        ("clearance", {"a": [9, 9], "b": [1, 3], "c": [2, 2], "d": [math.nan]}, {"a": 1}),
        ("hardest_contact", {"a": [9, 9], "b": [1, 3], "c": [2, 2], "d": [math.nan]}, {"a": 3}),
        ("clearance", {"a": [9, 9], "b": [8, 8], "c": [2, 3]}, {"a": 1, "b": 2, "c": 3}),
        ("clearance", {"a": [9, 9], "b": [1]}, {}),  # one run has no interval
    ],
    ids=["more is better", "less is better", "all", "one run"],
)
def test_ranks_follow_the_direction_where_no_intervals_overlap(
    metric: str, values: Mapping[str, Sequence[float]], ranks: Mapping[str, int]
) -> None:
    found = standings(results_of(metric, values))
    assert {one.pattern for one in found} == values.keys()
    assert {one.pattern: one.rank for one in found if one.rank is not None} == ranks


def test_the_best_stand_first_and_equal_medians_by_name() -> None:
    values: dict[str, list[float | None]] = {
        "far": [1.0, 1.0], "near": [0.5, 0.6], "also": [0.5, 0.6], "none": [None, None],
    }  # fmt: skip
    found = standings(results_of("hardest_contact", values))
    assert [one.pattern for one in found] == ["also", "near", "far", "none"]
    assert [one.rank for one in found] == [None, None, 3, None]
    unit = metric_of("hardest_contact").unit
    assert row(found[0], ".3g") == ("x", "-", "also", "0.55", "0.5 to 0.6", unit, "2")
    assert row(found[2], ".2f") == ("x", "3", "far", "1.00", "1.00 to 1.00", unit, "2")
    assert row(found[3], ".3g") == ("x", "-", "none", "-", "-", unit, "0 of 2")


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "an unknown metric": (lambda d: d.update(metric="share_of"), "share_of"),
    "no metric": (lambda d: d.pop("metric"), "metric is None"),
    "a metric of a file": (lambda d: d.update(metric=f"{__file__}:run"), "no file"),
    "a metric without a direction": (lambda d: d.update(metric="report:x"), "direction"),
    "no group without a pattern": (
        lambda d: d["groups"]["team"].update(pattern="drive"), "each group has a pattern",
    ),
    "an unknown group": (lambda d: d["patterns"]["patrol"].update({"tem.reach": 1}), "'tem'"),
    "an unknown parameter": (lambda d: d["patterns"]["patrol"].update(reech=1), "reech"),
    "a pattern that does not fit": (lambda d: d["patterns"].update(foraging={}), "gripper"),
    "robots outside the walls": (
        lambda d: d["arena"].update(segments=[{"from": [9, 0], "to": [0, 0]}]), "9",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_task_is_one_line_with_its_name(tmp_path: Path, fault: str) -> None:
    change, subject = FAULTS[fault]
    with pytest.raises(ConfigError) as refusal:
        plan_of_task(write(tmp_path, change), [0])
    assert "mine.yaml: " in str(refusal.value)
    assert subject in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_task_without_patterns_is_named(tmp_path: Path) -> None:
    lines: list[str] = []
    path = write(tmp_path, lambda data: data.pop("patterns"))
    assert plan_of_task(path, [0], on_misfit=lines.append) is None
    (line,) = lines
    assert "mine.yaml" in line
    assert "--pattern" in line


def _short(data: dict[str, Any]) -> None:
    data["duration"] = 1.0
    data["groups"]["team"]["count"] = 1
    data["patterns"] = {"drive": {}, "random_walk": {}}


@pytest.mark.integration
@pytest.mark.long
def test_bench_prints_one_table_and_resumes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["bench", write(tmp_path, _short), "--seeds", "2", "--out", str(out), "-j", "1"]
    done = CliRunner().invoke(exp, words)
    assert done.exit_code == 0, done.output
    head, *rows = [line.split() for line in done.stdout.splitlines()]
    assert head[:3] == ["TASK", "RANK", "PATTERN"]
    assert [(one[0], one[2]) for one in rows] == [("mine", "drive"), ("mine", "random_walk")]
    assert "only 2 runs" in done.stderr
    assert "4 of 4 runs done" in done.stderr
    made = (out / "mine" / "runs.csv").read_bytes()
    rerun = CliRunner().invoke(exp, [*words, "-o", "json"])
    assert rerun.exit_code == 0
    assert (out / "mine" / "runs.csv").read_bytes() == made
    listed = json.loads(rerun.stdout)["results"]
    assert [(one["task"], one["pattern"], one["summary"]["n"]) for one in listed] == [
        ("mine", "drive", 2), ("mine", "random_walk", 2),
    ]  # fmt: skip


@pytest.mark.integration
@pytest.mark.long
def test_a_pattern_that_fails_in_each_robot_is_no_result_of_bench(tmp_path: Path) -> None:
    """One run, so that no trial of its first second refuses it before."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "broken.py").write_text(
        "from swarmd.api import Inputs, MovementPattern, Params, Twist\n\n"
        "class Broken(MovementPattern[Params]):\n"
        "    def drive(self, inputs: Inputs) -> Twist:\n"
        "        raise ValueError('no way')\n"
    )
    words = ["bench", write(tmp_path, _short), "--pattern", str(mine / "broken.py")]
    done = CliRunner().invoke(
        exp, [*words, "--seeds", "1", "-j", "1", "--out", str(tmp_path / "out")]
    )
    assert done.exit_code == 1
    assert "no way" in done.stderr


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["dorway"], "benchmark/doorway"),
        (["doorway", "doorway"], "twice"),
        (["doorway", str(SUITE / "benchmark" / "doorway.yaml")], "twice"),
        (["doorway", "--pattern", "foraging"], "--pattern"),
        (["doorway", "--pattern", "mine.py"], "no such file"),
        (["doorway", "--seeds", "x"], "--seeds"),
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

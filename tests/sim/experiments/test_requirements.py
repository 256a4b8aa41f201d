"""Requirements: what they compare, what they refuse, and when an experiment passes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.manifest import manifest_of
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.requirements import check, parse_requirement
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.store import Row, open_store

VALUES: list[float | None] = [1.0, 2.0, 3.0, 10.0]


def side(metric: str, values: list[float | None], lost: int = 0) -> Side:
    """A variant whose metric has these values; of `lost` further seeds there is no run."""
    plan = Plan("x", tuple(range(len(values) + lost)), (Variant("", {}, {}),))
    runs = zip(plan.runs, values, strict=False)
    rows = [Row(run, {metric: value}, 0.1) for run, value in runs]
    return Side("x", Results(Path("x"), plan, rows, {}, (metric,)), "")


def is_met(
    text: str, metric: str = "minimum_gap", values: list[float | None] | None = None
) -> bool:
    some = [*VALUES] if values is None else values
    return check(parse_requirement(text), side(metric, some)).is_met


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("minimum_gap >= 4", True),  # the mean
        ("minimum_gap>4", False),
        ("mean(minimum_gap) == 4.0", True),
        ("median(minimum_gap) <= 2.5", True),
        ("median(minimum_gap) < 2.5", False),
        ("min( minimum_gap ) >= 1e0", True),
        ("max(minimum_gap) < 10", False),
        ("runs >= 4", True),
        ("runs > 4", False),
        ("minimum_gap < inf", True),
    ],
)
def test_a_requirement_compares_a_statistic(text: str, expected: bool) -> None:
    assert is_met(text) is expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "minimum_gap",
        "minimum_gap >= ",
        "minimum_gap => 3",
        "minimum_gap = 3",
        "minimum_gap != 3",
        "minimum_gap= >= 3",
        "minimum_gap >= much",
        "minimum_gap >= nan",
        "mode(minimum_gap) >= 3",
        "median minimum_gap >= 3",
        "median(minimum_gap >= 3",
        ">= 3",
        "1 <= minimum_gap <= 3",
    ],
)
def test_a_malformed_requirement_is_refused_by_its_text(text: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_requirement(text)
    assert repr(text) in str(error.value)


@pytest.mark.parametrize("name", ["report:value.mean_end", "report:state=wait", "warm.py:warm"])
@pytest.mark.parametrize("form", ["median({}) == 3", "{}==3", "{} > 3"])
def test_the_name_of_a_metric_may_hold_marks(name: str, form: str) -> None:
    assert parse_requirement(form.format(name)).metric == name


def test_an_unknown_metric_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="minimum_gap"):
        is_met("minimum_gaps > 3")


def test_a_time_that_some_runs_never_had_has_a_median_and_no_mean() -> None:
    times = [10.0, 20.0, 30.0, None]
    assert is_met("median(gather_time) <= 25", "gather_time", times)
    found = check(parse_requirement("gather_time <= 1000"), side("gather_time", times))
    assert not found.is_met
    assert found.value is None
    assert "1 of 4" in found.remark


def test_a_metric_without_a_value_meets_no_requirement() -> None:
    none: list[float | None] = [None, None]
    for text in ("minimum_gap > -inf", "minimum_gap < inf", "median(minimum_gap) < inf"):
        assert not is_met(text, values=none)


def test_an_experiment_that_lacks_runs_is_not_complete() -> None:
    assert side("minimum_gap", [*VALUES]).results.lacking == ""
    assert "4 of 6" in side("minimum_gap", [*VALUES], lost=2).results.lacking


@pytest.fixture
def folder(tmp_path: Path, duo: Path) -> Path:
    """An experiment of two variants and two seeds, of which no run was simulated."""
    plan = plan_of(str(duo), (0, 1), {}, {"groups.all.parameters.speed": (0.1, 0.2)})
    manifest = manifest_of(plan, traces=False, command=[])
    with open_store(tmp_path / "kept", manifest, ("minimum_gap",)) as store:
        for run, gap in zip(plan.runs, np.linspace(0.1, 0.4, len(plan.runs)), strict=True):
            store.add(run, {"minimum_gap": float(gap)}, 0.1)
    return tmp_path / "kept"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["minimum_gap >= 0.1", "runs >= 2"], 0),
        (["minimum_gap >= 0.2"], 1),
        (["minimum_gap >= 0.1", "runs >= 3"], 1),
    ],
)
def test_the_exit_code_and_the_answer_tell_whether_all_are_met(
    folder: Path, words: list[str], code: int
) -> None:
    done = CliRunner().invoke(exp, ["check", str(folder), *words, "-o", "json"])
    assert done.exit_code == code, done.output
    document = json.loads(done.stdout)
    assert document["passed"] is (code == 0)
    assert len(document["requirements"]) == 2 * len(words)  # of each variant
    assert all(one["met"] for one in document["requirements"]) is (code == 0)
    assert CliRunner().invoke(exp, ["check", str(folder), *words]).exit_code == code


def test_the_requirements_of_an_experiment_that_lacks_runs_are_met_so_far(
    tmp_path: Path, duo: Path
) -> None:
    plan = plan_of(str(duo), (0, 1), {}, {})
    with open_store(tmp_path / "x", manifest_of(plan, traces=False, command=[]), ("gap",)) as store:
        store.add(plan.runs[0], {"gap": 0.1}, 0.1)
    done = CliRunner().invoke(exp, ["check", str(tmp_path / "x"), "runs >= 1"])
    assert done.exit_code == 1
    *_, missing, met = done.output.splitlines()
    assert "1 of 2 runs" in missing
    assert met == "1 of 1 requirement met so far"

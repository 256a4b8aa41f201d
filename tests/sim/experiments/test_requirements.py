"""Requirements: what they compare, what they refuse, and when an experiment passes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.manifest import manifest_of
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.requirements import (
    RequirementFinding,
    Verdict,
    check,
    parse_requirement,
)
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


def found(
    text: str, metric: str = "minimum_gap", values: list[float | None] | None = None
) -> RequirementFinding:
    some = [*VALUES] if values is None else values
    return check(parse_requirement(text), side(metric, some))


def verdict(
    text: str, metric: str = "minimum_gap", values: list[float | None] | None = None
) -> Verdict:
    return found(text, metric, values).verdict


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # The mean is 4 and the median 2.5; an interval of either is within 1 to 10.
        ("minimum_gap >= 4", "undecided"),
        ("minimum_gap>0.9", "met"),
        ("minimum_gap >= 10.1", "not met"),
        ("mean(minimum_gap) == 4.0", "undecided"),
        ("mean(minimum_gap) == 11", "not met"),
        ("median(minimum_gap) <= 2.5", "undecided"),
        ("median(minimum_gap) <= 10", "met"),
        ("median(minimum_gap) < 0.9", "not met"),
        # Numbers of the runs alone.
        ("min( minimum_gap ) >= 1e0", "met"),
        ("max(minimum_gap) < 10", "not met"),
        ("max(minimum_gap) == 10", "met"),
        ("runs >= 4", "met"),
        ("runs > 4", "not met"),
        ("minimum_gap < inf", "met"),
        ("max(minimum_gap+minimum_gap) <= 20", "met"),
        ("max(minimum_gap+minimum_gap) < 20", "not met"),
        ("share(minimum_gap) >= 0", "not met"),  # it is no share
    ],
)
def test_the_interval_of_a_statistic_is_compared(text: str, expected: str) -> None:
    assert verdict(text) == expected


@pytest.mark.parametrize(
    ("ones", "runs", "text", "expected"),
    [
        # Wilson's interval of n of n begins at n / (n + 3.8415), and of 0 of n ends at the rest.
        (5, 5, ">= 0.8", "undecided"),  # .566
        (15, 15, ">= 0.8", "undecided"),  # .796
        (16, 16, ">= 0.8", "met"),  # .806
        (20, 20, ">= 0.9", "undecided"),  # .839
        (35, 35, "> 0.9", "met"),  # .901
        (0, 1, "<= 0.5", "undecided"),  # up to .7935
        (0, 4, "<= 0.5", "met"),  # up to .490
        (0, 5, ">= 0.8", "not met"),  # up to .434
        (3, 5, "== 0.5", "undecided"),
        (20, 20, "== 0.5", "not met"),
    ],
)
def test_the_interval_of_a_share_decides(ones: int, runs: int, text: str, expected: str) -> None:
    values = [1.0] * ones + [0.0] * (runs - ones)
    one = found(f"one_cluster_at_end {text}", "one_cluster_at_end", [*values])
    assert one.verdict == expected
    assert one.is_sure is (expected == "met")


@pytest.mark.parametrize(("runs", "is_sure"), [(2, False), (9, False), (10, True)])
def test_a_bootstrap_interval_of_few_runs_is_not_sure(runs: int, is_sure: bool) -> None:
    one = found("minimum_gap >= 0.1", values=[0.2, *[0.3] * (runs - 1)])
    assert one.verdict is Verdict.MET
    assert one.is_sure is is_sure


def test_the_mean_of_one_run_decides_nothing() -> None:
    assert verdict("minimum_gap >= 0.1", values=[0.2]) is Verdict.UNDECIDED


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        # Of 20 times, the median lies between the 6th and the 15th in 95 % (Conover 1999).
        ([*range(1, 18), None, None, None], "met"),
        ([*range(1, 15), *[None] * 6], "undecided"),  # the 15th has not happened
        ([*range(14, 19), *[None] * 15], "not met"),  # nor has the 6th
        ([1.0, 2.0, 3.0, 4.0, None], "undecided"),  # five cannot give 95 %
    ],
)
def test_the_median_of_times_that_some_runs_never_had_has_an_interval(
    times: list[float | None], expected: str
) -> None:
    assert verdict("median(gather_time) <= 15", "gather_time", times) == expected


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
        found("minimum_gaps > 3")


def test_an_end_of_an_interval_that_is_never_is_null_in_json() -> None:
    times: list[float | None] = [*range(1, 15), *[None] * 6]
    document = found("median(gather_time) <= 15", "gather_time", times).document()
    assert json.loads(json.dumps(document, allow_nan=False))["interval"] == [6.0, None]


def test_a_time_that_some_runs_never_had_has_no_mean() -> None:
    one = found("gather_time <= 1000", "gather_time", [10.0, 20.0, 30.0, None])
    assert one.verdict is Verdict.NOT_MET
    assert one.value is None
    assert "1 of 4" in one.remark


def test_a_metric_without_a_value_meets_no_requirement() -> None:
    none: list[float | None] = [None, None]
    for text in ("minimum_gap > -inf", "minimum_gap < inf", "median(minimum_gap) < inf"):
        assert verdict(text, values=none) is Verdict.NOT_MET


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
    ("words", "code", "verdicts"),
    [
        # The gaps are 0.1 and 0.2 with one speed, 0.3 and 0.4 with the other.
        (["minimum_gap >= 0.05", "runs >= 2"], 0, ["met"] * 4),
        (["minimum_gap >= 0.25"], 1, ["not met", "met"]),
        (["minimum_gap >= 0.15"], 0, ["undecided", "met"]),
        (["minimum_gap >= 0.15", "--sure"], 1, ["undecided", "met"]),
        (["minimum_gap >= 0.05", "--sure"], 1, ["met", "met"]),  # of few runs
        (["min(minimum_gap) >= 0.05", "--sure"], 0, ["met", "met"]),
        (["minimum_gap >= 0.05", "runs >= 3"], 1, ["met", "not met"] * 2),
    ],
)
def test_the_exit_code_is_1_only_where_an_interval_excludes_a_requirement(
    folder: Path, words: list[str], code: int, verdicts: list[str]
) -> None:
    done = CliRunner().invoke(exp, ["check", str(folder), *words, "-o", "json"])
    assert done.exit_code == code, done.output
    document = json.loads(done.stdout)
    assert document["passed"] is (code == 0)
    assert [one["verdict"] for one in document["requirements"]] == verdicts
    assert [one["met"] for one in document["requirements"]] == [v == "met" for v in verdicts]
    shown = CliRunner().invoke(exp, ["check", str(folder), *words])
    assert shown.exit_code == code
    lines = shown.stdout.splitlines()[1 : 1 + len(verdicts)]
    assert [re.split(r"  +", line)[-1] for line in lines] == verdicts


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

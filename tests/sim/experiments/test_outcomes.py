"""Files of outcomes: what their rows say, what they refuse, and when a bound is met."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.plugins import pattern_folders
from swarmd.sim.experiments import outcomes as outcomes_module
from swarmd.sim.experiments.outcomes import (
    NAME,
    OutcomeFinding,
    Outcomes,
    judge,
    judged_folder,
    left_out_seeds,
    outcomes_file,
    read_outcomes,
    samples_of,
)
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.requirements import Verdict
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row as RunRow

HEAD = "scenario: drive\nseeds: 3\n"
ROW = '  - {what: way, requirement: max(path_length) <= 2, source: "ours: why"}\n'
TWO = "runs: {own: {}, other: {set: {duration: 5}}}\n"
WITH_SHIPPED = sorted(
    name for name, folder in pattern_folders().items() if (folder.path / NAME).is_file()
)


def read(folder: Path, text: str) -> Outcomes:
    path = folder / NAME
    path.write_text(text)
    return read_outcomes(path)


def row_of(**keys: object) -> str:
    """A file with one row and two kinds of runs."""
    given = {"what": "way", "requirement": "max(path_length) <= 2", "source": "ours", **keys}
    inside = ", ".join(f"{key}: {value}" for key, value in given.items() if value is not None)
    return f"{HEAD}{TWO}outcomes:\n  - {{{inside}}}\n"


def test_a_row_names_runs_a_bound_and_its_origin(tmp_path: Path) -> None:
    outcomes = read(
        tmp_path,
        "scenario: mine.yaml\n"
        "set: {duration: 40, groups.tb3.count: 5}\n"
        "runs:\n"
        "  own: {seeds: 0-4}\n"
        "  walkers:\n"
        "    set: {groups.tb3.count: 2, groups.tb3.pattern: random_walk}\n"
        "    sweep: {a.b: [1]}\n"
        "outcomes:\n"
        "  - {what: way, runs: own, requirement: min(path_length) >= 3, source: a paper}\n"
        "  - {what: r, runs: own, requirement: mean(path_length) >= 2, over: walkers, source: s}\n",
    )
    own, walkers = outcomes.runs["own"], outcomes.runs["walkers"]
    assert (own.scenario, own.seeds) == (str(tmp_path / "mine.yaml"), (0, 1, 2, 3, 4))
    assert own.sets == {"duration": 40, "groups.tb3.count": 5}
    assert walkers.sets == {
        "duration": 40,
        "groups.tb3.count": 2,
        "groups.tb3.pattern": "random_walk",
    }
    assert (len(walkers.seeds), walkers.sweep) == (20, {"a.b": [1]})
    way, ratio = outcomes.rows
    assert (way.what, way.source, way.runs) == ("way", "a paper", ("own",))
    assert (way.requirement.statistic, way.requirement.value) == ("min", 3.0)
    assert way.other is None
    assert ratio.other is not None
    assert (ratio.other.kind, ratio.other.runs) == ("over", ("walkers",))
    assert ratio.other.metric == "path_length"


def test_a_file_without_names_of_runs_has_one_kind(tmp_path: Path) -> None:
    outcomes = read(tmp_path, f"{HEAD}outcomes:\n{ROW}")
    assert list(outcomes.runs) == ["runs"]
    assert outcomes.rows[0].runs == ("runs",)


def test_paths_begin_at_the_folder_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def ends(trace):\n    return float(trace.t[-1])\n")
    outcomes = read(
        tmp_path,
        "scenario: drive\nset: {groups.tb3.pattern: ./mine.py, plugin_dir: ..}\n"
        "outcomes:\n  - {what: a, requirement: max(own.py:ends) <= 2, source: ours}\n",
    )
    sets = outcomes.runs["runs"].sets
    assert sets["groups.tb3.pattern"] == str(tmp_path / "mine.py")
    assert Path(sets["plugin_dir"]).resolve() == tmp_path.parent.resolve()
    (metric,) = outcomes.metrics("runs")
    assert (metric.name, metric.origin) == ("own.py:ends", f"{tmp_path / 'own.py'}:ends")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "outcomes is missing"),
        ("[1]", "expected keys and values"),
        ("a: &x 1\n", f"{NAME}:1:"),
        (f"{HEAD}outcomes: []", "at least one row"),
        (f"outcomes:\n{ROW}", "scenario is missing"),
        (f"{HEAD}sett: {{}}\noutcomes:\n{ROW}", "did you mean 'set'"),
        (f"scenario: drive\nseeds: 1.5\noutcomes:\n{ROW}", "seeds"),
        (f"scenario: drive\nseeds: 5-3\noutcomes:\n{ROW}", "5-3"),
        (f"{HEAD}set: {{a..b: 1}}\noutcomes:\n{ROW}", "a..b"),
        (f"{HEAD}sweep: {{a: 1}}\noutcomes:\n{ROW}", "sweep.a"),
        (f"{HEAD}runs: {{../x: {{}}}}\noutcomes:\n{ROW}", "'../x' is no name"),
        (f"{HEAD}{TWO}outcomes:\n{ROW}", "expected one of own, other"),
        (row_of(runs="own"), "no row needs these runs"),
        (row_of(runs="oter"), "did you mean 'other'"),
        (row_of(runs="own", source=None), "source is missing"),
        (row_of(runs="own", source='" "'), "expected the origin of the bound"),
        (row_of(runs="own", what='""'), "expected the number in words"),
        (row_of(runs="own", requirement="max(a) =< 2"), "expected one such as"),
        (row_of(runs="own", requirement="most(a) <= 2"), "'most'"),
        (row_of(runs="own", requirment="max(a) <= 2"), "did you mean 'requirement'"),
        (row_of(runs="own", over="own"), "compared with itself"),
        (row_of(runs="own", over="{}"), "expected runs, a metric, or both"),
        (row_of(runs="own", over="other", less="other"), "keep one of them"),
        (row_of(runs="own", over="other", requirement="median(a) <= 2"), "mean, min and max"),
        (row_of(runs="own", if_known=2), "true or false"),
        (row_of(runs="[]"), "expected names"),
        (row_of(runs="[own, own]"), "each of them once"),
        (row_of(runs="[own, oter]"), "did you mean 'other'"),
        (row_of(runs="[own, other]", over="other"), "take the mean"),
        (row_of(runs="own", over="other", requirement="runs >= 3"), "number of runs"),
        (row_of(runs="own", over="{metric: runs}"), "number of runs"),
    ],
)
def test_a_wrong_file_is_an_error_that_names_it(text: str, wanted: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    line = str(caught.value)
    assert str(tmp_path / NAME) in line
    assert wanted in line
    assert "\n" not in line


def test_runs_that_are_compared_one_by_one_have_the_same_seeds(tmp_path: Path) -> None:
    seeds = row_of(runs="own", over="other").replace("other: {set", "other: {seeds: 4, set")
    with pytest.raises(ConfigError, match="not the same seeds"):
        read(tmp_path, seeds)
    read(tmp_path, seeds.replace("max(path_length)", "mean(path_length)"))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (row_of(runs="other", requirement="max(path_lenth) <= 2", over="own"), "'path_length'"),
        (row_of(runs="own", over="other", requirement="max(none.py:a) <= 2"), "none.py"),
    ],
)
def test_an_unknown_metric_names_the_row(text: str, wanted: str, tmp_path: Path) -> None:
    outcomes = read(tmp_path, text)
    with pytest.raises(ConfigError, match=r"outcomes\[0\]") as caught:
        outcomes.metrics(outcomes.rows[0].runs[0])
    assert wanted in str(caught.value)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"scenario: drive": "scenario: driv"}, "'drive'"),
        ({"seeds: 3\n": "seeds: 3\nset: {durtion: 5}\n"}, "did you mean 'duration'"),
        ({"seeds: 3\n": "seeds: 3\nset: {groups.tb4.count: 5}\n"}, "group"),
        ({"seeds: 3\n": "seeds: 3\nset: {duration: long}\n"}, "duration"),
    ],
)
def test_runs_that_cannot_be_are_refused_with_the_file(
    change: Mapping[str, str], wanted: str, tmp_path: Path
) -> None:
    text = f"{HEAD}outcomes:\n{ROW}"
    for old, new in change.items():
        text = text.replace(old, new)
    outcomes = read(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        outcomes.plan("runs")
    assert str(caught.value).startswith(f"{tmp_path / NAME}: runs runs")
    assert wanted in str(caught.value)


def test_seeds_of_the_command_line_replace_those_of_the_file(tmp_path: Path) -> None:
    outcomes = read(tmp_path, f"{HEAD}outcomes:\n{ROW}")
    assert len(outcomes.plan("runs").runs) == 3
    assert [run.seed for run in outcomes.plan("runs", (7,)).runs] == [7]


def test_the_file_of_a_shipped_pattern_has_a_short_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = outcomes_file("dispersion/outcomes.yaml")
    assert file == pattern_folders()["dispersion"].path / NAME
    with pytest.raises(ConfigError, match="did you mean 'dispersion'"):
        outcomes_file("dispersoin/outcomes.yaml")
    with pytest.raises(ConfigError, match="dispersion"):
        outcomes_file("best_of_n/outcomes.yaml")  # theory, in Python
    with pytest.raises(ConfigError, match="no such file"):
        outcomes_file("outcomes.yaml")


@pytest.mark.parametrize("pattern", WITH_SHIPPED)
def test_the_rows_of_a_shipped_pattern_can_be_run(pattern: str) -> None:
    outcomes = read_outcomes(pattern_folders()[pattern].path / NAME)
    assert len(outcomes.rows) >= 2
    for name in outcomes.runs:
        assert outcomes.metrics(name)
        assert len(outcomes.plan(name, (0,)).runs) >= 1


def results_of(metric: str, *values: float | None) -> Results:
    plan = Plan("x", tuple(range(len(values))), (Variant("", {}, {}),))
    rows = [
        RunRow(run, {metric: value, "arena_contacts": 1.0}, 0.1)
        for run, value in zip(plan.runs, values, strict=True)
    ]
    return Results(Path("x"), plan, rows, {}, (metric, "arena_contacts"))


def judged(
    folder: Path,
    requirement: str,
    own: Results,
    other: Results | None = None,
    **keys: object,
) -> OutcomeFinding:
    needed = {"less": "other"} if other is not None and "over" not in keys else {}
    text = row_of(runs="own", requirement=requirement, **{**needed, **keys})
    if other is None:
        text = text.replace(TWO, "runs: {own: {}}\n")
    (row,) = read(folder, text).rows
    return judge(row, {"own": own, **({} if other is None else {"other": other})})


# Four runs with 1, 2, 3, 10: their mean is 4; every resampled mean is within 1 to 10.
FOUR = (1.0, 2.0, 3.0, 10.0)


@pytest.mark.parametrize(
    ("requirement", "verdict", "value"),
    [
        ("max(minimum_gap) <= 10", "met", 10.0),
        ("max(minimum_gap) < 10", "not met", 10.0),
        ("min(minimum_gap) >= 1.5", "not met", 1.0),
        ("mean(minimum_gap) >= 0.5", "met", 4.0),
        ("mean(minimum_gap) >= 4", "undecided", 4.0),
        ("mean(minimum_gap) >= 11", "not met", 4.0),
        ("median(minimum_gap) <= 11", "met", 2.5),
        ("max(minimum_gap+arena_contacts) <= 11", "met", 11.0),
        ("max(minimum_gap+arena_contacts) <= 10", "not met", 11.0),
    ],
)
def test_each_run_or_the_interval_decides(
    requirement: str, verdict: str, value: float, tmp_path: Path
) -> None:
    found = judged(tmp_path, requirement, results_of("minimum_gap", *FOUR))
    assert (found.finding.verdict, found.finding.value) == (verdict, value)
    assert found.document()["source"] == "ours"


def test_a_run_without_a_value_misses_a_bound_unless_the_row_asks_the_others(
    tmp_path: Path,
) -> None:
    results = results_of("minimum_gap", 1.0, None, 2.0)
    for requirement in ("max(minimum_gap) <= 5", "mean(minimum_gap) <= 5"):
        found = judged(tmp_path, requirement, results)
        assert found.finding.verdict is Verdict.NOT_MET
        assert "1 run" in found.finding.remark
        others = judged(tmp_path, requirement, results, if_known="true")
        assert others.finding.verdict is Verdict.MET
    nothing = judged(
        tmp_path, "max(minimum_gap) <= 5", results_of("minimum_gap", None), if_known="true"
    )
    assert nothing.finding.verdict is Verdict.NOT_MET


def test_an_event_that_never_happens_is_later_than_each_bound(tmp_path: Path) -> None:
    times = results_of("gather_time", 10.0, 20.0, None)
    late = judged(tmp_path, "max(gather_time) <= 60", times)
    assert late.finding.verdict is Verdict.NOT_MET
    median = judged(tmp_path, "median(gather_time) <= 60", times)
    assert (median.finding.value, median.finding.verdict) == (20.0, Verdict.UNDECIDED)


def test_shares_are_of_runs_for_which_a_metric_is_one(tmp_path: Path) -> None:
    some = results_of("one_cluster_at_end", 1.0, 1.0, 1.0, 0.0)
    found = judged(tmp_path, "share(one_cluster_at_end) >= 0.1", some)
    assert found.finding.value == 0.75
    assert found.finding.interval is not None
    # Wilson's score interval of 3 of 4 (Wilson 1927): (0.301, 0.954).
    assert found.finding.interval == pytest.approx((0.3006, 0.9544), abs=1e-3)
    with pytest.raises(ConfigError, match="0 or 1"):
        judged(tmp_path, "share(minimum_gap) >= 0.1", results_of("minimum_gap", 0.5, 1.0))


def test_two_kinds_of_runs_are_compared_by_means_or_run_by_run(tmp_path: Path) -> None:
    own, other = results_of("minimum_gap", 6.0, 4.0), results_of("minimum_gap", 2.0, 3.0)
    less = judged(tmp_path, "min(minimum_gap) >= 1", own, other)
    assert (less.finding.value, less.finding.verdict) == (1.0, Verdict.MET)  # 6 - 2, 4 - 3
    over = judged(tmp_path, "max(minimum_gap) <= 2.5", own, other, over="other")
    assert (over.finding.value, over.finding.verdict) == (3.0, Verdict.NOT_MET)  # 6 / 2
    means = judged(tmp_path, "mean(minimum_gap) >= 1", own, other, over="other")
    assert (means.finding.value, means.finding.verdict) == (2.0, Verdict.MET)  # 5 / 2.5
    difference = judged(tmp_path, "mean(minimum_gap) >= 1", own, other)
    assert difference.finding.value == 2.5


def test_runs_of_several_names_are_taken_together(tmp_path: Path) -> None:
    (row,) = read(tmp_path, row_of(runs="[own, other]", requirement="max(minimum_gap) <= 3")).rows
    results = {"own": results_of("minimum_gap", 6.0), "other": results_of("minimum_gap", 2.0, 3.0)}
    found = judge(row, results).finding
    assert samples_of(row, results) == ((6.0, 2.0, 3.0),)
    assert (found.variant, found.value, found.verdict) == ("own, other", 6.0, Verdict.NOT_MET)


def test_rows_over_another_metric_of_the_same_runs(tmp_path: Path) -> None:
    own = results_of("minimum_gap", 6.0, 4.0)
    text = row_of(runs="own", requirement="mean(minimum_gap) >= 5", over="{metric: arena_contacts}")
    (row,) = read(tmp_path, text.replace(TWO, "runs: {own: {}}\n")).rows
    assert samples_of(row, {"own": own}) == ((6.0, 4.0), (1.0, 1.0))
    assert judge(row, {"own": own}).finding.value == 5.0


def test_a_folder_without_runs_says_which_are_missing(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text(row_of(runs="own", over="other"))
    findings, missing = judged_folder(tmp_path)
    assert findings == []
    assert missing == "own: no run, other: no run"


@pytest.mark.parametrize(
    ("requirement", "verdict"), [("runs >= 2", "met"), ("runs >= 3", "not met")]
)
def test_a_row_may_ask_a_number_of_runs(requirement: str, verdict: str, tmp_path: Path) -> None:
    own = results_of("minimum_gap", 6.0, 4.0)
    finding = judged(tmp_path, requirement, own).finding
    assert (finding.value, finding.verdict, finding.few) == (2.0, verdict, 0)
    assert read_outcomes(tmp_path / NAME).metrics("own") == []


@pytest.mark.parametrize(
    ("seeds", "is_complete"),
    [((0, 1, 2), True), ((0, 1, 2, 3), True), ((0, 1), False), ((3, 4, 5), False), ((), False)],
)
def test_seeds_of_the_file_that_were_not_run_are_missing(
    seeds: tuple[int, ...], is_complete: bool, tmp_path: Path
) -> None:
    """`exp run FILE --seeds 2` is a quick look: it tries no row of a file with three."""
    outcomes = read(tmp_path, f"{HEAD}outcomes:\n{ROW}")
    assert (left_out_seeds(outcomes, "runs", seeds) == "") is is_complete


def test_a_quick_look_is_no_check_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read(tmp_path, f"{HEAD}outcomes:\n{ROW}")

    def missing(seeds: tuple[int, ...]) -> str:
        plan = Plan("drive", seeds, (Variant("", {}, {}),))
        rows = [RunRow(run, {"path_length": 1.0}, 0.1) for run in plan.runs]
        found = Results(tmp_path / "runs", plan, rows, {}, ("path_length",))
        monkeypatch.setattr(outcomes_module, "load_results", lambda folder: found)
        findings, text = judged_folder(tmp_path)
        assert [one.finding.verdict for one in findings] == [Verdict.MET]
        return text

    (tmp_path / "runs").mkdir()
    assert missing((0, 1, 2)) == ""
    assert missing((0, 1)).startswith("runs: 2 of the 3 seeds")

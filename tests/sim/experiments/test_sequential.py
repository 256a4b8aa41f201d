"""Runs until a requirement is decided: how often it is wrong, and that workers change nothing."""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.manifest import Manifest, manifest_of, read_manifest
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.sequential import (
    BETS,
    SequentialTest,
    bet,
    run_until,
    sides_won,
)
from swarmd.sim.experiments.simulate import Runner, run_experiment
from swarmd.sim.metrics.catalog import METRICS, metric_of

EXPERIMENTS, MOST, ALPHA = 2000, 500, 0.05
METRIC = "one_cluster_at_end"


def sides(values: Array, target: float) -> tuple[Array, Array]:
    """What each experiment of `values` (EXPERIMENTS, MOST) says of its mean, and after how many."""
    capital = np.ones((EXPERIMENTS, 2, BETS))
    answers, runs, left = np.zeros(EXPERIMENTS), np.full(EXPERIMENTS, MOST), np.arange(EXPERIMENTS)
    for number in range(MOST):
        capital = bet(capital, values[left, number], target)
        won = sides_won(capital, ALPHA)
        answers[left], runs[left[won != 0.0]] = won, number + 1
        left, capital = left[won == 0.0], capital[won == 0.0]
    return answers, runs


@pytest.mark.parametrize(
    ("truth", "wrong", "median"),
    [(0.6, 1.0, 10), (0.7, 1.0, 20), (0.8, 1.0, 94), (0.9, -1.0, None), (1.0, -1.0, 69)],
)
def test_a_share_is_decided_wrongly_in_at_most_alpha(
    truth: float, wrong: float, median: int | None
) -> None:
    """The medians are of a trial with a beta(1, 1) mixture for both sides at once."""
    draws = (np.random.default_rng(3).random((EXPERIMENTS, MOST)) < truth).astype(np.float64)
    answers, runs = sides(draws, 0.9)
    assert np.mean(answers == wrong) <= ALPHA
    if median is not None:
        assert np.mean(answers == -wrong) > 0.98
        assert np.median(runs) <= 1.1 * median


@pytest.mark.parametrize("target", [0.5, 0.7])
def test_a_bounded_mean_is_decided_wrongly_in_at_most_alpha(target: float) -> None:
    """Means of 0.5 that are skewed: most values are small, and few near 1 (beta 0.2, 0.2)."""
    draws = np.random.default_rng(4).beta(0.2, 0.2, (EXPERIMENTS, MOST))
    answers, _ = sides(draws, target)
    assert np.mean(answers == 1.0) <= ALPHA
    assert np.mean(answers == -1.0) <= ALPHA or target > 0.5
    assert target == 0.5 or np.mean(answers == -1.0) > 0.98


def decided(text: str, values: Sequence[float | None]) -> SequentialTest:
    test = SequentialTest(text, ALPHA, metric_of)
    for number, value in enumerate(values):
        test.add(str(number), value)
    return test


@pytest.mark.parametrize(
    ("text", "value", "verdict"),
    [
        ("one_cluster_at_end >= 0.9", 1.0, "met"),
        ("one_cluster_at_end > 0.9", 0.0, "not met"),
        ("one_cluster_at_end <= 0.1", 0.0, "met"),
        ("mean(one_cluster_at_end) < 0.1", 1.0, "not met"),
        ("share_in:disc:0:0:1 >= 0.5", 0.5, "undecided"),
        ("report:state=wait >= 0.5", 0.9, "met"),
    ],
)
def test_the_answer_is_that_of_the_comparison(text: str, value: float, verdict: str) -> None:
    assert decided(text, [value] * 60).verdict == verdict


def test_runs_without_a_value_and_after_the_decision_do_not_count() -> None:
    test = decided("one_cluster_at_end >= 0.9", [None, *[0.0] * 20])
    # Against 0.9, the mean over bets of the capital after n zeros is about 10^n / (n + 1).
    assert (test.verdict, test.runs) == ("not met", 2)


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("gather_time <= 60", "gather_time"),
        ("mean_speed >= 0.1", "mean_speed"),
        ("line_unevenness <= 0.1", "line_unevenness"),  # a share of the mean gap, which it exceeds
        ("box_progress:0:0 >= 0.1", "box_progress"),  # below 0 if the box goes away
        ("report:value >= 0.1", "report:value"),
        ("report:state=wait.sum_end >= 0.1", "report:state=wait"),
        ("median(one_cluster_at_end) >= 0.5", "mean"),
        ("one_cluster_at_end == 0.5", "=="),
        ("one_cluster_at_end >= 1", "between 0 and 1"),
        ("one_cluster_at_ends >= 0.5", "one_cluster_at_end"),
    ],
)
def test_what_no_number_of_runs_decides_is_refused(text: str, subject: str) -> None:
    with pytest.raises(ConfigError) as error:
        SequentialTest(text, ALPHA, metric_of)
    assert subject in str(error.value)
    assert "\n" not in str(error.value)


def test_bounds_of_a_metric_of_ones_own_are_taken_and_kept(tmp_path: Path) -> None:
    file = tmp_path / "reward.py"
    file.write_text("def reward(trace): ...\nreward.bounds = (-1, 3)\n")
    test = SequentialTest(f"{file}:reward >= 2", ALPHA, metric_of)
    with pytest.raises(SwarmError, match=r"s0007 is 3\.5"):
        test.add("s0007", 3.5)
    for number in range(60):
        test.add(str(number), 3.0 + 1e-12)  # a sum that is rounded up
    assert test.verdict == "met"


@pytest.mark.parametrize(
    "bounds", ["3", "(0, math.inf)", "(-1e308, 1e308)", "('a', 'b')", "(1, 0)"]
)
def test_bounds_that_bound_nothing_are_refused(tmp_path: Path, bounds: str) -> None:
    file = tmp_path / "reward.py"
    file.write_text(f"import math\ndef reward(trace): ...\nreward.bounds = {bounds}\n")
    with pytest.raises(ConfigError, match="bounds is"):
        metric_of(f"{file}:reward")


def test_a_time_to_an_event_has_no_mean_to_decide(tmp_path: Path) -> None:
    """None means never: the mean over the other runs would improve with each run that fails."""
    file = tmp_path / "far.py"
    lines = ("def far(trace): ...", "far.bounds = (0, 60)", "far.is_time_to_event = True")
    file.write_text("\n".join(lines))
    with pytest.raises(ConfigError, match=r"far\.py:far"):
        SequentialTest(f"{file}:far <= 30", ALPHA, metric_of)


FAILED = frozenset({2})
"""Seeds whose run fails."""


def value_of(seed: int) -> float:
    return float(seed % 2)


def manifest(most: int, *, traces: bool = True) -> Manifest:
    plan = Plan("x", tuple(range(most)), (Variant("", {}, {"duration": 1.0}),))
    return manifest_of(plan, traces=traces, command=[])


def runner(order: Sequence[int], done: list[str] | None = None) -> Runner:
    """Does runs in another order, several at a time: first that with the first number, ..."""

    def run(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for start in range(0, len(jobs), len(order)):
            for number in order:
                for job in jobs[start + number : start + number + 1]:
                    if done is not None:
                        done.append(job.run)
                    yield {job.run: 0.5}
                    if job.seed in FAILED:
                        yield JobResult(job.run, reason="bad")
                        continue
                    assert job.trace is not None
                    job.trace.write_bytes(b"")
                    values = dict.fromkeys(METRICS, 0.0) | {METRIC: value_of(job.seed)}
                    yield JobResult(job.run, values, 0.1)

    return run


def until(
    folder: Path, order: Sequence[int] = (0,), most: int = 40, done: list[str] | None = None
) -> tuple[Results, SequentialTest]:
    test = SequentialTest(f"{METRIC} >= 0.9", ALPHA, metric_of)
    return run_until(test, manifest(most), folder, runner(order, done)), test


def kept(folder: Path) -> SimpleNamespace:
    summary = json.loads((folder / "summary.json").read_text())
    return SimpleNamespace(
        table=(folder / "runs.csv").read_text(),
        traces=sorted(path.stem for path in (folder / "traces").iterdir()),
        seeds=read_manifest(folder).seeds,
        summary=summary,
    )


def by_hand() -> int:
    """The number of seeds that decide `>= 0.9` for 0, 1, (failed), 1, 0, 1, ..."""
    test = SequentialTest(f"{METRIC} >= 0.9", ALPHA, metric_of)
    for seed in range(40):
        test.add(str(seed), None if seed in FAILED else value_of(seed))
        if test.is_open is False:
            return seed + 1
    raise AssertionError


@pytest.mark.parametrize("order", [(1, 0), (3, 1, 2, 0), (7, 6, 5, 4, 3, 2, 1, 0)])
def test_the_folder_does_not_depend_on_the_workers(tmp_path: Path, order: Sequence[int]) -> None:
    results, test = until(tmp_path / "one")
    until(tmp_path / "many", order)
    one, many = kept(tmp_path / "one"), kept(tmp_path / "many")
    assert vars(one) == vars(many)
    seeds = by_hand()
    assert one.seeds == list(range(seeds))
    assert one.summary["until"] == {
        "requirement": f"{METRIC} >= 0.9",
        "alpha": ALPHA,
        "verdict": "not met",
        "runs": seeds - len(FAILED),
    }
    assert [run.seed for run in results.runs] == [s for s in range(seeds) if s not in FAILED]
    assert list(results.failures) == ["s0002"]
    assert one.summary["failed"] == 1
    assert one.traces == [run.id for run in results.runs]
    assert test.verdict == "not met"
    assert "1 failed" in load_results(tmp_path / "one").lacking


def test_an_interrupted_experiment_goes_on_and_a_decided_one_is_not_done_again(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "x"

    def killed(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for number, report in enumerate(runner((1, 0))(jobs)):
            if number == 5:
                raise KeyboardInterrupt
            yield report

    test = SequentialTest(f"{METRIC} >= 0.9", ALPHA, metric_of)
    with pytest.raises(KeyboardInterrupt):
        run_until(test, manifest(40), folder, killed)
    assert [run.seed for run in load_results(folder).runs] == [0, 1]
    done: list[str] = []
    until(folder, done=done)
    assert done[0] == "s0002"
    until(tmp_path / "whole")
    assert vars(kept(folder)) == vars(kept(tmp_path / "whole"))
    done.clear()
    _, again = until(folder, done=done)
    assert again.verdict == "not met"
    assert done == ["s0002"]  # a run that has failed is tried again, as by any `exp run`
    assert vars(kept(folder)) == vars(kept(tmp_path / "whole"))


def test_runs_of_a_folder_count_in_the_order_of_their_seeds(tmp_path: Path) -> None:
    """`exp run` with several workers, interrupted, has left later seeds and not seed 1."""
    folder, seeds = tmp_path / "x", by_hand()

    def interrupted(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for report in runner((0, *range(2, seeds), 1))(jobs):
            if "s0001" in (report if isinstance(report, dict) else ()):
                raise KeyboardInterrupt
            yield report

    with pytest.raises(KeyboardInterrupt):
        run_experiment(manifest(40), folder, interrupted)
    assert 1 not in {run.seed for run in load_results(folder).runs}
    until(folder)
    until(tmp_path / "whole")
    assert vars(kept(folder)) == vars(kept(tmp_path / "whole"))


def test_an_undecided_experiment_goes_on_with_more_seeds_and_never_with_fewer(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "x"
    results, test = until(folder, most=2)
    assert (test.verdict, len(results.runs)) == ("undecided", 2)
    assert results.lacking == ""
    with pytest.raises(ConfigError, match="seeds was"):
        until(folder, most=1)
    assert kept(folder).seeds == [0, 1]
    assert until(folder)[1].verdict == "not met"


def test_the_folder_of_another_experiment_stays_as_it_is(tmp_path: Path) -> None:
    until(tmp_path / "x", most=2)
    before = vars(kept(tmp_path / "x"))
    test = SequentialTest(f"{METRIC} >= 0.9", ALPHA, metric_of)
    with pytest.raises(ConfigError, match="another experiment"):
        run_until(test, manifest(40, traces=False), tmp_path / "x", runner((0,)))
    assert vars(kept(tmp_path / "x")) == before

"""Runs that are known are taken from the store, and one in fifty is done again and compared."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from datetime import date
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.pin import functions_here
from swarmd.sim.experiments import run_key
from swarmd.sim.experiments.known_runs import DONE_AGAIN, KnownRuns, known_runs
from swarmd.sim.experiments.lessons import _bounded
from swarmd.sim.experiments.manifest import Manifest, manifest_of
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.run_store import OFF, VARIABLE, RunStore
from swarmd.sim.experiments.sequential import SequentialTest, run_until
from swarmd.sim.experiments.simulate import Progress, Runner, run_experiment, simulate
from swarmd.sim.metrics.catalog import METRICS, metric_of
from tests.sim.conftest import DUO, Swarmctl
from tests.sim.experiments.test_run_key import MADE
from tests.support.traces import trace_of

NEVER, ALWAYS = repeat(1.0), repeat(0.0)
GROUPS = {"all": {"platform": "burger", "count": 2, "pattern": "dispersion"}}
EFFECTIVE = {"name": "duo", "duration": 2.0, "groups": GROUPS, "plugin_dir": None}
TODAY = date(2026, 11, 29)


class Does:
    """A runner by hand: each run's metrics are its seed, and its trace the seed as text.

    - `runs`: what it has done, in order.
    """

    def __init__(self, **changes: JobResult) -> None:
        """`changes`: other results, by run."""
        self.runs: list[str] = []
        self.content: Callable[[int], bytes] = lambda seed: b"trace %d" % seed
        self._changes = changes

    def __call__(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for job in jobs:
            yield {job.run: 0.5}
            self.runs.append(job.run)
            if job.trace is not None:
                job.trace.write_bytes(self.content(job.seed))
            metrics = {**dict.fromkeys(METRICS, 0.0), "path_length": float(job.seed)}
            yield self._changes.get(job.run, JobResult(job.run, metrics, wall=1.5))


@pytest.fixture(autouse=True)
def code(monkeypatch: pytest.MonkeyPatch) -> None:
    """The digests of swarmd's code, which take some 50 ms, are read once."""
    monkeypatch.setattr(run_key, "digest_of_code", lambda folder: MADE["code"])
    monkeypatch.setattr(run_key, "digest_of_kernels", lambda folder: "kernels")


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    return RunStore(tmp_path / "store", free=0)


def jobs_in(folder: Path, count: int = 3, **changes: Any) -> list[Job]:
    folder.mkdir(exist_ok=True)
    jobs = [
        Job(f"s{seed:04}", EFFECTIVE, seed, folder / f"s{seed:04}.npz") for seed in range(count)
    ]
    return [replace(job, **changes) for job in jobs]


def known_in(store: RunStore, draws: Iterator[float] = NEVER, **more: Any) -> KnownRuns:
    return KnownRuns(store, MADE, chance=lambda: next(draws), today=lambda: TODAY, **more)


def results_of(known: KnownRuns, does: Runner, jobs: Sequence[Job]) -> dict[str, JobResult]:
    reports = known.runner(does)(jobs)
    return {report.run: report for report in reports if isinstance(report, JobResult)}


def test_known_runs_are_taken_and_the_others_are_done(store: RunStore, tmp_path: Path) -> None:
    first = Does()
    known = known_in(store)
    before = results_of(known, first, jobs_in(tmp_path / "a", 2))
    assert first.runs == ["s0000", "s0001"]
    assert (known.taken, known.lines()) == ({}, [])

    second = Does()
    known = known_in(store)
    after = results_of(known, second, jobs_in(tmp_path / "b", 3))
    assert second.runs == ["s0002"]
    assert known.taken == {"2026-11-29": 2}
    assert {run: result.stored for run, result in after.items()} == {
        "s0000": "2026-11-29",
        "s0001": "2026-11-29",
        "s0002": "",
    }
    for run in ("s0000", "s0001"):
        assert after[run].metrics == before[run].metrics
        assert list(after[run].metrics or ()) == list(METRICS)  # the order of the columns
        assert after[run].wall == 0.0
        assert (tmp_path / "b" / f"{run}.npz").read_bytes() == b"trace %d" % int(run[-1])
    (line,) = known.lines()
    assert line.startswith("2 runs ")
    assert "2026-11-29" in line
    assert "--fresh" in line


def test_if_all_runs_are_known_no_worker_starts(store: RunStore, tmp_path: Path) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a"))

    def starts(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        raise AssertionError

    assert len(results_of(known_in(store), starts, jobs_in(tmp_path / "b"))) == 3


def test_a_run_without_a_trace_takes_that_of_one_with_a_trace(
    store: RunStore, tmp_path: Path
) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a"))
    known = known_in(store)
    results_of(known, Does(), jobs_in(tmp_path / "b", trace=None))
    assert known.taken.total() == 3
    assert list((tmp_path / "b").iterdir()) == []


FAILED = JobResult("s0001", reason="no progress in 60 s")
WITH_ERROR = JobResult("s0001", {"path_length": 1.0}, errors={"failed_patterns": "ZeroDivision"})


@pytest.mark.parametrize("result", [FAILED, WITH_ERROR])
def test_a_run_that_failed_is_not_kept(store: RunStore, tmp_path: Path, result: JobResult) -> None:
    results_of(known_in(store), Does(s0001=result), jobs_in(tmp_path / "a"))
    second = Does()
    results_of(known_in(store), second, jobs_in(tmp_path / "b"))
    assert second.runs == ["s0001"]


def test_a_worker_cannot_say_that_its_run_is_stored(store: RunStore, tmp_path: Path) -> None:
    says = JobResult("s0000", {"path_length": 1.0}, wall=2.0, stored="1999-01-01")
    found = results_of(known_in(store), Does(s0000=says), jobs_in(tmp_path / "a", 1))
    assert (found["s0000"].stored, found["s0000"].wall) == ("", 2.0)


def test_a_run_whose_plugin_changes_meanwhile_is_not_kept(store: RunStore, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "swirl.py").write_text("TURN = 1.0\n")
    group = {"all": {"pattern": "swirl"}}
    effective = {**EFFECTIVE, "groups": group, "plugin_dir": str(mine)}

    def edits(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for report in Does()(jobs):
            (mine / "swirl.py").write_text("TURN = 2.0\n")
            yield report

    results_of(known_in(store), edits, jobs_in(tmp_path / "a", effective=effective))
    second = Does()
    known = known_in(store)
    for turn in (1.0, 2.0):
        (mine / "swirl.py").write_text(f"TURN = {turn}\n")
        results_of(known, second, jobs_in(tmp_path / "b", 1, effective=effective))
    assert second.runs == ["s0000", "s0000"]
    assert known.refused == {}


def test_why_a_run_is_not_stored_is_said(store: RunStore, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "swirl.py").write_text("import os\n")
    group = {"all": {"pattern": "swirl"}}
    effective = {**EFFECTIVE, "groups": group, "plugin_dir": str(mine)}
    known = known_in(store)
    results_of(known, Does(), jobs_in(tmp_path / "a", effective=effective))
    (line,) = known.lines()
    assert "swirl.py:1" in line
    assert not store.folder.exists()


def test_results_are_kept_while_an_experiment_goes_on(store: RunStore, tmp_path: Path) -> None:
    """All that is two seconds old: a process that is killed loses little."""
    clock = iter([0.0, 1.0, 2.5, 2.5, 3.0, 3.0])
    reports = known_in(store, clock=lambda: next(clock)).runner(Does())(jobs_in(tmp_path / "a"))
    for report in reports:
        if isinstance(report, JobResult) and report.run == "s0002":
            break
    kept = RunStore(store.folder, free=0)
    assert len([path for path in kept.folder.iterdir() if len(path.name) == 64]) == 2
    reports.close()  # what is left is kept now
    assert len([path for path in kept.folder.iterdir() if len(path.name) == 64]) == 3


def test_a_damaged_run_is_done(store: RunStore, tmp_path: Path) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a"))
    for trace in store.folder.glob("*/trace.npz"):
        if trace.read_bytes() == b"trace 1":
            trace.write_bytes(b"trace 7")
    second = Does()
    results_of(known_in(store), second, jobs_in(tmp_path / "b"))
    assert second.runs == ["s0001"]
    assert (tmp_path / "b" / "s0001.npz").read_bytes() == b"trace 1"
    third = Does()
    results_of(known_in(store), third, jobs_in(tmp_path / "c"))
    assert third.runs == []


# One in fifty


def test_one_in_fifty_is_done_again() -> None:
    assert DONE_AGAIN == 1 / 50


def test_a_run_that_is_done_again_and_equal_counts_as_done(store: RunStore, tmp_path: Path) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a", 4))
    second = Does()
    known = known_in(store, iter([0.5, 0.0199, 0.02, 0.5]))
    found = results_of(known, second, jobs_in(tmp_path / "b", 4))
    assert second.runs == ["s0001"]
    assert next(iter(found)) == "s0001"  # no stored run is taken before it is equal
    assert (found["s0001"].stored, found["s0001"].wall) == ("", 1.5)
    assert (known.taken.total(), known.done_again) == (3, 1)
    assert len(known.lines()) == 1


def test_without_a_draw_by_hand_the_system_draws(store: RunStore, tmp_path: Path) -> None:
    """So that no seed of a program picks the runs: 200 draws without one below 0.02 have 1.8 %."""
    draws = [KnownRuns(store, MADE)._chance() for _ in range(2000)]
    assert 0.0 <= min(draws) < DONE_AGAIN < max(draws) < 1.0


def changed(job_result: JobResult, **metrics: float | None) -> JobResult:
    return replace(job_result, metrics={**(job_result.metrics or {}), **metrics})


USUAL = JobResult("s0001", {**dict.fromkeys(METRICS, 0.0), "path_length": 1.0}, wall=1.5)
OTHERS = {
    "a metric": (changed(USUAL, path_length=1.0 + 2**-52), "path_length"),
    "a metric without a value": (changed(USUAL, path_length=None), "path_length"),
    "the sign of zero": (changed(USUAL, cluster_count=-0.0), "cluster_count"),
    "one metric more": (changed(USUAL, more=1.0), "more"),
    "an error": (
        replace(USUAL, errors={"failed_patterns": "ZeroDivisionError"}),
        "failed_patterns",
    ),
}


@pytest.mark.parametrize(("result", "named"), OTHERS.values(), ids=OTHERS)
def test_a_difference_is_an_error_that_names_both(
    store: RunStore, tmp_path: Path, result: JobResult, named: str
) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a"))
    known = known_in(store, iter([0.5, 0.0, 0.5]))
    reports = known.runner(Does(s0001=result))(jobs_in(tmp_path / "b"))
    found = []
    with pytest.raises(SwarmError) as raised:
        found += [report for report in reports if isinstance(report, JobResult)]
    text = str(raised.value)
    assert found == []  # nothing was taken
    (aside,) = (store.folder / "aside").iterdir()
    for part in (str(aside), "duo", "seed 1", "2026-11-29", str(tmp_path / "b" / "s0001.npz")):
        assert part in text
    assert f": {named}" in text
    assert "\n" not in text
    third = Does()
    results_of(known_in(store), third, jobs_in(tmp_path / "c"))
    assert third.runs == ["s0001"]  # the entry is in no use


def test_a_run_that_fails_as_it_is_done_again_says_nothing(store: RunStore, tmp_path: Path) -> None:
    results_of(known_in(store), Does(), jobs_in(tmp_path / "a"))
    known = known_in(store, iter([0.5, 0.0, 0.5]))
    found = results_of(known, Does(s0001=FAILED), jobs_in(tmp_path / "b"))
    assert found["s0001"] == FAILED
    assert (known.taken.total(), known.done_again) == (2, 0)
    assert not (store.folder / "aside").exists()


def saved(folder: Path, x: float, place: int = 2) -> bytes:
    """The file of a trace of two robots, the second of which is at `x` at one instant."""
    pose = np.zeros((4, 2, 3))
    pose[place, 1, 0] = x
    trace_of(pose, meta={"seed": 1}).save(folder / "made.npz")
    return (folder / "made.npz").read_bytes()


def test_the_first_array_of_a_trace_that_differs_is_named(store: RunStore, tmp_path: Path) -> None:
    first, second = Does(), Does()
    first.content = lambda seed: saved(tmp_path, 1.0)
    second.content = lambda seed: saved(tmp_path, 1.0 + 2**-52)
    results_of(known_in(store), first, jobs_in(tmp_path / "a", 1))
    with pytest.raises(SwarmError) as raised:
        results_of(known_in(store, ALWAYS), second, jobs_in(tmp_path / "b", 1))
    assert "trace: pose; first at 0.20 s: pose of r1" in str(raised.value)


def test_equal_traces_in_other_files_are_equal(store: RunStore, tmp_path: Path) -> None:
    """Such as of another zlib."""
    first, second = Does(), Does()
    first.content = lambda seed: saved(tmp_path, 1.0)
    second.content = lambda seed: saved(tmp_path, 1.0) + b"\0"
    results_of(known_in(store), first, jobs_in(tmp_path / "a", 1))
    known = known_in(store, ALWAYS)
    results_of(known, second, jobs_in(tmp_path / "b", 1))
    assert (known.done_again, known.taken.total()) == (1, 0)


# Experiments


def experiment(count: int, *, traces: bool = True) -> Manifest:
    plan = Plan("duo", tuple(range(count)), (Variant("", {}, EFFECTIVE),))
    return manifest_of(plan, traces=traces, command=[], functions={"pinned": "yes"})


def test_a_row_says_stored_where_its_time_stands(store: RunStore, tmp_path: Path) -> None:
    run_experiment(experiment(2), tmp_path / "a", known_in(store).runner(Does()))
    seen: list[Progress] = []
    run_experiment(
        experiment(3), tmp_path / "b", known_in(store).runner(Does()), on_progress=seen.append
    )
    with (tmp_path / "b" / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["wall"] for row in rows] == ["stored", "stored", "1.500"]
    assert [float(row["path_length"]) for row in rows] == [0.0, 1.0, 2.0]
    for number in range(2):
        name = f"traces/s{number:04}.npz"
        assert (tmp_path / "b" / name).read_bytes() == (tmp_path / "a" / name).read_bytes()
    # The work of a run that is not simulated is no work: its two robots and two seconds.
    assert [(now.done, now.worked, now.left) for now in seen[:3]] == [
        (0, 0.0, 12.0),
        (1, 0.0, 8.0),
        (2, 0.0, 4.0),
    ]
    assert (seen[-1].done, seen[-1].worked, seen[-1].left) == (3, 4.0, 0.0)
    results = load_results(tmp_path / "b")
    assert [row["wall"] for row in results.rows] == [None, None, 1.5]
    assert results.stored == 2
    speeds = results.times_real_time
    assert np.isnan(speeds[:2]).all()
    assert speeds[2] == pytest.approx(2.0 / 1.5)
    summary = json.loads((tmp_path / "b" / "summary.json").read_text())
    assert (summary["wall"], summary["stored"]) == (1.5, 2)
    assert summary["times_real_time"]["min"] == pytest.approx(2.0 / 1.5)
    assert "all runs: 1.5 s" in str(results)
    assert "2 runs" in str(results)


def test_a_stored_run_keeps_its_bits_and_rules(store: RunStore, tmp_path: Path) -> None:
    did = replace(USUAL, run="s0000", bits="0123456789ab", rules=("barrier", "opening"))
    run_experiment(experiment(1), tmp_path / "a", known_in(store).runner(Does(s0000=did)))
    run_experiment(experiment(1), tmp_path / "b", known_in(store).runner(Does()))
    rows = [load_results(tmp_path / name).rows[0] for name in "ab"]
    assert [row["bits"] for row in rows] == ["0123456789ab"] * 2
    assert [row["rules"] for row in rows] == ["barrier opening"] * 2
    assert [row["wall"] for row in rows] == [1.5, None]


def test_a_run_done_again_with_other_bits_is_an_error(store: RunStore, tmp_path: Path) -> None:
    did = replace(USUAL, run="s0000", bits="0123456789ab")
    run_experiment(experiment(1), tmp_path / "a", known_in(store).runner(Does(s0000=did)))
    other = Does(s0000=replace(did, bits="ba9876543210"))
    known = KnownRuns(store, MADE, chance=lambda: 0.0)
    with pytest.raises(SwarmError, match="0123456789ab"):
        run_experiment(experiment(1), tmp_path / "b", known.runner(other))


def test_an_experiment_of_stored_runs_claims_no_time(store: RunStore, tmp_path: Path) -> None:
    run_experiment(experiment(2), tmp_path / "a", known_in(store).runner(Does()))
    run_experiment(experiment(2), tmp_path / "b", known_in(store).runner(Does()))
    results = load_results(tmp_path / "b")
    assert (results.document()["times_real_time"], results.document()["wall"]) == (None, 0)
    assert "real time" not in str(results)


def test_a_table_with_another_word_is_damaged(store: RunStore, tmp_path: Path) -> None:
    run_experiment(experiment(2), tmp_path / "a", known_in(store).runner(Does()))
    run_experiment(experiment(2), tmp_path / "b", known_in(store).runner(Does()))
    table = tmp_path / "b" / "runs.csv"
    for word in ("kept", "", "nan", "Stored"):
        changed = table.read_text().replace(",stored", f",{word}")
        (tmp_path / "b" / "other.csv").write_text(changed)
        table_before = table.read_text()
        table.write_text(changed)
        with pytest.raises(SwarmError, match=r"runs\.csv:2"):
            load_results(tmp_path / "b")
        table.write_text(table_before)


def test_runs_until_a_decision_are_the_same(store: RunStore, tmp_path: Path) -> None:
    def until(folder: Path, runner: Runner) -> SequentialTest:
        test = SequentialTest("one_cluster_at_end >= 0.5", 0.05, metric_of)
        run_until(test, experiment(40), folder, runner)
        return test

    first = until(tmp_path / "a", Does())
    run_experiment(experiment(40), tmp_path / "all", known_in(store).runner(Does()))
    known = known_in(store)
    second = until(tmp_path / "b", known.runner(Does()))
    assert (second.verdict, second.runs) == (first.verdict, first.runs) == ("not met", first.runs)
    names = [sorted(os.listdir(tmp_path / name / "traces")) for name in "ab"]
    assert names[0] == names[1]
    assert len(names[0]) == first.runs < 40


def test_the_check_of_a_class_takes_known_runs(
    store: RunStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from swarmd.sim.experiments import lessons

    does = Does()
    monkeypatch.setattr(lessons, "run_jobs", lambda jobs, **options: does(jobs))
    jobs = jobs_in(tmp_path / "a", 3, trace=None, guest=tmp_path)
    for known in (known_in(store), known_in(store), None):
        assert len([*_bounded(jobs, 1, 60.0, known)]) == 3
    assert does.runs == ["s0000", "s0001", "s0002"] * 2  # not by the second


def test_it_is_off_where_it_is_asked(tmp_path: Path) -> None:
    environ = {VARIABLE: str(tmp_path)}
    assert known_runs(environ=environ) is not None
    assert known_runs(is_fresh=True, environ=environ) is None
    assert known_runs(environ={VARIABLE: OFF}) is None


def test_runs_of_this_process_are_neither_taken_nor_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their code may be changed in memory, by a debugger or by a control of a study.

    Also not in a process that is pinned, as those of studies are.
    """
    monkeypatch.setenv(VARIABLE, str(tmp_path / "store"))
    pinned = {**functions_here(), "pinned": "yes"}
    monkeypatch.setattr("swarmd.sim.experiments.simulate.functions_here", lambda: pinned)
    options: dict[str, Any] = {"set": {"duration": 0.1}, "in_process": True, "traces": False}
    for _ in range(2):
        assert simulate("dispersion", 1, **options).stored == 0
    assert not (tmp_path / "store").exists()


@pytest.mark.integration
def test_each_verb_takes_what_another_has_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swarmctl: Swarmctl
) -> None:
    """Real runs of 0.5 s: rows and traces are equal to the byte, and a changed pattern is run."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "store"))
    # This test asks for what is taken; `chance` of the system would do one in fifty again.
    monkeypatch.setattr("swarmd.sim.experiments.known_runs.DONE_AGAIN", 0.0)
    (tmp_path / "mine").mkdir()
    mine = tmp_path / "mine" / "swirl.py"
    mine.write_text(SWIRL)
    scenario = tmp_path / "duo.yaml"
    scenario.write_text(DUO.replace("plugin_dir: plugins\n", "").replace("moody", "swirl"))
    words = (
        *("exp", "run", scenario, "--plugin-dir", tmp_path / "mine"),
        *("--seeds", 2, "--set", "duration=0.5", "-j", 1),
    )
    told = {}
    for name, more in {"a": (), "b": (), "fresh": ("--fresh",)}.items():
        done = swarmctl(*words, "--out", name, *more)
        assert done.returncode == 0, done.stderr
        told[name] = done.stderr
    assert "store of runs" not in told["a"] + told["fresh"]
    assert "2 runs taken from the store of runs" in told["b"]
    tables = {name: rows_of(tmp_path / name) for name in told}
    assert [wall for *_, wall in tables["b"]] == ["stored", "stored"]
    assert "stored" not in [wall for *_, wall in (*tables["a"], *tables["fresh"])]
    assert [row[:-1] for row in tables["b"]] == [row[:-1] for row in tables["fresh"]]
    for trace in ("s0000.npz", "s0001.npz"):
        content = [(tmp_path / name / "traces" / trace).read_bytes() for name in told]
        assert content[0] == content[1] == content[2]

    # `exp rerun` does the runs that it compares.
    again = swarmctl("exp", "rerun", "b", "-j", 1)
    assert again.returncode == 0, again.stderr
    assert "store of runs" not in again.stderr

    # Python takes them, too; another byte of the pattern is another run.
    options: dict[str, Any] = {"set": {"duration": 0.5, "plugin_dir": str(tmp_path / "mine")}}
    assert simulate(scenario, 2, **options).stored == 2
    assert simulate(scenario, 2, fresh=True, **options).stored == 0
    mine.write_text(SWIRL.replace("0.1", "0.2"))
    assert simulate(scenario, 2, **options).stored == 0
    assert simulate(scenario, 2, **options).stored == 2


SWIRL = """
from swarmd.api import Inputs, MovementPattern, Params, Twist


class SwirlParams(Params, frozen=True, kw_only=True):
    pass


class Swirl(MovementPattern[SwirlParams]):
    params_type = SwirlParams

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(linear=0.1, angular=0.3)
"""


def rows_of(folder: Path) -> list[list[str]]:
    with (folder / "runs.csv").open() as file:
        return list(csv.reader(file))[1:]


@pytest.mark.parametrize(
    "verb", [("exp", "run"), ("exp", "bench"), ("exp", "tune"), ("class", "check")]
)
def test_each_verb_that_runs_may_run_all_anew(swarmctl: Swarmctl, verb: tuple[str, str]) -> None:
    assert "--fresh" in swarmctl(*verb, "--help").stdout


def test_what_compares_runs_does_them(swarmctl: Swarmctl) -> None:
    assert "--fresh" not in swarmctl("exp", "rerun", "--help").stdout

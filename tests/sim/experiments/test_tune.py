"""Tunings with a synthetic metric, which no world has to be simulated for."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
import yaml

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.search_space import parameter_space
from swarmd.sim.experiments.store import FAILURES
from swarmd.sim.experiments.tune import (
    ALPHA,
    BATCHES,
    HELD_OUT,
    RESULT,
    STATE,
    Tuning,
    looks,
    make_study,
    split_metric,
    tune,
)
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.plots.tuning import draw_landscape
from swarmd.sim.scenarios.scenariofile import load_scenario
from tests.sim.conftest import write_duo

SPEED = "groups.all.parameters.speed"
SPEED_OF_ALL = "parameters.moody.speed"
NOTHING = dict.fromkeys(METRICS)


class Interruption(BaseException):
    """As Ctrl-C."""


class Bench:
    """Does runs without a world: path_length is best at a speed of 0.3, with noise of the seed.

    `done` has the jobs. After `limit` of them it is interrupted. It does them in `reverse` order.
    """

    def __init__(self, limit: int = 10_000, *, reverse: bool = False, fails_above: float = 9.9):
        self.done: list[Job] = []
        self.limit, self.reverse, self.fails_above = limit, reverse, fails_above

    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for job in reversed(jobs) if self.reverse else jobs:
            if len(self.done) >= self.limit:
                raise Interruption
            self.done.append(job)
            speed = speed_of(job.effective)
            if speed > self.fails_above:
                yield JobResult(job.run, reason="too fast")
                continue
            noise = float(np.random.default_rng([job.seed, int(1e4 * speed)]).normal())
            value = 10.0 * job.seed - 100.0 * (speed - 0.3) ** 2 + 0.1 * noise
            yield JobResult(job.run, {**NOTHING, "path_length": value}, 0.01)


def speed_of(effective: Any) -> float:
    own = effective["groups"]["all"]["parameters"]
    return float(own.get("speed", effective["parameters"].get("moody", {}).get("speed", 0.1)))


@pytest.fixture(scope="module")
def duo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_duo(tmp_path_factory.mktemp("duo"))


def tuned(duo: Path, folder: Path, bench: Bench, **more: Any) -> Tuning:
    given = {"budget": 80, "seeds": 8, "candidates": 4, "held_out": 20, "param": ["speed=0..0.6"]}
    return tune(duo, "path_length:max", out=folder, runner=bench.run, **{**given, **more})


@pytest.fixture(scope="module")
def whole(duo: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tuning, Bench]:
    folder, bench = tmp_path_factory.mktemp("whole") / "t", Bench()
    return folder, tuned(duo, folder, bench), bench


def tried(one: Tuning) -> list[tuple[dict[str, Any], list[float]]]:
    """Values and losses of all candidates, in the order in which they were drawn."""
    return [(c.values, c.losses) for c in sorted(one.candidates, key=lambda c: c.number)]


def test_the_best_values_are_found_and_held_against_the_present_ones(
    whole: tuple[Path, Tuning, Bench], duo: Path
) -> None:
    folder, found, bench = whole
    assert abs(found.best.values["speed"] - 0.3) < 0.1
    assert found.value(found.best) == max(map(found.value, found.candidates))
    present = next(one for one in found.candidates if one.number == 0)
    assert (len(present.losses), present.is_out) == (8, False)
    assert found.value(found.best) - found.value(present) == pytest.approx(4.0, abs=0.5)
    gain = found.gain
    assert gain is not None
    assert gain.is_paired
    assert (gain.n_a, gain.better, found.held_out) == (20, None, tuple(range(8, 28)))
    assert gain.interval is not None
    assert gain.interval.low > 2.0  # 100 * 0.2 ** 2 is 4
    assert found.runs == len(bench.done) - 40 <= 80
    rows = load_results(folder / HELD_OUT)
    assert rows.variants == ("candidate=present", "candidate=tuned")
    scenario = load_scenario(folder / RESULT)
    assert speed_of(scenario.effective) == found.best.values["speed"]
    text = (folder / RESULT).read_text()
    assert text == found.document
    assert "# Held-out seeds 8-27: mean" in text
    assert "Better: tuned." in text
    assert f"#     moody: {{speed: {found.best.values['speed']}}}" in text


def test_a_picture_shows_each_candidate(whole: tuple[Path, Tuning, Bench], tmp_path: Path) -> None:
    import matplotlib
    from matplotlib import pyplot

    before = dict(matplotlib.rcParams)
    tuning = whole[1]
    assert tuning.importance == {SPEED_OF_ALL: 1.0}
    text = draw_landscape(tuning, tmp_path / "landscape.svg").read_text()
    for word in (">speed<", ">importance 100%<", ">path length [m]<"):
        assert word in text
    points, _ = text.partition('id="PathCollection_1"')[2].split('id="PathCollection_2"')
    assert points.count("<use ") == len(tuning.candidates)
    assert pyplot.get_fignums() == []
    changed = {key for key, value in matplotlib.rcParams.items() if before[key] != value}
    assert changed <= {
        "backend",
        "backend_fallback",
    }  # optuna's style of the picture stays with the picture


def test_all_candidates_meet_the_same_seeds_and_worse_ones_end_early(
    whole: tuple[Path, Tuning, Bench],
) -> None:
    _, found, _ = whole
    assert {(len(one.losses), one.is_out) for one in found.candidates} == {(8, False), (6, True)}
    far = [one for one in found.candidates if abs(one.values["speed"] - 0.3) > 0.21]
    assert far
    assert all(one.is_out for one in far)
    # With all seeds each candidate costs 8 runs: the budget has then room for 10.
    assert len(found.candidates) > 10


def test_the_order_in_which_runs_end_changes_nothing(
    whole: tuple[Path, Tuning, Bench], duo: Path, tmp_path: Path
) -> None:
    other = tuned(duo, tmp_path / "t", Bench(reverse=True))
    assert tried(other) == tried(whole[1])
    assert other.best.values == whole[1].best.values
    assert other.gain == whole[1].gain


@pytest.mark.long
@pytest.mark.parametrize("limit", [27, 50])
def test_an_interrupted_tuning_resumes_with_the_same_result(
    whole: tuple[Path, Tuning, Bench], duo: Path, tmp_path: Path, limit: int
) -> None:
    first, second = Bench(limit), Bench()
    with pytest.raises(Interruption):
        tuned(duo, tmp_path / "t", first)
    found = tuned(duo, tmp_path / "t", second)
    assert tried(found) == tried(whole[1])
    assert found.gain == whole[1].gain
    assert len(first.done) + len(second.done) == len(whole[2].done)


def test_a_failed_run_is_not_repeated_once_its_batch_is_over(duo: Path, tmp_path: Path) -> None:
    first = Bench(60, fails_above=0.4)
    with pytest.raises(Interruption):
        tuned(duo, tmp_path / "t", first)
    fast = {speed for job in first.done if (speed := speed_of(job.effective)) > 0.4}
    assert fast
    found = tuned(duo, tmp_path / "t", Bench())
    again = [one for one in found.candidates if one.values["speed"] in fast]
    assert len(again) == len(fast)
    assert all(one.is_out and np.isinf(one.losses).all() for one in again)
    assert "too fast" in (tmp_path / "t" / BATCHES / "01" / FAILURES).read_text()


def test_nothing_better_is_no_claim(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Bench(), set={SPEED: 0.3}, budget=40)
    assert found.best.number == 0
    assert found.gain is None
    assert "No values are better" in found.document
    assert load_results(tmp_path / "t" / HELD_OUT).variants == ("candidate=present",)


def test_values_outside_of_the_search_space_are_compared_too(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Bench(), param=["speed=0.2..0.6"], held_out=0)
    present = next(one for one in found.candidates if one.number == 0)
    assert (present.values, len(present.losses)) == ({}, 8)
    assert any(one.is_out for one in found.candidates if one.number <= 4)  # of batch 1
    assert found.best.values["speed"] == pytest.approx(0.3, abs=0.1)
    assert found.importance == {SPEED_OF_ALL: 1.0}


class Even(Bench):
    """All values are equal."""

    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for job in jobs:
            yield JobResult(job.run, {**NOTHING, "path_length": 1.0}, 0.01)


def test_equal_candidates_have_no_winner_and_no_importance(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Even(), budget=120, held_out=0)
    assert len(found.candidates) > 10
    assert (found.best.number, found.importance) == (0, {})


class Fragile(Bench):
    """Tuned values fail on most held-out seeds."""

    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for result, job in zip(super().run(jobs), jobs, strict=True):
            is_lost = job.seed >= 12 and speed_of(job.effective) > 0.1
            yield JobResult(job.run, reason="broke") if is_lost else result


def test_the_claim_names_the_seeds_without_a_value(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Fragile())
    assert found.gain is not None
    assert found.gain.n_a == 4
    assert "16 further seeds lack a value on a side" in " ".join(
        line.lstrip("# ") for line in found.document.splitlines()
    )


def test_all_failed_is_one_line(duo: Path, tmp_path: Path) -> None:
    with pytest.raises(SwarmError, match=r"scenario's values failed; the first, .*: too fast"):
        tuned(duo, tmp_path / "t", Bench(fails_above=-1.0))


def test_values_that_do_not_fit_are_not_run(tmp_path: Path) -> None:
    """Dispersion refuses a distance that is not above the protection threshold of 0.5 m."""
    found = tune(
        "dispersion",
        "path_length:min",
        budget=12,
        seeds=2,
        candidates=3,
        held_out=0,
        param=["distance=0.1..1"],
        out=tmp_path / "t",
        runner=Distances().run,
    )
    distances = [one.values["distance"] for one in found.candidates]
    assert len(distances) > 3
    assert min(distances) > 0.5


class Distances(Bench):
    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        for job in jobs:
            yield JobResult(job.run, {**NOTHING, "path_length": float(job.seed)}, 0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"param": ["speed"]}, "speed: it has no lower bound; give speed=LO..HI"),
        ({"param": ["sped=0..1"]}, "'sped'; did you mean 'speed'"),
        ({"param": ["speed=1..0"]}, "LO below HI"),
        ({"param": ["speed=0..1", "parameters.moody.speed=0..2"]}, "given twice"),
        (
            {"param": ["groups.some.count=1..2"]},
            "no values .* accepted; the last: .* no group 'some'",
        ),
        ({"param": []}, "no pattern with parameters to tune"),
        ({"budget": 15}, "budget is 15 runs; expected 16"),
        ({"held_out": [3, 9]}, "seed 3 is both"),
        ({"candidates": 0}, "expected 1 or more"),
    ],
)
def test_a_wrong_argument_is_named(
    duo: Path, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    bench = Bench()
    with pytest.raises(ConfigError, match=message) as raised:
        tuned(duo, tmp_path / "t", bench, **change)
    assert "\n" not in str(raised.value)
    assert bench.done == []


def test_a_folder_of_another_tuning_is_refused(
    whole: tuple[Path, Tuning, Bench], duo: Path
) -> None:
    with pytest.raises(ConfigError, match="holds another tuning: budget was 80, now 81"):
        tuned(duo, whole[0], Bench(), budget=81)
    with pytest.raises(ConfigError, match="holds another tuning: parameters was"):
        tuned(duo, whole[0], Bench(), param=["speed=0..0.5"])
    with pytest.raises(ConfigError, match="not the folder of a tuning"):
        tuned(duo, whole[0] / HELD_OUT, Bench())


@pytest.mark.parametrize("contents", ["{", "{}", '{"asked": [], "batches": 1}', "[" * 5000])
def test_a_damaged_folder_is_refused_in_one_line(duo: Path, tmp_path: Path, contents: str) -> None:
    (tmp_path / STATE).write_text(contents)
    with pytest.raises(ConfigError, match=r"tune\.json: damaged; remove the folder"):
        tuned(duo, tmp_path, Bench())
    assert (tmp_path / STATE).read_text() == contents


def test_the_sampler_leaves_the_log_of_optuna_as_it_was(
    duo: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    verbosity = optuna.logging.get_verbosity()
    tuned(duo, tmp_path / "t", Bench(), budget=24, held_out=0)
    assert optuna.logging.get_verbosity() == verbosity
    assert capfd.readouterr() == ("", "")


def ends(differences: Sequence[float], seeds: int) -> int:
    """After how many seeds a candidate ends that differs so from the reference; 0: not early."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study = make_study(seeds)
    reference, trial = study.ask(), study.ask()
    for step in range(seeds):
        reference.report(0.0, step)
    study.tell(reference, 0.0)
    for step, difference in enumerate(differences, start=1):
        trial.report(difference, step - 1)
        if step in looks(seeds) and trial.should_prune():
            return step
    return 0


def test_looks_come_after_6_seeds_and_double() -> None:
    assert looks(20) == (6, 12)
    assert looks(50) == (6, 12, 24, 48)
    assert looks(6) == looks(2) == ()


def test_the_level_is_divided_by_the_number_of_looks() -> None:
    """Of the 64 signs of six pairs, one is as far on a side as all six, two as all but the least.

    1 / 64 is below 0.05 / 2, 2 / 64 is not, but below 0.05.
    """
    all_worse, all_but_least = [3.0, 1.0, 4.0, 1.5, 9.0, 2.0], [3.0, -1.0, 4.0, 1.5, 9.0, 2.0]
    assert ends(all_worse, 20) == 6
    assert ends(all_but_least, 20) == 0
    assert ends(all_but_least, 8) == 6
    assert ends([-one for one in all_worse], 8) == 0  # better


@pytest.mark.parametrize("seeds", [8, 20])
def test_equal_candidates_end_in_no_more_than_5_percent(seeds: int) -> None:
    generator = np.random.default_rng(5)
    count = 200
    wrong = sum(ends(generator.normal(size=seeds).tolist(), seeds) > 0 for _ in range(count))
    assert wrong <= count * (ALPHA + 3.0 * np.sqrt(ALPHA * (1.0 - ALPHA) / count))


def test_equal_losses_end_nothing() -> None:
    assert ends([0.0] * 20, 20) == 0


def test_a_metric_needs_a_direction() -> None:
    assert split_metric("path_length:min")[1] == "min"
    assert split_metric("robot_contacts")[1] == "min"
    assert split_metric("report:min:max")[0].name == "report:min"
    with pytest.raises(ConfigError, match="path_length:min or path_length:max"):
        split_metric("path_length")
    with pytest.raises(ConfigError, match="'gather_tim'"):
        split_metric("gather_tim:min")


def test_a_pattern_declares_what_can_be_tuned() -> None:
    notes: list[str] = []
    space = parameter_space(load_scenario("aggregation"), (), notes.append)
    by_name = {one.name: one for one in space.parameters}
    assert by_name["law"].choices == ("settling", "paper")
    assert (by_name["speed"].low, by_name["speed"].high) == (0.0, 0.26)  # the platform's limit
    assert by_name["range"].is_log
    assert "recovery" not in by_name
    assert space.present is not None
    assert space.present["law"] == "settling"
    few = parameter_space(
        load_scenario("aggregation", {"groups.tb3.parameters.spacing": 0.7}),
        ["spacing", "law=paper", "groups.tb3.count=5..9", "radio.loss=0..0.5"],
    )
    assert few.text == [
        *("groups.tb3.parameters.spacing=0.05..20", "parameters.attraction.law=paper"),
        *("groups.tb3.count=5..9", "radio.loss=0..0.5"),
    ]
    assert [one.present for one in few.parameters] == [0.7, "settling", 10, 0.0]
    assert few.parameters[2].is_int
    assert few.present is None  # law is none of its values


@pytest.mark.parametrize(
    ("platform", "speed", "lateral"),
    [("burger", (-0.22, 0.22), None), ("slider", (-0.8, 0.8), (-0.5, 0.5))],
)
def test_a_speed_sideways_has_the_bounds_of_the_platform(
    platform: str, speed: tuple[float, float], lateral: tuple[float, float] | None
) -> None:
    notes: list[str] = []
    slider = {"extends": "rosbot_xl", "limits": {"lateral": 0.5}}
    changes = {
        "platforms": {"slider": slider},
        "groups.tb3.platform": platform,
        "groups.tb3.pattern": "drive",
    }
    space = parameter_space(load_scenario("aggregation", changes), (), notes.append)
    bounds = {one.name: (one.low, one.high) for one in space.parameters}
    assert bounds["speed"] == speed
    assert bounds.get("lateral") == lateral
    reason = [] if lateral else ["lateral is not tuned: burger does not move sideways"]
    assert [note.partition(";")[0] for note in notes] == reason


def test_the_document_is_a_scenario(whole: tuple[Path, Tuning, Bench], duo: Path) -> None:
    body = yaml.safe_load(whole[1].document)
    assert body["extends"] == str(duo)
    assert body["parameters"]["moody"] == whole[1].best.values


def test_the_document_has_no_values_of_candidates_that_are_not_the_best(tmp_path: Path) -> None:
    """A list of the scenario stands in the document in full if one of its items is set."""
    duo = write_duo(tmp_path)
    text = "\nevents:\n  - {at: 1.0, stop: all}\n  - {at: 1.5, stop: all}\n"
    duo.write_text(duo.read_text() + text)
    found = tuned(
        duo, tmp_path / "t", Even(), param=["events.0.at=0.1..0.9"], set={"events.1.at": 1.6}
    )
    assert found.best.number == 0
    assert [event["at"] for event in yaml.safe_load(found.document)["events"]] == [1.0, 1.6]


def test_pseudo_reality_has_the_same_draws_for_both_sides(duo: Path, tmp_path: Path) -> None:
    bench = Shaky()
    found = tuned(duo, tmp_path / "t", bench, pseudo_reality=True, budget=48)
    assert set(found.drops) == {"present", "tuned"}
    for drop in found.drops.values():
        assert drop.is_paired
        assert drop.difference == pytest.approx(-1.5)
    assert "In pseudo-reality, tuned values: mean" in found.document
    assert found.document.count("Better: nominal.") == 2
    assert {job.seed for job in bench.shaken} == set(range(8, 28))


class Shaky(Bench):
    """Loses 1.5 in pseudo-reality; `shaken` has these runs."""

    def __init__(self) -> None:
        super().__init__()
        self.shaken: list[Job] = []

    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        by_id = {job.run: job for job in jobs}
        for result in super().run(jobs):
            assert isinstance(result, JobResult)
            job = by_id[result.run]
            if job.effective["pseudo_reality"]:
                self.shaken.append(job)
                value = (result.metrics or {})["path_length"] or 0.0
                result = JobResult(job.run, {**NOTHING, "path_length": value - 1.5}, 0.01)
            yield result

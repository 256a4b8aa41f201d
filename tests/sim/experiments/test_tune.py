"""Tunings with a synthetic metric, which no world has to be simulated for."""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.search_space import parameter_space
from swarmd.sim.experiments.tune import HELD_OUT, RESULT, STATE, Tuning, split_metric, tune
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.plots.tuning import draw_tuning
from swarmd.sim.scenarios.scenariofile import load_scenario
from tests.sim.conftest import write_duo

SPEED = "groups.all.parameters.speed"
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
    given = {"budget": 60, "seeds": 6, "candidates": 4, "held_out": 20, "param": ["speed=0..0.6"]}
    return tune(duo, "path_length:max", out=folder, runner=bench.run, **{**given, **more})


@pytest.fixture(scope="module")
def whole(duo: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tuning, Bench]:
    folder, bench = tmp_path_factory.mktemp("whole") / "t", Bench()
    return folder, tuned(duo, folder, bench), bench


def races(folder: Path) -> Any:
    return json.loads((folder / STATE).read_text())["races"]


def test_the_best_values_are_found_and_held_against_the_present_ones(
    whole: tuple[Path, Tuning, Bench], duo: Path
) -> None:
    folder, found, bench = whole
    assert abs(found.best.values["speed"] - 0.3) < 0.1
    assert found.value(found.best) == max(map(found.value, found.candidates))
    present = next(one for one in found.candidates if one.number == 0)
    assert len(present.losses) == 5  # of 6, of which each adds 10
    assert found.value(found.best) - found.value(present) == pytest.approx(4.0, abs=0.5)
    gain = found.gain
    assert gain is not None
    assert gain.is_paired
    assert (gain.n_a, gain.better, found.held_out) == (20, None, tuple(range(6, 26)))
    assert gain.interval is not None
    assert gain.interval.low > 2.0  # 100 * 0.2 ** 2 is 4
    assert found.runs == len(bench.done) - 40 <= 60
    rows = load_results(folder / HELD_OUT)
    assert rows.variants == ("candidate=present", "candidate=tuned")
    scenario = load_scenario(folder / RESULT)
    assert speed_of(scenario.effective) == found.best.values["speed"]
    text = (folder / RESULT).read_text()
    assert text == found.document
    assert "# Held-out seeds 6-25: mean" in text
    assert "Better: tuned." in text
    assert f"#     moody: {{speed: {found.best.values['speed']}}}" in text


def test_pictures_show_each_candidate_and_the_importance(
    whole: tuple[Path, Tuning, Bench], tmp_path: Path
) -> None:
    paths = draw_tuning(whole[1], tmp_path)
    assert [path.name for path in paths] == ["landscape.png", "importance.png"]
    assert all(path.stat().st_size > 3000 for path in paths)
    assert whole[1].importance == {"parameters.moody.speed": 1.0}


def test_all_candidates_meet_the_same_seeds_and_worse_ones_end_early(
    whole: tuple[Path, Tuning, Bench],
) -> None:
    _, found, _ = whole
    assert {len(one.losses) for one in found.candidates} == {5, 6}
    assert {one.is_out for one in found.candidates if len(one.losses) == 5} == {True}
    far = [one for one in found.candidates if abs(one.values["speed"] - 0.3) > 0.2]
    assert far
    assert all(one.is_out for one in far)


def test_the_order_in_which_runs_end_changes_nothing(
    whole: tuple[Path, Tuning, Bench], duo: Path, tmp_path: Path
) -> None:
    other = tuned(duo, tmp_path / "t", Bench(reverse=True))
    assert races(tmp_path / "t") == races(whole[0])
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
    assert races(tmp_path / "t") == races(whole[0])
    assert found.gain == whole[1].gain
    assert len(first.done) + len(second.done) == len(whole[2].done)


def test_a_failed_run_is_not_repeated_once_its_race_is_over(duo: Path, tmp_path: Path) -> None:
    first = Bench(45, fails_above=0.4)
    with pytest.raises(Interruption):
        tuned(duo, tmp_path / "t", first)
    lost = [one for race in races(tmp_path / "t") for one in race if None in one["losses"]]
    assert lost
    found = tuned(duo, tmp_path / "t", Bench())
    again = [one for one in found.candidates if one.values["speed"] == lost[0]["values"]["speed"]]
    assert again[0].is_out
    assert np.isinf(again[0].losses).all()


def test_nothing_better_is_no_claim(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Bench(), set={SPEED: 0.3}, budget=24)
    assert found.best.number == 0
    assert found.gain is None
    assert "No values are better" in found.document
    assert load_results(tmp_path / "t" / HELD_OUT).variants == ("candidate=present",)


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
            is_lost = job.seed >= 10 and speed_of(job.effective) > 0.1
            yield JobResult(job.run, reason="broke") if is_lost else result


def test_the_claim_names_the_seeds_without_a_value(duo: Path, tmp_path: Path) -> None:
    found = tuned(duo, tmp_path / "t", Fragile())
    assert found.gain is not None
    assert found.gain.n_a == 4
    assert "16 further seeds lack a value on a side" in " ".join(
        line.lstrip("# ") for line in found.document.splitlines()
    )


def test_all_failed_is_one_line(duo: Path, tmp_path: Path) -> None:
    with pytest.raises(SwarmError, match=r"all runs of race 1 failed; the first, .*: too fast"):
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
        ({"budget": 11}, "budget is 11 runs; expected 12"),
        ({"held_out": [3, 9]}, "seed 3 is both"),
        ({"candidates": 1}, "expected 1 and 2"),
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
    with pytest.raises(ConfigError, match="holds another tuning: budget was 60, now 61"):
        tuned(duo, whole[0], Bench(), budget=61)
    with pytest.raises(ConfigError, match="holds another tuning: parameters was"):
        tuned(duo, whole[0], Bench(), param=["speed=0..0.5"])
    with pytest.raises(ConfigError, match="not the folder of a tuning"):
        tuned(duo, whole[0] / HELD_OUT, Bench())


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
    found = tuned(duo, tmp_path / "t", bench, pseudo_reality=True, budget=24)
    assert set(found.drops) == {"present", "tuned"}
    for drop in found.drops.values():
        assert drop.is_paired
        assert drop.difference == pytest.approx(-1.5)
    assert "In pseudo-reality, tuned values: mean" in found.document
    assert found.document.count("Better: nominal.") == 2
    assert {job.seed for job in bench.shaken} == set(range(6, 26))


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

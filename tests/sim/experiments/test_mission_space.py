"""Missions as candidates: each draw is a mission that robots accept and run."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import optuna
import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.mission.schema import read_document
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.mission_space import MAX_STATES, MissionSpace, mission_space
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.simulate import Runner
from swarmd.sim.experiments.tune import MISSION, RESULT, tune
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import Trace

MODULES = ("random_walk", "attraction", "dispersion")
LIGHT = {"fields": [{"kind": "gaussian", "name": "light", "center": [1, 0], "sigma": 1.0}]}


@pytest.fixture
def space(tmp_path: Path) -> MissionSpace:
    words = ["reading:light=0..1", "timeout=0.2..5"]
    return mission_space(load_scenario("dispersion", LIGHT), MODULES, words, tmp_path / "missions")


def test_every_draw_is_a_mission_without_faults(space: MissionSpace) -> None:
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    kinds, states = set(), set()
    for _ in range(300):
        overrides = space.overrides(space.draw(study.ask()))
        place = Path(overrides["plugin_dir"])
        (file,) = place.iterdir()
        document = read_document(file)
        assert document.faults == []
        assert {part.pattern for part in document.parts.values()} <= set(MODULES)
        assert overrides["groups.tb3.pattern"] == file.stem == place.name
        root = document.root
        assert root is not None
        kinds.add(type(root).__name__)
        states.add(max(len(root.children), 1))
    assert kinds == {"RunPart", "Sequence", "Switch"}
    assert states == set(range(1, MAX_STATES + 1))


def test_robots_run_what_is_drawn(space: MissionSpace) -> None:
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=2))
    small = {**LIGHT, "groups.tb3.count": 2, "duration": 0.5}
    reported = set()
    for _ in range(6):
        overrides = space.overrides(space.draw(study.ask()))
        trace = simulate_run(load_scenario("dispersion", {**small, **overrides}), 1)
        reported |= last_states(trace)
    assert reported == {"running"}


def test_the_file_follows_from_the_values(space: MissionSpace) -> None:
    values = {
        "kind": "sequence",
        **{"part_1": "random_walk", "condition_1": "timeout", "bound_1": 5.0},
        **{"part_2": "attraction", "condition_2": "not reading:light", "bound_2": 0.5},
    }
    body = yaml.safe_load(space.mission(values))
    assert body["parts"] == {name: {"pattern": name} for name in ("random_walk", "attraction")}
    assert body["sequence"] == [
        {"part": "random_walk", "name": "random_walk_1", "until": {"timeout": 5.0}},
        {"part": "attraction", "name": "attraction_2", "until": {"reading": "light", "below": 0.5}},
    ]
    assert body["then"] == "repeat"
    assert space.overrides(values) == space.overrides(dict(reversed(values.items())))


def last_states(trace: Trace) -> set[str]:
    assert trace.state is not None
    return {str(state) for state in trace.state[-1]}


@contextmanager
def by_hand(manifest: Manifest) -> Iterator[tuple[Runner, Manifest]]:
    """Runs without a world; dispersion is good, and the fewer states the better."""
    yield scored, manifest


def scored(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
    for job in jobs:
        folder = job.effective["plugin_dir"]
        text = next(Path(folder).glob("*.yaml")).read_text() if folder else ""
        value = 10.0 * ("dispersion" in text) - len(text) / 1000.0 + job.seed
        yield JobResult(job.run, {**dict.fromkeys(METRICS), "path_length": value}, 0.01)


def test_a_tuning_gives_a_mission_that_robots_run(tmp_path: Path) -> None:
    folder = tmp_path / "t"
    found = tune(
        "dispersion",
        "path_length:max",
        budget=24,
        seeds=2,
        candidates=6,
        held_out=3,
        mission=MODULES,
        out=folder,
        workers=by_hand,
    )
    assert "dispersion" in found.best.values.values()
    assert read_document(folder / MISSION).faults == []
    assert "# Held-out seeds 2-4" in (folder / MISSION).read_text()
    scenario = load_scenario(folder / RESULT, {"duration": 0.5, "groups.tb3.count": 2})
    assert scenario.effective["groups"]["tb3"]["pattern"].startswith("m_")
    assert last_states(simulate_run(scenario, 1)) == {"running"}


@pytest.mark.parametrize(
    ("modules", "words", "message"),
    [
        (("atraction",), [], "--mission: no pattern 'atraction'"),
        (MODULES, ["speed=0..1"], "--param speed: with --mission it is one of timeout"),
        (MODULES, ["nearer=1..0.5"], "nearer=1..0.5: expected LO..HI"),
        (MODULES, ["timeout=1..inf"], "timeout=1..inf: expected LO..HI"),
        (MODULES, ["timeout=0..9"], "expected bounds above 0, such as timeout"),
        (MODULES, ["reading:light=0..9"], "tb3-01 has no such reading"),
        ((" ",), [], "--mission names no pattern"),
    ],
)
def test_a_wrong_word_is_named(
    modules: tuple[str, ...], words: list[str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        mission_space(load_scenario("dispersion"), modules, words, tmp_path)


def test_a_scenario_with_parameters_of_its_pattern_is_refused(tmp_path: Path) -> None:
    scenario = load_scenario("dispersion", {"groups.tb3.parameters.speed": 0.1})
    with pytest.raises(ConfigError, match=r"groups\.tb3\.parameters are those of dispersion"):
        mission_space(scenario, MODULES, [], tmp_path)

"""Missions as candidates: each draw is a mission that robots accept and run."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.kit.conditions import is_drawn
from swarmd.mission.document import read_document
from swarmd.mission.schema import conditions
from swarmd.sim.experiments.mission_space import (
    MAX_STATES,
    MissionSpace,
    mission_file_space,
    mission_space,
)
from swarmd.sim.experiments.pool import Job, JobResult, Shares
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


def random_study(seed: int) -> Any:
    """An Optuna study that draws at random; imported here: each worker of pytest imports this."""
    import optuna

    return optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))


def test_every_draw_is_a_mission_without_faults(space: MissionSpace) -> None:
    study = random_study(1)
    kinds, states, drawn, targets = set(), set(), set(), set()
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
        for keys, condition in conditions(root):
            drawn |= {keys[-2 if "transitions" in keys else -1]} if is_drawn(condition) else set()
        targets |= {len(child.transitions or ()) for child in root.children}
    assert drawn == {"until", "transitions"}
    assert targets == {0, 1, 2}
    assert kinds == {"RunPart", "Sequence", "Switch"}
    assert states == set(range(1, MAX_STATES + 1))


def test_robots_run_what_is_drawn(space: MissionSpace) -> None:
    study = random_study(2)
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


def test_a_machine_has_probabilities_and_no_state_that_nothing_leads_to(
    space: MissionSpace,
) -> None:
    values = {
        "kind": "machine",
        **{"part_1": "random_walk", "target_1_1": 3, "condition_1_1": "not reading:light"},
        **{"bound_1_1": 0.4, "chance_1_1": 0.2, "part_3": "attraction", "target_3_1": 1},
        **{"condition_3_1": "probability", "bound_3_1": 0.05},
    }
    body = yaml.safe_load(space.mission(values))
    dark = {"all": [{"reading": "light", "below": 0.4}, {"probability": 0.2}]}
    walk, stay = "random_walk_1", "attraction_3"
    assert body["sequence"] == [
        {"part": "random_walk", "name": walk, "transitions": {stay: dark}},
        {"part": "attraction", "name": stay, "transitions": {walk: {"probability": 0.05}}},
    ]
    assert body["then"] == "stay"


GATHER = """\
mission: Walks and rests
parts: {walk: {pattern: random_walk}, rest: {pattern: drive, params: {speed: 0.0, turn: 0.0}}}
sequence:
  - {part: walk, until: {all: [{nearer: 0.5}, {probability: 0.3}]}}
  - {part: rest, transitions: {walk: {probability: 0.1}}, until: {timeout: 20}}
then: repeat
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "gather.yaml"
    path.write_text(GATHER)
    return path


def test_numbers_of_a_file_are_searched_by_dotted_key(file: Path, tmp_path: Path) -> None:
    words = ["sequence.0.until.all.0.nearer=0.3..1.5", "sequence.1.until.timeout=5,10"]
    scenario = load_scenario("dispersion")
    space = mission_file_space(scenario, file, words, tmp_path / "missions")
    assert space.present is None  # robots run dispersion
    values = {"sequence.0.until.all.0.nearer": 0.7, "sequence.1.until.timeout": 10}
    wanted = yaml.safe_load(GATHER)
    wanted["sequence"][0]["until"]["all"][0]["nearer"] = 0.7
    wanted["sequence"][1]["until"]["timeout"] = 10
    assert yaml.safe_load(space.mission(values)) == wanted
    assert yaml.safe_load(file.read_text()) == yaml.safe_load(GATHER)
    overrides = space.overrides(values)
    assert Path(overrides["plugin_dir"]).name == overrides["groups.tb3.pattern"]
    assert load_scenario("dispersion", overrides).name == "dispersion"


def test_without_a_word_all_probabilities_of_the_file_are_searched(
    file: Path, tmp_path: Path
) -> None:
    sets = {"plugin_dir": str(file.parent), "groups.tb3.pattern": "gather"}
    scenario = load_scenario("dispersion", sets)
    space = mission_file_space(scenario, file, [], tmp_path / "missions")
    keys = ["sequence.0.until.all.1.probability", "sequence.1.transitions.walk.probability"]
    assert [(one.key, one.low, one.high) for one in space.parameters] == [
        (key, 0.01, 1.0) for key in keys
    ]
    assert space.present == dict(zip(keys, (0.3, 0.1), strict=True))


def test_a_probability_that_is_no_condition_is_not_searched(file: Path, tmp_path: Path) -> None:
    more = "parameters: {probability: walk.speed}\nreport: {probability: walk.state}\n"
    file.write_text(GATHER + more)
    space = mission_file_space(load_scenario("dispersion"), file, [], tmp_path / "missions")
    keys = ["sequence.0.until.all.1.probability", "sequence.1.transitions.walk.probability"]
    assert [one.key for one in space.parameters] == keys


def test_a_dotted_name_above_a_probability_is_named(file: Path, tmp_path: Path) -> None:
    text = GATHER.replace("{part: walk, until", "{part: walk, name: go.on, until")
    file.write_text(text.replace("transitions: {walk", "transitions: {go.on"))
    with pytest.raises(ConfigError, match=r"gather.yaml: the name 'go\.on' has a dot"):
        mission_file_space(load_scenario("dispersion"), file, [], tmp_path / "missions")
    words = ["sequence.1.until.timeout=5..9"]
    assert mission_file_space(load_scenario("dispersion"), file, words, tmp_path).parameters


@pytest.mark.parametrize(
    ("old", "new", "words", "message"),
    [
        (
            "",
            "",
            ["sequence.2.until.timeout=5..9"],
            r"--param sequence\.2\.until\.timeout: .*gather",
        ),
        ("", "", ["sequence.0.until=5..9"], "expected one value there"),
        ("", "", ["nearer=5..9"], "or give a dotted key of .*gather.yaml"),
        ("", "", ["sequence.1.until.timeout=9..5"], "LO below HI"),
        ("", "", ["sequence.1.until.timeout=5..9"] * 2, "given twice"),
        ("", "", ["sequence.0.until.all.1.probability=0.5..2"], "2.0 is refused: .*up to 1"),
        ("", "", ["sequence.0.part=walk,rset"], "rset is refused: .*no part 'rset'"),
        ("probability", "probabilty", [], "gather.yaml:4: .*probabilty"),
        (", {probability: 0.3}", "", ["sequence.0.until.all.0.nearer"], "no parameter"),
    ],
)
def test_a_wrong_word_of_a_file_is_named(
    old: str, new: str, words: list[str], message: str, file: Path, tmp_path: Path
) -> None:
    file.write_text(GATHER.replace(old, new, 1) if old else GATHER)
    with pytest.raises(ConfigError, match=message):
        mission_file_space(load_scenario("dispersion"), file, words, tmp_path / "missions")


def test_a_file_without_a_probability_needs_words(file: Path, tmp_path: Path) -> None:
    file.write_text("mission: Walks\nparts: {walk: {pattern: random_walk}}\npart: walk\n")
    with pytest.raises(ConfigError, match="has no probability; name what is searched"):
        mission_file_space(load_scenario("dispersion"), file, [], tmp_path / "missions")


def last_states(trace: Trace) -> set[str]:
    assert trace.state is not None
    return {str(state) for state in trace.state[-1]}


def scored(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
    """Runs without a world: a short mission with dispersion is best."""
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
        runner=scored,
    )
    assert "dispersion" in found.best.values.values()
    assert read_document(folder / MISSION).faults == []
    assert "# Held-out seeds 2-4" in (folder / MISSION).read_text()
    scenario = load_scenario(folder / RESULT, {"duration": 0.5, "groups.tb3.count": 2})
    assert scenario.effective["groups"]["tb3"]["pattern"].startswith("m_")
    assert last_states(simulate_run(scenario, 1)) == {"running"}


def by_file(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
    """Runs without a world; the nearer a probability is to 0.5, the better."""
    for job in jobs:
        name = job.effective["groups"]["tb3"]["pattern"]
        text = (Path(job.effective["plugin_dir"]) / f"{name}.yaml").read_text()
        drawn = yaml.safe_load(text)["sequence"][0]["until"]["all"][1]["probability"]
        value = 10.0 - abs(drawn - 0.5) + job.seed
        yield JobResult(job.run, {**dict.fromkeys(METRICS), "path_length": value}, 0.01)


def test_a_tuning_of_a_file_gives_this_mission_with_better_values(
    file: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "t"
    found = tune(
        "dispersion",
        "path_length:max",
        set={"plugin_dir": str(file.parent), "groups.tb3.pattern": "gather"},
        budget=24,
        seeds=2,
        candidates=6,
        held_out=3,
        mission=str(file),
        param=["sequence.0.until.all.1.probability=0.01..1"],
        out=folder,
        runner=by_file,
    )
    best = found.best.values["sequence.0.until.all.1.probability"]
    assert found.best.number > 0
    assert abs(best - 0.5) < 0.2
    made = yaml.safe_load((folder / MISSION).read_text())
    wanted = yaml.safe_load(GATHER)
    wanted["sequence"][0]["until"]["all"][1]["probability"] = best
    assert made == wanted
    assert read_document(folder / MISSION).faults == []
    assert "# Held-out seeds 2-4" in (folder / MISSION).read_text()
    scenario = load_scenario(folder / RESULT, {"duration": 0.5, "groups.tb3.count": 2})
    assert last_states(simulate_run(scenario, 1)) == {"running"}


@pytest.mark.parametrize(
    ("modules", "words", "message"),
    [
        (("atraction",), [], "--mission: no pattern 'atraction'"),
        (MODULES, ["speed=0..1"], "--param speed: with --mission it is one of timeout"),
        (MODULES, ["nearer=1..0.5"], "nearer=1..0.5: expected LO..HI"),
        (MODULES, ["timeout=1..inf"], "timeout=1..inf: expected LO..HI"),
        (MODULES, ["probability=0.1..2"], "expected bounds up to 1"),
        (MODULES, ["neighbors=0.5..2"], "expected whole numbers"),
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

"""Scenarios by name or file, with the files that they extend."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform
from swarmd.sim.experiments.outcomes import read_outcomes
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_names, scenario_of
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.scalar_fields import GaussianField

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

SHIPPED = scenario_names()


def plain(platform: Platform) -> dict[str, Any]:
    """All values of a platform, to be compared."""
    data = asdict(platform)
    data["footprint"] = platform.footprint.tolist()
    data["scan"]["bearings"] = platform.scan.bearings.tolist()
    data["sensors"] = {name: one.tolist() for name, one in platform.sensors.items()}
    return data


def same(a: Scenario, b: Scenario, seed: int = 3) -> bool:
    """True if nothing that a run sees differs."""
    assert list(map(plain, a.robots.values())) == list(map(plain, b.robots.values()))
    assert [repr(event) for event in a.events] == [repr(event) for event in b.events]
    np.testing.assert_array_equal(a.starts(seed), b.starts(seed))
    pairs = [(robot, event.pattern) for event in a.events for robot in event.robots]
    assert all(a.parameters[robot] == b.parameters[robot] for robot, _ in pairs)
    names = "name description duration groups arena fields realism visibility radio absent"
    names += " trace_rate plugin_dir effective settings"
    differing = [name for name in names.split() if getattr(a, name) != getattr(b, name)]
    return list(a.robots) == list(b.robots) and differing == []


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_is_the_same_from_its_plain_values(name: str) -> None:
    scenario = load_scenario(name)
    again = scenario_of(json.loads(json.dumps(scenario.effective)))
    assert same(scenario, again)
    assert scenario.name == name
    assert 10 < len(scenario.description) <= 100


def test_the_scenario_of_the_tests_is_the_same_from_its_plain_values(load: Load) -> None:
    events = [
        {"at": 20, "join": "red-02"},
        {"at": 22, "place": "spare", "pose": [0, 2, 33.3]},
        {"at": 25, "param": {"speed": 0.1}, "targets": "blue"},
    ]
    changes = {
        "platforms": {"burger": {"patterns": {"attraction": {"slack": 0.1}}}},
        "parameters": {"attraction": {"spacing": 0.8}},
        "realism": {"preset": "ideal", "lidar": {"bias": 0.01}},
        "events": [{"at": 10, "run": "drive", "targets": "blue", "for": 30}, *events],
    }
    scenario = load(changes)
    assert same(scenario, scenario_of(json.loads(json.dumps(scenario.effective))))


def test_plain_values_need_no_file_any_more(load: Load, tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("extends: burger\nlimits: {linear: 0.2}")
    (tmp_path / "mine.yaml").write_text("extends: base.yaml\nlimits: {angular: 1}")
    effective = load({"groups.red.platform": "mine.yaml"}).effective
    for name in ("base.yaml", "mine.yaml", "here.yaml"):
        (tmp_path / name).unlink()
    limits = scenario_of(effective).robots["red-01"].limits
    assert (limits.linear, limits.angular) == (0.2, 1.0)
    assert str(tmp_path) not in json.dumps(effective)


def test_experiment_1_starts_as_in_the_paper() -> None:
    # Jackals stand 20 cm further apart: what is seen of them would be in their blind zones.
    for name, n, apart in (("burger", 7, 1.0), ("waffle_pi", 7, 1.0), ("jackal", 5, 1.2)):
        scenario = load_scenario(f"paper_exp1_{name}")
        expected = np.zeros((n, 3))
        expected[:, 1] = apart * np.arange(n)
        np.testing.assert_allclose(scenario.starts(1), expected)
        assert {platform.name for platform in scenario.robots.values()} == {name}
        assert (scenario.arena.length, scenario.arena.width, scenario.duration) == (18, 18, 120)


def test_the_hardware_of_experiment_1_starts_near_each_other() -> None:
    scenario = load_scenario("paper_exp1_hardware")
    for seed in range(20):
        places = scenario.starts(seed)[:, :2]
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        nearest = np.where(np.eye(7, dtype=bool), math.inf, apart).min(axis=1)
        assert np.all((nearest >= 0.62) & (nearest <= 0.8))


def test_extends_another_by_name_or_file(load: Load, tmp_path: Path) -> None:
    load()
    (tmp_path / "sub").mkdir()
    child = "extends: ../here.yaml\nduration: 20\ngroups: {red: {count: 1}}"
    (tmp_path / "sub" / "child.yaml").write_text(child)
    scenario = load_scenario(tmp_path / "sub" / "child.yaml")
    assert (scenario.name, scenario.duration) == ("child", 20.0)
    assert scenario.groups == {"red": ("red-01",), "blue": ("s-one", "s-two")}
    (tmp_path / "mine.yaml").write_text("extends: paper_exp1_burger\nduration: 5")
    assert load_scenario("mine.yaml").duration == 5.0


def test_paths_are_relative_to_their_file(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.yaml").write_text("extends: burger\nlimits: {linear: 0.1}")
    (tmp_path / "plugins").mkdir()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "child.yaml").write_text("extends: ../here.yaml")
    load({"groups.red.platform": "mine.yaml", "plugin_dir": "plugins"})
    monkeypatch.chdir(tmp_path / "sub")
    scenario = load_scenario("child.yaml")
    assert scenario.robots["red-01"].name == "mine"
    assert scenario.plugin_dir is not None
    assert scenario.plugin_dir.resolve() == tmp_path / "plugins"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("duration: 5\nduration: 6", ":2: .*'duration'"),
        ("duration: [", ":"),
        ("[1, 2]", ": .*1, 2"),
        ("", ": groups"),
        ("extends: bad.yaml", ": extends.*bad.yaml"),
        ("extends: paper_exp1_burgr", ": extends: .*'paper_exp1_burger'"),
        ("extends: 5", ": extends"),
        ("extends: paper_exp1_burger\nduration: -1", ": duration"),
        ("extends: foraging\nitems: [{name: light, at: [[1, 0]]}]", r": items\[0\].*'light'"),
        ("extends: foraging\nitems: [{name: light_1, at: [[1, 0]]}]", r": items\[0\].*'light_1'"),
        ("extends: foraging\nitems: [{name: held, at: [[1, 0]]}]", r": items\[0\].*'held'"),
    ],
)
def test_an_invalid_file_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, fault: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"^bad\.yaml{fault}") as raised:
        load_scenario("bad.yaml")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["agregation", "nowhere/none.yaml"])
def test_an_unknown_name_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        load_scenario(name)


def page_of_outcomes(folder: Path, block: str) -> None:
    """The rows of outcomes on the page can be read beside a scenario."""
    shipped = Path(__file__).parents[3] / "patterns" / "dispersion" / "scenario.yaml"
    (folder / "scenario.yaml").write_text(shipped.read_text())
    (folder / "outcomes.yaml").write_text(block)
    rows = read_outcomes(folder / "outcomes.yaml").rows
    assert [row.what.split(",")[0] for row in rows] == [
        "contacts",
        "late distance to the centroid",
    ]


def test_the_scenarios_on_the_page_about_scenarios_are_some(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "writing_experiments.md"
    blocks = re.findall(r"^```yaml\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    events = []
    for block in blocks:
        if block.startswith("scenario:"):
            page_of_outcomes(tmp_path, block)
            continue
        (tmp_path / "page.yaml").write_text(block)
        scenario = load_scenario(tmp_path / "page.yaml")
        assert scenario.starts(0).shape == (5, 3)
        events.append(len(scenario.events))
    assert events == [7, 2, 1, 1]  # the fault and its end are two


def test_an_arena_has_all_that_the_file_names(load: Load) -> None:
    assert load().arena == Arena(
        8.0,
        6.0,
        boxes=(
            Box(3.0, 2.0, 0.5, 0.4, math.pi / 4.0, "crate", 2.0),
            Box(0.0, 0.0, 0.5, 0.5, 0.0, "spare", 2.0, is_placed=False),
            Box(-3.0, 2.0, 0.5, 0.4, 0.0, "block"),
        ),
        poles=(Pole(3.0, -2.0, 0.1),),
        segments=(Segment(-3.0, -2.0, -2.0, -2.0),),
    )


def test_fields_and_radio_are_the_worlds_own(load: Load) -> None:
    scenario = load({"radio": {"neighborhood": "range", "range": 2, "loss": 0.1}})
    assert scenario.fields == (GaussianField(name="light", sigma=2.0),)
    assert (scenario.radio.neighborhood, scenario.radio.range) == ("range", 2.0)
    assert (scenario.radio.loss, scenario.radio.delay) == (0.1, 0.0)

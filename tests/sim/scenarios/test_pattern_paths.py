"""A path in place of a pattern's name: in files, overrides and events, and what is refused."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.scenarios import pattern_paths
from swarmd.sim.scenarios.scenariofile import load_scenario, read_scenario, scenario_of
from tests.sim.scenarios.conftest import Load

CODE = '''
from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about

class OwnParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0, unit="m/s")] = 0.1

class Own(MovementPattern[OwnParams]):
    """Drives."""

    params_type = OwnParams

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(self.params.speed)
'''
MISSION = "mission: Drives\nparts: {go: {pattern: wall}}\nparallel: [go]\ndrives: go\n"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with the patterns `wall`, a file, and `grad`, a folder with two modules."""
    folder = tmp_path / "mine"
    (folder / "grad").mkdir(parents=True)
    (folder / "wall.py").write_text(CODE)
    (folder / "grad" / "pattern.py").write_text(f"from .gains import TURN\n{CODE}")
    (folder / "grad" / "gains.py").write_text("TURN = 0.4\n")
    return folder


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("mine/wall.py", "wall"),
        ("mine/grad", "grad"),
        ("mine/grad/", "grad"),
        ("./mine/grad/pattern.py", "grad"),
        ("mine/../mine/wall.py", "wall"),
    ],
)
@pytest.mark.parametrize("has_file", [True, False], ids=["file", "override"])
def test_a_path_is_the_name_and_its_folder_the_plugin_dir(
    load: Load, mine: Path, text: str, name: str, has_file: bool
) -> None:
    values = {"groups.red.pattern": text}
    scenario = load(values) if has_file else load({}, values)
    assert scenario.plugin_dir == mine
    assert scenario.effective["plugin_dir"] == str(mine)
    assert scenario.effective["groups"]["red"]["pattern"] == name
    assert scenario_of(scenario.effective).effective == scenario.effective


def test_a_path_of_a_file_is_relative_to_the_file_and_one_of_an_override_to_here(
    load: Load, mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load({"groups.red.pattern": "mine/wall.py"})
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "child.yaml").write_text("extends: ../here.yaml")
    monkeypatch.chdir(tmp_path / "sub")
    assert load_scenario("child.yaml").plugin_dir == mine
    assert load_scenario("child.yaml", {"groups.red.pattern": "../mine/grad"}).plugin_dir == mine
    with pytest.raises(ConfigError, match="mine/grad"):
        load_scenario("child.yaml", {"groups.red.pattern": "mine/grad"})


def test_a_path_is_taken_wherever_a_pattern_is_named(load: Load, mine: Path) -> None:
    scenario = load(
        {
            "events.0.run": "mine/wall.py",
            "parameters": {"mine/wall.py": {"speed": 0.2}},
            "on_low_battery": {"below": 0.2, "pattern": "mine/grad"},
        }
    )
    assert scenario.plugin_dir == mine
    assert scenario.events[-1].pattern == "wall"
    assert scenario.effective["parameters"] == {"wall": {"speed": 0.2}}
    assert scenario.effective["on_low_battery"]["pattern"] == "grad"


def test_a_mission_is_named_by_its_path(load: Load, mine: Path) -> None:
    (mine / "trip.yaml").write_text(MISSION)
    scenario = load({}, {"groups.red.pattern": "mine/trip.yaml"})
    assert scenario.effective["groups"]["red"]["pattern"] == "trip"


def test_a_name_in_the_folder_of_a_path_is_known(load: Load, mine: Path) -> None:
    scenario = load({"groups.red.pattern": "mine/wall.py", "events.0.run": "grad"})
    assert scenario.plugin_dir == mine


def test_the_path_of_an_override_prevails_over_the_folder_of_the_file(
    load: Load, mine: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "own.py").write_text(CODE)
    changes = {"plugin_dir": "other", "groups.red.pattern": "own"}
    assert load(changes).plugin_dir == other
    assert load(changes, {"groups.red.pattern": "mine/wall.py"}).plugin_dir == mine


@pytest.mark.parametrize("former", ["attraction", "mine/grad"])
def test_pattern_as_an_override_replaces_the_one_pattern_of_a_scenario(
    load: Load, mine: Path, former: str
) -> None:
    changes = {
        "groups.blue.pattern": former,
        "groups.red.pattern": former,
        "groups.red.parameters": {"speed": 0.3},
        "events.0.run": former,
        "events.0.parameters": {"speed": 0.3},
    }
    if former == "attraction":
        changes |= {"groups.red.parameters": {}, "events.0.parameters": {}}
    scenario = load(changes, {"pattern": "mine/wall.py", "groups.blue.parameters.speed": 0.4})
    groups = scenario.effective["groups"]
    assert {name: group["pattern"] for name, group in groups.items()} == {
        "red": "wall",
        "blue": "wall",
    }
    assert groups["red"]["parameters"] == {}
    assert groups["blue"]["parameters"] == {"speed": 0.4}
    assert (scenario.events[-1].pattern, scenario.events[-1].parameters) == ("wall", {})


def test_pattern_of_a_file_replaces_that_of_the_file_that_it_extends(
    mine: Path, tmp_path: Path
) -> None:
    """As `exp tune --pattern` writes its result."""
    tuned = tmp_path / "tuned.yaml"
    tuned.write_text(
        "extends: aggregation\npattern: mine/wall.py\ngroups: {tb3: {parameters: {speed: 0.2}}}\n"
    )
    group = load_scenario(str(tuned)).effective["groups"]["tb3"]
    assert (group["pattern"], group["parameters"]) == ("wall", {"speed": 0.2})


def test_pattern_as_an_override_says_which_groups_it_cannot_tell_apart(
    load: Load, mine: Path
) -> None:
    with pytest.raises(ConfigError, match=r"red attraction, blue drive.*groups\.GROUP\.pattern"):
        load({"groups.blue.pattern": "drive"}, {"pattern": "mine/wall.py"})


def faults_of(folder: Path) -> Mapping[str, str]:
    """Paths at which there is no pattern, each with a word of the error."""
    (folder / "no_pattern").mkdir()
    (folder / "bin.py").write_bytes(b"\x7fELF\x00\x00\xff")
    (folder / "latin.py").write_bytes('"""für"""'.encode("latin-1"))
    (folder / "loop.py").symlink_to("loop.py")
    os.mkfifo(folder / "pipe.py")
    for name in ("a b.py", "größe.py", "test_it.py", "flocking.py", "two.py"):
        (folder / name).write_text(CODE * 2 if name == "two.py" else CODE)
    (folder / "two.py").write_text(f"{CODE}\nclass Two(Own): ...\n")
    (folder / "list.yaml").write_text("a: 1\n")
    (folder / "notes.txt").write_text("")
    return {
        "mine/absent.py": "no such file",
        "absent/wall": "no such file",
        "mine/no_pattern": "pattern.py",
        "mine/bin.py": "bin",
        "mine/latin.py": "UTF-8",
        "mine/loop.py": "loop.py",
        "mine/pipe.py": "pipe.py",
        "mine/a b.py": "'a b'",
        "mine/größe.py": "größe",
        "mine/test_it.py": "test",
        "mine/flocking.py": "two patterns",
        "mine/two.py": "exactly one",
        "mine/list.yaml": "mission",
        "./mine/notes.txt": "notes.txt",
        "mine/" + "x" * 300 + ".py": "xxx",
        "mine/\0.py": "",
        "~nobody_of_this_name/wall.py": "no such file",
    }


def test_what_is_no_pattern_at_a_path_is_refused_in_one_line(load: Load, mine: Path) -> None:
    for text, told in faults_of(mine).items():
        for key in ("pattern", "groups.red.pattern"):
            with pytest.raises(ConfigError, match=r"^--set: ") as error:
                load({"groups.blue.pattern": "attraction"}, {key: text})
            assert told in str(error.value)
            assert "\n" not in str(error.value)


def test_paths_in_several_folders_are_refused(load: Load, mine: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "own.py").write_text(CODE)
    values = {"groups.red.pattern": "mine/wall.py", "groups.blue.pattern": "other/own.py"}
    with pytest.raises(ConfigError, match="several folders") as error:
        load({}, values)
    assert all(text in str(error.value) for text in values.values())
    for names_folder in (True, False):
        same = {"plugin_dir": "other", "groups.red.pattern": "mine/wall.py"}
        with pytest.raises(ConfigError, match="plugin_dir"):
            load(same) if names_folder else load({}, same)


def test_an_unknown_name_says_how_a_file_is_named(load: Load) -> None:
    with pytest.raises(
        ConfigError, match=r"^--set: .*'wallnode'.*--pattern PATH/wallnode\.py"
    ) as e:
        load({}, {"groups.red.pattern": "wallnode"})
    assert "--plugin-dir FOLDER" in str(e.value)
    assert len(str(e.value)) < 200
    with pytest.raises(ConfigError, match="did you mean 'flocking'"):
        load({}, {"groups.red.pattern": "flokking"})


def test_the_keys_of_a_scenario_have_the_folder_of_a_path(load: Load, mine: Path) -> None:
    load()
    found = read_scenario("here.yaml", {"groups.red.pattern": Path("mine/wall.py")})
    assert found.plugin_dir == str(mine)


def test_a_complete_configuration_of_others_names_no_path(load: Load, mine: Path) -> None:
    """A manifest of others would run a file that the check of its digests does not see."""
    effective: dict[str, Any] = dict(load().effective)
    effective["groups"]["red"]["pattern"] = str(mine / "wall.py")
    with pytest.raises(ConfigError, match="is a path"):
        scenario_of(effective)


def test_overrides_with_absolute_paths_hold_in_each_folder(mine: Path, tmp_path: Path) -> None:
    here = Path.cwd()
    given = {"groups.a.pattern": "x/y.py", "plugin_dir": "x", "pattern": "drive", "duration": 3}
    assert pattern_paths.absolute(given) == {
        "groups.a.pattern": str(here / "x/y.py"),
        "plugin_dir": str(here / "x"),
        "pattern": "drive",
        "duration": 3,
    }

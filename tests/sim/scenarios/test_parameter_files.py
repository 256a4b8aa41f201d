"""A YAML file that a parameter names lies in the folder of plugins, whose files are compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings import yamlfile
from swarmd.sim.experiments.provenance import digests_of_plugins
from swarmd.sim.experiments.rerun import rerun
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from tests.support.ros2_nodes import written


def scenario(folder: Path, launch: str, **changes: Any) -> Path:
    group = {"platform": "burger", "count": 2, "pattern": "ros2_nodes"}
    data = {
        "duration": 1.0,
        "arena": {"size": [5.0, 5.0]},
        "groups": {"tb3": {**group, "parameters": {"launch": launch}}},
        "start": {"layout": "random", "clearance": 0.2},
        **changes,
    }
    file = folder / "follow.yaml"
    file.write_text(yamlfile.text_of(data))
    return file


@pytest.fixture
def nodes(tmp_path: Path) -> Path:
    return written(tmp_path / "mine")


def test_the_path_begins_at_the_scenario_and_its_folder_holds_the_plugins(nodes: Path) -> None:
    loaded = load_scenario(scenario(nodes.parent, "mine/all.yaml"))
    assert loaded.plugin_dir == nodes
    assert loaded.effective["groups"]["tb3"]["parameters"]["launch"] == str(nodes / "all.yaml")
    assert scenario_of(loaded.effective).plugin_dir == nodes


def test_an_override_begins_at_the_working_directory(
    nodes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = scenario(nodes, "all.yaml").rename(nodes / "at.yaml")
    monkeypatch.chdir(nodes.parent)
    loaded = load_scenario(file, {"groups.tb3.parameters.launch": "mine/all.yaml"})
    assert loaded.effective["groups"]["tb3"]["parameters"]["launch"] == str(nodes / "all.yaml")


def test_a_file_below_the_given_folder_is_taken(nodes: Path) -> None:
    file = scenario(nodes.parent, "mine/all.yaml", plugin_dir=".")
    assert load_scenario(file).plugin_dir == nodes.parent


@pytest.mark.parametrize("elsewhere", [{"plugin_dir": "other"}, {"parameters": {}}])
def test_a_file_elsewhere_is_refused_with_its_key(nodes: Path, elsewhere: dict[str, Any]) -> None:
    (nodes.parent / "other").mkdir()
    second = {"ros2_nodes": {"launch": "other/nodes.yaml"}}
    changes = elsewhere if "plugin_dir" in elsewhere else {"parameters": second}
    with pytest.raises(ConfigError, match="launch"):
        load_scenario(scenario(nodes.parent, "mine/all.yaml", **changes))


@pytest.mark.parametrize("folder", [None, "/nowhere", "{mine}/walls"])
def test_a_complete_configuration_of_others_names_no_file_elsewhere(
    nodes: Path, folder: str | None
) -> None:
    """Its `plugin_dir` alone is compared with what the user has run (`experiments.trust`)."""
    effective = load_scenario(scenario(nodes.parent, "mine/all.yaml")).effective
    given = folder and folder.format(mine=nodes)
    with pytest.raises(ConfigError, match="plugin_dir"):
        scenario_of({**effective, "plugin_dir": given})


def test_a_launch_file_is_compared_as_code_is(nodes: Path) -> None:
    digests = digests_of_plugins(nodes)
    assert {"all.yaml", "vote.py", "walls/scan_follower.py"} <= digests.keys()
    assert "follower.yaml" not in digests
    (nodes / "all.yaml").write_text("nodes: [{run: other}]\n")
    assert digests_of_plugins(nodes)["all.yaml"] != digests["all.yaml"]


@pytest.mark.integration
def test_nodes_that_were_run_are_run_again_and_changed_ones_are_not(
    nodes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(nodes.parent / "state"))
    out = nodes.parent / "out"
    simulate(scenario(nodes.parent, "mine/all.yaml"), seeds=1, set={"duration": 0.4}, out=out)
    assert rerun(out, None, 1) == {"s0000": ""}
    for name in ("all.yaml", "vote.py"):
        text = (nodes / name).read_text()
        (nodes / name).write_text(f"{text}# other\n")
        with pytest.raises(ConfigError, match=f"{name} has changed.*--trust"):
            rerun(out, None, 1)
        (nodes / name).write_text(text)

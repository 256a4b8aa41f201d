"""Parameter files of ROS2swarm become runs of patterns, and what is left out is named."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.drivers.ros2swarm.parameter_file import COUNTERPARTS, read_parameter_file
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
from tests.support.swarmctl import swarmctl

HEAD = "/**:\n  ros__parameters:\n"
ATTRACTION = """\
    attraction_max_range: 2.0 # m
    attraction_min_range: 0.12
    attraction_front_attraction: -1.0
    attraction_threshold: 1
    attraction_linear_if_alone: 0.0
    attraction_angular_if_alone: 1.0
    max_translational_velocity: 0.26
    max_rotational_velocity: 1.82
"""
VOTE = """\
    voter_model_choose_start_value_at_random: RANDOM
    voter_model_initial_value: 3
    voter_model_min_opinion: 2
    voter_model_max_opinion: 5
    voter_model_timer_period: 2.0
"""


def written(folder: Path, text: str, name: str = "attraction_pattern") -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.integration
def test_a_file_of_ros2swarm_runs(tmp_path: Path) -> None:
    file = written(tmp_path, HEAD + ATTRACTION)
    done = swarmctl("import", "ros2swarm", str(file))
    assert (done.code, done.err) == (
        0,
        "attraction_min_range: left out: `scan.range_min` of the platform file takes its place\n",
    )
    converted = read_parameter_file(file)
    settings = [f"{name}={value}" for name, value in converted.parameters.items()]
    words = [word for setting in settings for word in ("-p", setting)]
    assert shlex.split(done.out) == ["swarmctl", "run", "attraction", "--all", *words]
    overrides = {"groups.all.parameters": dict(converted.parameters), "duration": 1.0}
    trace = simulate_run(load_scenario("paper_exp1_waffle_pi", overrides), 0)
    assert set(trace.state[-1]) == {"running"}  # type: ignore[index]


@pytest.mark.parametrize("node", [node for node, one in COUNTERPARTS.items() if one.pattern])
def test_each_name_is_a_parameter_of_its_pattern(node: str) -> None:
    counterpart = COUNTERPARTS[node]
    known = {name: (one.value, one.is_file) for name, one in pattern_names(None).items()}
    fields = PatternLoader(known)(counterpart.pattern).params_type.__struct_fields__
    assert {*counterpart.fixed, *counterpart.names.values()} <= {*fields}
    assert not counterpart.names.keys() & counterpart.without.keys()
    if node in ("majority_rule", "voter_model", "discussed_dispersion"):
        assert {"opinions", "initial"} <= {*fields}


@pytest.mark.parametrize(
    ("is_random", "initial"), [("true", {}), ("false", {"initial": 1})], ids=["random", "given"]
)
def test_opinions_count_from_0(tmp_path: Path, is_random: str, initial: dict[str, int]) -> None:
    file = written(tmp_path, HEAD + VOTE.replace("RANDOM", is_random), "votes")
    converted = read_parameter_file(file)
    assert converted.pattern == "voter_model"
    assert converted.parameters == {"window": 2.0, "opinions": 3, **initial}
    assert converted.notes == ("opinion 0 here is opinion 2 of ROS2swarm",)
    assert converted.left_out == {}


def test_what_belongs_to_another_node_is_left_out(tmp_path: Path) -> None:
    file = written(tmp_path, HEAD + ATTRACTION + "    voter_model_max_opinion: 5\n")
    converted = read_parameter_file(file)
    assert "opinions" not in converted.parameters
    assert "voter_model_max_opinion" in converted.left_out
    text = HEAD + VOTE.replace("RANDOM", "true") + "    voter_model_color: 5\n"
    assert read_parameter_file(written(tmp_path, text, "votes")).left_out.keys() == {
        "voter_model_color"
    }


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("attraction_pattern", "", "attraction_pattern.yaml"),
        ("attraction_pattern", "a: [1", "attraction_pattern.yaml"),
        ("README", "a: [b] c", "expected a parameter file of ROS2swarm"),
        ("attraction_pattern", "a: {ros__parameters: 3}", "0 nodes with `ros__parameters`"),
        ("attraction_pattern", HEAD + ATTRACTION + "b:\n  ros__parameters: {x: 1}\n", "2 nodes"),
        ("attraction_pattern", HEAD + ATTRACTION + ATTRACTION, "attraction_max_range"),
        ("attraction_pattern", HEAD + "    attraction_max_range: far\n", "expected a number"),
        ("attraction_pattern", HEAD + "    attraction_max_range: true\n", "expected a number"),
        ("attraction_pattern", HEAD + "    attraction_max_range: &x 1.0\n", "attraction_pattern"),
        ("votes", HEAD + VOTE.replace("max_opinion: 5", "max_opinion: 2"), "expected more than 2"),
        ("votes", HEAD + VOTE.replace("max_opinion: 5", "max_opinion: 4.5"), "expected an integer"),
        ("votes", HEAD + VOTE.replace("RANDOM", "'no'"), "expected true or false"),
        ("votes", HEAD + VOTE.replace("RANDOM", "false").replace("3", "5"), "expected 2 to 4"),
        ("votes", HEAD + "    voter_model_timer_period: 2.0\n", "no voter_model_max_opinion"),
        ("attraction_pattern", HEAD + "    attraction_max_range: .nan\n", "expected a number"),
        ("flocking_pattern", HEAD + "    magnetometer_front_attraction: 0.0\n", "flocking has no"),
        ("beeclust_pattern", HEAD + "    beeclust_max_range: 1.5\n", "beeclust has no counterpart"),
        ("aggregation_pattern", HEAD + "    aggregation_max_range: 3.5\n", "has no counterpart"),
        ("nothing", HEAD + "    something: 1\n", "no node of ROS2swarm 'nothing'"),
    ],
)
def test_what_cannot_be_converted_is_one_line(
    tmp_path: Path, name: str, text: str, wanted: str
) -> None:
    file = written(tmp_path, text, name)
    with pytest.raises(ConfigError) as caught:
        read_parameter_file(file)
    assert wanted in str(caught.value)
    done = swarmctl("import", "ros2swarm", str(file))
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)


@pytest.mark.integration
@pytest.mark.parametrize(
    ("value", "wanted"),
    [("max_range: -2.0", "paper_range is -2.0"), ("threshold: 1.5", "rays is 1.5")],
)
def test_a_value_out_of_bounds_is_no_run(tmp_path: Path, value: str, wanted: str) -> None:
    file = written(tmp_path, f"{HEAD}    attraction_{value}\n")
    done = swarmctl("import", "ros2swarm", str(file))
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1), done
    assert wanted in done.err

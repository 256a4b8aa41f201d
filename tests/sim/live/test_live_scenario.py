"""The same scenario live as in lockstep: world, robots, parameters, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.settings.settings import load_daemon_settings
from swarmd.sim.live.fleet import FleetSpec, Ready, daemon_config
from swarmd.sim.live.live_scenario import SCENARIO_FILE, LiveScenario, check_live
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from swarmd.sim.scenarios.simulation import world_of
from swarmd.sim.trace import load_trace
from tests.sim.conftest import Refusal, Swarmctl
from tests.support.processes import run_command

READY = Ready("tcp/127.0.0.1:1", "simulated", {"endpoint": "tcp/127.0.0.1:1"})
SCENARIO = """
duration: 4
arena: {size: [8, 8], boxes: [{at: [2, 2], size: [0.5, 0.5]}]}
radio: {loss: 0.5, delay: 0.05, range_and_bearing: true}
fields: [{kind: linear, name: light, slope: 1.0, base: 5.0}]
platforms:
  slow:
    extends: burger
    limits: {linear: 0.1}
    sensors: {detections: [{at: [0, 0], field_of_view_deg: 60, range: 3}]}
parameters: {random_walk: {speed: 0.08}}
groups:
  a: {platform: slow, count: 2, pattern: climb, parameters: {gain: 2.0}, start: {layout: random}}
  b: {platform: waffle_pi, count: 1, start: {layout: random, clearance: 0.5}}
events:
  - {at: 1, run: climb, targets: b}
  - {at: 3, param: {gain: 3.0}, targets: a}
accepts_faster: {waffle_pi: it keeps to 0.3 m/s here}
plugin_dir: patterns
"""
CLIMB = '''
from collections import Counter

from swarmd.api import Annotated, Inputs, Outputs, Params, Pattern, Twist, about

class Gain(Params, frozen=True):
    """The gain."""

    gain: Annotated[float, about("gain", ge=0.0, le=10.0)] = 1.0

class Climb(Pattern[Gain]):
    """Reports the light, how many neighbors are sensed, and the share of messages that arrive."""

    params_type = Gain
    needs = frozenset({"reading:light", "neighbors.distance"})
    channels = {"count": int}

    def __init__(self, params, context):
        super().__init__(params, context)
        self.sent, self.heard, self.first, self.last = 0, 0, {}, {}

    def step(self, inputs: Inputs) -> Outputs:
        self.sent += 1
        for message in inputs.messages:
            self.heard += 1
            self.first.setdefault(message.sender, message.value)
            self.last[message.sender] = message.value
        expected = sum(self.last[one] - self.first[one] + 1 for one in self.last)
        report = {
            "seen": inputs.readings.get("light", -1.0),
            "near": sum(one.distance is not None for one in inputs.neighbors),
            "share": self.heard / max(expected, 1),
        }
        return Outputs(Twist(linear=0.02 * self.params.gain), {"count": self.sent}, report)
'''


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "patterns").mkdir()
    (tmp_path / "patterns" / "climb.py").write_text(CLIMB)
    path = tmp_path / "light.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture
def scenario(file: Path) -> Scenario:
    return load_scenario(file)


def files(scenario: Scenario, folder: Path) -> dict[str, dict[str, object]]:
    """The files of all daemons, as a fleet writes them."""
    live = LiveScenario(scenario)
    folder.mkdir()
    live.write(folder)
    robots = {robot: platform.name for robot, platform in scenario.robots.items()}
    spec = FleetSpec(
        swarm="s", robots=robots, folder=folder, live=live,
        plugin_dir=scenario.plugin_dir,
    )  # fmt: skip
    return {robot: daemon_config(spec, robot, READY) for robot in robots}


def test_the_world_of_the_file_is_that_of_lockstep(scenario: Scenario, tmp_path: Path) -> None:
    files(scenario, tmp_path / "logs")
    written = json.loads((tmp_path / "logs" / SCENARIO_FILE).read_text())
    live = world_of(scenario_of(written), 7)
    lockstep = Lockstep(scenario, 7).world
    assert live.ids == lockstep.ids
    np.testing.assert_array_equal(live.poses(), lockstep.poses())
    assert [live.readings(row) for row in range(3)] == [lockstep.readings(row) for row in range(3)]
    assert live.arena == lockstep.arena
    rows = np.arange(3)
    for one, other in zip(live.scans(rows), lockstep.scans(rows), strict=True):
        np.testing.assert_array_equal(one.ranges, other.ranges)


@pytest.mark.parametrize("realism", ["realistic", "ideal"])
def test_daemons_are_configured_as_the_robots_of_lockstep(
    file: Path, tmp_path: Path, realism: str
) -> None:
    scenario = load_scenario(file, {"realism": realism})
    lockstep = Lockstep(scenario, 0)
    for row, (robot, config) in enumerate(files(scenario, tmp_path / "logs").items()):
        path = tmp_path / f"{robot}.yaml"
        path.write_text(yaml.safe_dump(config))
        settings = load_daemon_settings(path, {}, {})
        wanted, got = lockstep._platforms[row], settings.platform
        assert (got.name, got.limits, got.provides) == (wanted.name, wanted.limits, wanted.provides)
        assert (got.scan.is_noisy, got.scan.sweep) == (wanted.scan.is_noisy, wanted.scan.sweep)
        assert settings.robot == scenario.settings[robot]
        for pattern in ("climb", "random_walk"):
            live = _flat(settings.parameters.layers(pattern, settings.labels))
            assert live == _flat(scenario.parameters[robot].layers(pattern, ()))


def _flat(layers: Any) -> dict[str, object]:
    return {name: value for _, values in layers for name, value in values.items()}


@pytest.mark.parametrize(
    ("overrides", "emulator", "key"),
    [
        ({"groups.a.count": 50}, None, "groups"),
        ({}, "ros2dds", "radio.loss"),
    ],
)
def test_what_cannot_be_done_live_is_refused_with_its_key(
    file: Path, overrides: dict[str, Any], emulator: str | None, key: str
) -> None:
    scenario = load_scenario(file, {"events": [], "groups.a.start.size": [7, 7], **overrides})
    with pytest.raises(ConfigError) as caught:
        check_live(scenario, 50, emulator)
    assert f" {key}: " in str(caught.value)


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["demo", "lihgt.yaml"], "lihgt.yaml"),
        (["demo", "agregation"], "'aggregation'"),
        (["demo", "light.yaml", "-n", "3"], "groups.GROUP.count"),
        (["demo", "light.yaml", "--seconds", "3"], "duration"),
        (["demo", "light.yaml", "--set", "duratoin=3"], "'duration'"),
        (["demo", "--set", "duration=3"], "SCENARIO"),
        (["sim", "up", "light.yaml", "--platform", "burger"], "groups.GROUP.platform"),
        (["sim", "up", "light.yaml", "--set", "groups.a.count=60"], "61"),
    ],
)
def test_a_wrong_scenario_or_option_is_one_line_and_starts_nothing(
    file: Path, refusal: Refusal, words: list[str], subject: str
) -> None:
    assert subject in refusal(*words)


@pytest.mark.integration
def test_a_demo_of_a_scenario_leaves_its_results_and_is_measured(
    file: Path, swarmctl: Swarmctl
) -> None:
    words = ("light.yaml", "--seed", "3", "-o", "json")
    done = run_command("swarmctl", "demo", *words, cwd=file.parent)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert [event["action"] for event in answer["events"]] == ["run climb", "param"]
    assert (answer["scenario"], answer["seed"]) == ("light", 3)
    assert (answer["apiVersion"], answer["problems"]) == ("swarm/v1", [])
    assert answer["seconds"] == pytest.approx(4.0, abs=0.15)
    assert answer["metrics"]["robot_contacts"] == 0
    assert answer["seconds_to_moving"] > 0.0
    folder = file.parent / answer["folder"]
    assert json.loads((folder / "summary.json").read_text())["robots"] == answer["robots"]
    assert (folder / "trajectories.png").read_bytes().startswith(b"\x89PNG")
    trace = load_trace(folder / "trace.npz")
    start = load_scenario(file).starts(3)
    # The first sample is up to 0.1 s after the start, at less than 0.05 m/s.
    np.testing.assert_allclose(trace.pose[0], start, atol=0.01)
    light, seen = trace.readings["light"][-1], trace.report["seen"][-1]
    np.testing.assert_allclose(light, 5.0 + trace.pose[-1, :, 0], atol=0.1)
    np.testing.assert_allclose(seen, light, atol=0.1)
    assert answer["metrics"]["report:seen.mean_end"] == pytest.approx(seen.mean())
    # On a busy machine a neighbor may be silent for a while, also at the end.
    assert np.nanmax(trace.report["near"], axis=0).tolist() == [2.0, 2.0, 2.0]
    # The loss is 0.5, and some forty messages are on their way to each robot.
    assert 0.15 < trace.report["share"][-1].mean() < 0.85
    path = str(folder / "trace.npz")
    metrics = ("--metrics", "mean_speed,report:seen", "-o", "json")
    measured = swarmctl("exp", "measure", path, *metrics)
    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)["traces"][path]
    assert found["mean_speed"] > 0.0
    assert found["report:seen"] == pytest.approx(5.0 + trace.pose[-1, :, 0].mean(), abs=1.0)

"""swarm.yaml, as daemons and swarmctl read it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.settings.swarmfile import load_swarm


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "swarm.yaml"


def load(file: Path, data: dict[str, Any], **overrides: object) -> Any:
    file.write_text(yaml.safe_dump(data))
    return load_swarm(file, overrides, {})[0]


def test_reads_all_keys(file: Path) -> None:
    swarm = load(
        file,
        {
            "swarm": "lab",
            "profile": "field",
            "interface": "wlan0",
            "seeds": ["tcp/10.0.0.5:7447", "tls/[fe80::1%wlan0]:7447"],
            "multicast": False,
            "lease": 4,
            "roster": ["r1", "r2"],
            "labels": {"red": ["r1"]},
            "parameters": {"labels": {"red": {"drive": {"linear": 0.1}}}},
        },
    )
    assert (swarm.swarm, swarm.profile, swarm.interface) == ("lab", "field", "wlan0")
    assert swarm.seeds == ("tcp/10.0.0.5:7447", "tls/[fe80::1%wlan0]:7447")
    assert (swarm.multicast, swarm.lease) == (False, 4.0)
    assert swarm.parameters.labels == {"red": {"drive": {"linear": 0.1}}}


def test_overrides_win_and_the_environment_is_the_weakest(file: Path) -> None:
    file.write_text("swarm: lab")
    assert load_swarm(file, {"swarm": "other"}, {"SWARM": "env"})[0].swarm == "other"
    assert load_swarm(file, {"swarm": None}, {"SWARM": "env"})[0].swarm == "lab"
    assert load_swarm(None, {}, {"SWARM": "env"})[0].swarm == "env"
    assert load_swarm(None, {}, {"SWARM": ""})[0].swarm == "default"


def test_takes_the_file_of_a_daemon_as_well(file: Path) -> None:
    assert load(file, {"swarm": "lab", "id": "r1", "platform": "burger"}).swarm == "lab"


FENCE = {"frame": "mocap", "polygon": [[0, 0], [4, 0], [4, 4], [0, 4]]}
PUSH = {"half_width_deg": 20, "speed": 0.1}


@pytest.mark.parametrize(
    ("data", "subjects"),
    [
        ({"swarm": "La b"}, ["swarm is 'La b'"]),
        ({"swarm": "a/*"}, ["swarm is 'a/*'"]),
        ({"swarms": "lab"}, ["no key 'swarms'; did you mean 'swarm'?"]),
        ({"profile": "feld"}, ["profile is 'feld'", "dev", "field"]),
        ({"profile": "field"}, ["profile field", "interface"]),
        ({"seeds": ["10.0.0.5"]}, ["seeds[0] is '10.0.0.5'"]),
        ({"listen": ["tcp/x"]}, ["listen[0] is 'tcp/x'"]),
        ({"lease": 0}, ["lease is 0", "0.2"]),
        ({"roster": ["r1", "R2"]}, ["roster[1] is 'R2'"]),
        ({"roster": ["r1", "r1"]}, ["roster", "'r1' twice"]),
        ({"labels": {"Red": ["r1"]}}, ["labels.Red is 'Red'"]),
        ({"roster": ["r1", "r2"], "labels": {"red": ["r3"]}}, ["labels.red", "'r3'", "r1, r2"]),
        (
            {"labels": {"red": []}, "parameters": {"labels": {"rot": {}}}},
            ["parameters.labels.rot", "'rot'", "red"],
        ),
        (
            {"roster": ["r1"], "parameters": {"robots": {"r12": {}}}},
            ["parameters.robots.r12", "'r12'", "'r1'"],
        ),
        (
            {"parameters": {"robots": {"r1": {"drive": {"linear": [1]}}}}},
            ["parameters.robots.r1.drive.linear is [1]"],
        ),
        ({"touch": {"push": {**PUSH, "speed": 0.31}}}, ["touch.push.speed is 0.31", "0.3"]),
        ({"touch": {"push": {**PUSH, "half_width_deg": 61}}}, ["push.half_width_deg is 61", "60"]),
        ({"fence": {**FENCE, "polygn": []}}, ["no key 'polygn'", "'polygon'"]),
        ({"fence": {"polygon": FENCE["polygon"]}}, ["fence.frame is missing"]),
        (
            {"fence": {**FENCE, "polygon": [[0, 0], [1, 0]]}},
            ["fence.polygon has 2 corners; expected at least 3"],
        ),
        ({"fence": {**FENCE, "without_pose": "stop"}}, ["without_pose is 'stop'", "hold", "drive"]),
        (
            {"fence": {**FENCE, "polygon": [[0, 0], [2, 2], [2, 0], [0, 2]]}},
            ["fence.polygon crosses itself", "[0, 0] to [2, 2]", "[2, 0] to [0, 2]"],
        ),
        (
            {"fence": {**FENCE, "keep_out": [[[0, 0], [1, 0], [1, 0]]]}},
            ["fence.keep_out[0] has two equal corners: [1, 0]"],
        ),
        ({"on_low_battery": {}}, ["on_low_battery.below is missing"]),
        ({"on_low_battery": {"below": 20}}, ["on_low_battery.below is 20"]),
        (
            {"on_low_battery": {"below": 0.3, "recovered": 0.3}},
            ["on_low_battery.recovered is 0.3; expected more than below (0.3)"],
        ),
        ({"on_low_battery": {"below": 0.95}}, ["on_low_battery.recovered is 1.05"]),
        (
            {"on_low_battery": {"below": 0.3, "pattern": "Go Home"}},
            ["on_low_battery.pattern is 'Go Home'"],
        ),
    ],
)
def test_a_wrong_value_is_refused_in_one_line(
    file: Path, data: dict[str, Any], subjects: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        load(file, data)
    text = str(caught.value)
    assert text.startswith("swarm.yaml: ")
    assert all(subject in text for subject in subjects)
    assert "\n" not in text


def test_a_missing_swarm_file_is_refused(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"^none\.yaml"):
        load(file, {"swarm_file": "none.yaml"})


def test_a_fault_on_the_command_line_names_the_option(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"^--seed: seeds\[0\]"):
        load(file, {}, seeds=["x"])


def test_a_fault_in_the_environment_names_the_variable() -> None:
    with pytest.raises(ConfigError, match=r"^\$SWARM: swarm"):
        load_swarm(None, {}, {"SWARM": "a b"})


@pytest.mark.integration
def test_is_read_without_numpy() -> None:
    code = "import sys, swarmd.settings.swarmfile; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

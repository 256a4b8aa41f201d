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
    return load_swarm(file, overrides, {})


def test_gives_what_the_file_says(file: Path) -> None:
    swarm = load(
        file,
        {
            "swarm": "lab",
            "profile": "field",
            "interface": "wlan0",
            "seeds": ["tcp/10.0.0.5:7447", "tls/[fe80::1]:7447"],
            "multicast": False,
            "lease": 4,
            "roster": ["r1", "r2"],
            "labels": {"red": ["r1"]},
            "parameters": {"labels": {"red": {"drive": {"linear": 0.1}}}},
        },
    )
    assert (swarm.swarm, swarm.profile, swarm.interface) == ("lab", "field", "wlan0")
    assert swarm.seeds == ("tcp/10.0.0.5:7447", "tls/[fe80::1]:7447")
    assert (swarm.multicast, swarm.lease) == (False, 4.0)
    assert swarm.parameters.labels == {"red": {"drive": {"linear": 0.1}}}


def test_overrides_win_and_the_environment_is_the_weakest(file: Path) -> None:
    file.write_text("swarm: lab")
    assert load_swarm(file, {"swarm": "other"}, {"SWARM": "env"}).swarm == "other"
    assert load_swarm(file, {"swarm": None}, {"SWARM": "env"}).swarm == "lab"
    assert load_swarm(None, {}, {"SWARM": "env"}).swarm == "env"
    assert load_swarm(None, {}, {"SWARM": ""}).swarm == "default"


def test_takes_the_file_of_a_daemon_as_well(file: Path) -> None:
    assert load(file, {"swarm": "lab", "id": "r1", "platform": "burger"}).swarm == "lab"


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ({"swarm": "La b"}, "swarm.yaml: swarm is 'La b'; wanted are 1 to 63 of a-z"),
        ({"swarm": "a/*"}, "swarm.yaml: swarm is 'a/*'; wanted"),
        ({"swarms": "lab"}, "swarm.yaml: no key 'swarms'; did you mean 'swarm'?"),
        ({"profile": "feld"}, "swarm.yaml: profile is 'feld'; wanted dev or field"),
        ({"profile": "field"}, "swarm.yaml: profile field needs `interface`: the network"),
        ({"seeds": ["10.0.0.5"]}, "swarm.yaml: seeds[0] is '10.0.0.5'; wanted an endpoint such"),
        ({"listen": ["tcp/x"]}, "swarm.yaml: listen[0] is 'tcp/x'; wanted an endpoint such as"),
        ({"lease": 0}, "swarm.yaml: lease is 0; wanted a number of at least 0.2 and up to 60"),
        ({"roster": "r1"}, "swarm.yaml: roster is 'r1'; wanted a list, each text"),
        ({"roster": ["r1", "R2"]}, "swarm.yaml: roster[1] is 'R2'; wanted are"),
        ({"roster": ["r1", "r1"]}, "swarm.yaml: roster names 'r1' twice; keep one"),
        ({"labels": {"Red": ["r1"]}}, "swarm.yaml: labels.Red is 'Red'; wanted are"),
        (
            {"roster": ["r1", "r2"], "labels": {"red": ["r3"]}},
            "swarm.yaml: labels.red: no robot in the roster 'r3'; there are: r1, r2",
        ),
        (
            {"labels": {"red": []}, "parameters": {"labels": {"rot": {}}}},
            "swarm.yaml: parameters.labels: no label 'rot'; there are: red",
        ),
        (
            {"roster": ["r1"], "parameters": {"robots": {"r12": {}}}},
            "swarm.yaml: parameters.robots.r12: no robot in the roster 'r12'; did you mean 'r1'?",
        ),
        (
            {"parameters": {"robots": {"r1": {"drive": {"linear": [1]}}}}},
            "swarm.yaml: parameters.robots.r1.drive.linear is [1]; wanted",
        ),
        (
            {"touch": {"push": {"half_width_deg": 20, "speed": 0.31}}},
            "swarm.yaml: touch.push.speed is 0.31; wanted a number above 0 and up to 0.3",
        ),
        (
            {"touch": {"push": {"half_width_deg": 61, "speed": 0.1}}},
            "swarm.yaml: touch.push.half_width_deg is 61; wanted a number above 0 and up to 60",
        ),
        (
            {"touch": {"push": {"speed": 0.1}}},
            "swarm.yaml: touch.push.half_width_deg is missing; wanted a number above 0",
        ),
        (
            {"touch": {"push": {"half_width": 20, "speed": 0.1}}},
            "swarm.yaml: touch.push has no key 'half_width'; did you mean 'half_width_deg'?",
        ),
        ({"touch": {"push": True}}, "swarm.yaml: touch.push is True; wanted keys and values:"),
        ({"swarm_file": "none.yaml"}, "none.yaml: cannot be read: No such file"),
    ],
)
def test_refuses_in_one_line(file: Path, data: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(file, data)
    assert str(caught.value).startswith(fault)
    assert "\n" not in str(caught.value)


def test_a_fault_on_the_command_line_names_the_option(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"^--seed: seeds\[0\] is 'x'; wanted an endpoint"):
        load(file, {}, seeds=["x"])


def test_a_fault_in_the_environment_names_the_variable() -> None:
    with pytest.raises(ConfigError, match=r"^\$SWARM: swarm is 'a b'; wanted"):
        load_swarm(None, {}, {"SWARM": "a b"})


def test_is_read_without_numpy() -> None:
    code = "import sys, swarmd.settings.swarmfile; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

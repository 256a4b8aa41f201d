"""The ROS 2 package `swarmd_bringup`: launch files start commands that we have. `.ci/try-bringup`
builds it, and `ros2/test_endings.py` runs robot.launch.xml."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from swarmd.operator.cli.daemon import exit_code_of, swarmd
from swarmd.operator.cli.swarmctl import cli as swarmctl
from swarmd.operator.cli.swarmctl import run_cli
from tests.support.launch_files import PACKAGE, executables
from tests.support.swarmctl import parse_line

LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.launch.xml"))
ROBOT = PACKAGE / "launch/robot.launch.xml"
BRIDGE = ["swarmd", "hub", "zenoh-bridge-ros2dds"]
NEEDED = {"pattern": "dispersion", "robot": "tb3-01"}
"""Values of arguments without a default."""


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name.split(".")[0])
def test_a_launch_file_starts_commands_that_we_have(file: Path) -> None:
    arguments = {one.attrib["name"] for one in ElementTree.parse(file).getroot().iter("arg")}
    given = {name: value for name, value in NEEDED.items() if name in arguments}
    commands = [one.words for one in executables(file, given)]
    assert len([words for words in commands if words[:3] != BRIDGE]) == 1
    for program, *words in commands:
        parse_line({"swarmctl": swarmctl, "swarmd": swarmd}[program], words)


def effective(capsys: pytest.CaptureFixture[str], **given: str) -> dict[str, object]:
    """The settings of the daemon that robot.launch.xml starts."""
    (daemon,) = executables(ROBOT, {"bridge": "false", **given})
    words = [*daemon.words[1:], "--print-effective-config"]
    assert run_cli(swarmd, words, "swarmd", exit_code_of) == 0
    found = yaml.safe_load(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_the_file_counts_where_no_argument_of_the_launch_file_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "field.yaml"
    network = "swarm: meadow\nprofile: field\ninterface: lo\ninsecure: true\n"
    config.write_text(f"{network}id: tb3-07\nplatform: waffle_pi\ndriver: ros2dds\n")
    names = ("id", "swarm", "profile", "interface", "platform")
    found = effective(capsys, config=str(config))
    assert [found[name] for name in names] == ["tb3-07", "meadow", "field", "lo", "waffle_pi"]
    given = {"robot": "r1", "swarm": "s", "profile": "dev", "platform": "jackal"}
    found = effective(capsys, config=str(config), **given)
    assert [found[name] for name in names] == ["r1", "s", "dev", "lo", "jackal"]


def test_the_file_of_the_package_is_that_of_a_burger_behind_a_bridge(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = effective(capsys, robot="tb3-01")
    assert (found["platform"], found["driver"], found["profile"]) == ("burger", "ros2dds", "dev")

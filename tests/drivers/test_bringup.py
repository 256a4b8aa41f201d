"""The ROS 2 package `swarmd_bringup`: colcon builds it, and launch files start our commands."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import click
import pytest

from swarmd.cli.daemon import swarmd as swarmd
from swarmd.cli.swarmctl import cli as swarmctl
from tests.support.processes import CAP

PACKAGE = Path(__file__).parents[2] / "drivers" / "swarmd_bringup"
LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.launch.xml"))
NEEDED = {"pattern": "dispersion", "robot": "tb3-01"}
"""Values of arguments without a default."""
# The elements and attributes that launch_xml knows, as far as the files use them.
KNOWN = {
    "launch": set[str](),
    "arg": {"name", "default", "description"},
    "executable": {"name", "cmd", "output", "if"},
    "env": {"name", "value"},
}
VARIABLE = re.compile(r"\$\(var (\w+)\)")


def filled(text: str, values: Mapping[str, str]) -> str:
    """A text with its variables; KeyError for one that no <arg> declares."""
    text = VARIABLE.sub(lambda match: values[match[1]], text)
    text = text.replace("$(find-pkg-share swarmd_bringup)", str(PACKAGE))
    return text.replace("$(env ROS_DOMAIN_ID 0)", "0")


def parse(command: click.Command, context: click.Context | None, words: list[str]) -> None:
    """Parse the words of a command line down to its verb, and run nothing; UsageError if wrong."""
    made = command.make_context(command.name, words, parent=context)
    if isinstance(command, click.Group) and made._protected_args:
        rest = [*made._protected_args, *made.args]
        _, verb, rest = command.resolve_command(made, rest)
        assert verb is not None
        parse(verb, made, rest)


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name.split(".")[0])
def test_a_launch_file_starts_commands_that_we_have(file: Path) -> None:
    root = ElementTree.parse(file).getroot()
    values = dict(NEEDED)
    for element in root.iter():
        assert set(element.attrib) <= KNOWN[element.tag], element.tag
        if element.tag == "arg":
            name = element.attrib["name"]
            if "default" in element.attrib:
                values[name] = filled(element.attrib["default"], values)
            assert name in values, name
    commands = [shlex.split(filled(one.attrib["cmd"], values)) for one in root.iter("executable")]
    ours = [words for words in commands if words[0] != "zenoh-bridge-ros2dds"]
    assert len(ours) == 1
    parse({"swarmctl": swarmctl, "swarmd": swarmd}[ours[0][0]], None, ours[0][1:])


@pytest.mark.integration
def test_colcon_builds_the_package_and_its_scripts_run(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "src" / PACKAGE.name)
    colcon = Path(sys.executable).with_name("colcon")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environ = {**os.environ, "PATH": path, "COLCON_HOME": str(tmp_path / "colcon")}
    done = subprocess.run(
        [colcon, "--log-base", "log", "build", "--executor", "sequential"],
        cwd=tmp_path,
        env=environ,
        capture_output=True,
        text=True,
        timeout=CAP,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    installed = tmp_path / "install" / PACKAGE.name
    share = installed / "share" / PACKAGE.name
    names = sorted(file.name for file in (share / "launch").iterdir())
    assert names == [file.name for file in LAUNCH_FILES]
    assert (share / "config" / "robot.yaml").is_file()
    index = installed / "share" / "ament_index" / "resource_index" / "packages"
    assert (index / PACKAGE.name).is_file()
    # `ros2 run` starts what lies in this folder.
    site = next((installed / "lib").glob("python3*/site-packages"))
    for name in ("swarmctl", "swarmd"):
        script = installed / "lib" / PACKAGE.name / name
        shown = subprocess.run(
            [sys.executable, script, "--version"],
            env={**environ, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
            timeout=CAP,
            check=True,
        )
        assert shown.stdout.startswith(f"{name} ")

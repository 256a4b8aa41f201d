"""The ROS 2 package `swarmd_bringup`: launch files start commands that we have. `.ci/try-bringup`
builds it."""

from __future__ import annotations

import re
import shlex
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import pytest

from swarmd.cli.daemon import swarmd
from swarmd.cli.swarmctl import cli as swarmctl
from tests.support.swarmctl import parse_line

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
    """A text with its variables; KeyError for a variable without an <arg>."""
    text = VARIABLE.sub(lambda match: values[match[1]], text)
    text = text.replace("$(find-pkg-share swarmd_bringup)", str(PACKAGE))
    return text.replace("$(env ROS_DOMAIN_ID 0)", "0")


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
    parse_line({"swarmctl": swarmctl, "swarmd": swarmd}[ours[0][0]], ours[0][1:])

"""What a launch file of ROS 2 in XML starts, as far as our files use its language."""

from __future__ import annotations

import re
import shlex
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "drivers" / "swarmd_bringup"
# The elements and attributes that launch_xml knows, as far as the files use them.
_KNOWN = {
    "launch": set[str](),
    "arg": {"name", "default", "description"},
    "executable": {"name", "cmd", "output", "if", "respawn"},
    "env": {"name", "value"},
}
_VARIABLE = re.compile(r"\$\(var (\w+)\)")


@dataclass(frozen=True, slots=True)
class Executable:
    """A process that a launch file starts; `environ` is added to the environment."""

    words: list[str]
    environ: Mapping[str, str]


def executables(file: Path, given: Mapping[str, str]) -> list[Executable]:
    """What the file starts with the arguments `given`; KeyError for one that lacks a value."""
    root = ElementTree.parse(file).getroot()
    values = dict(given)
    for element in root.iter():
        assert set(element.attrib) <= _KNOWN[element.tag], element.tag
        if element.tag == "arg" and "default" in element.attrib:
            values.setdefault(element.attrib["name"], _filled(element.attrib["default"], values))
    assert values.keys() == {one.attrib["name"] for one in root.iter("arg")}
    return [
        Executable(
            # launch splits the command first: the value of an argument stays in its word.
            [_filled(word, values) for word in shlex.split(_marked(one.attrib["cmd"]))],
            {env.attrib["name"]: _filled(env.attrib["value"], values) for env in one.iter("env")},
        )
        for one in root.iter("executable")
        if _filled(one.attrib.get("if", "true"), values) == "true"
    ]


def _marked(command: str) -> str:
    """The command with its variables in one word each."""
    return _VARIABLE.sub(r"$(var\\ \1)", command)


def _filled(text: str, values: Mapping[str, str]) -> str:
    text = _VARIABLE.sub(lambda match: values[match[1]], text)
    text = text.replace("$(find-pkg-share swarmd_bringup)", str(PACKAGE))
    return text.replace("$(env ROS_DOMAIN_ID 0)", "0")

"""The pages on robots: their YAML is what the files hold, their options what the drivers take."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
import yaml

from swarmd.core.events import SensorInput
from swarmd.driver_api.driver import Driver, Sink, ZeroSenderProvider
from swarmd.drivers.ros.options import RmwOptions, Ros1Options, RosOptions, read_options
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.testing.driver_contract import DetachableRig, Rig, ScriptedRig

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "robots"
GENERAL = ("README.md", "new_robot.md", "calibration.md")
LAST_WORD = "](../last_word.md#the-last-word-on-the-command-topic)"
BLOCK = re.compile(r"^```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: str, section: str = "") -> list[str]:
    text = (PAGES / page).read_text()
    return BLOCK.findall(text.partition(f"\n## {section}\n")[2] if section else text)


def parts_of_the_thymio() -> list[str]:
    """All but the variant that begins the page, up to the section on lidars."""
    page = (PAGES / "new_robot.md").read_text()
    before, heading, _ = page.partition("\n## How a lidar turns\n")
    assert heading
    return BLOCK.findall(before)[1:]


def differences(shown: Any, real: Any, where: str = "") -> list[str]:
    """Where what a page shows is not what the file holds; the file may hold more."""
    if isinstance(shown, dict) and isinstance(real, dict):
        return [
            line
            for key, value in shown.items()
            for line in differences(value, real.get(key), f"{where}.{key}")
        ]
    return [] if shown == real else [f"{where}: {shown} is {real}"]


def test_the_variant_loads_unchanged(tmp_path: Path) -> None:
    (tmp_path / "my_robot.yaml").write_text(blocks("new_robot.md")[0])
    platform = load_platform("my_robot.yaml", tmp_path)
    assert len(platform.scan.bearings) == 720
    assert platform.limits == load_platform("burger").limits


@pytest.mark.parametrize("block", parts_of_the_thymio())
def test_the_parts_are_those_of_the_thymio(block: str) -> None:
    real = yaml.safe_load((ROOT / "config" / "platforms" / "thymio.yaml").read_text())
    assert not differences(yaml.safe_load(block), real)


def test_the_parts_together_are_a_platform(tmp_path: Path) -> None:
    whole = yaml.safe_load("".join(parts_of_the_thymio()))
    (tmp_path / "whole.yaml").write_text(yaml.safe_dump({"description": "a new robot", **whole}))
    platform = load_platform("whole.yaml", tmp_path)
    assert platform.body["mass"] == 0.25
    whole.pop("body")
    (tmp_path / "bodiless.yaml").write_text(yaml.safe_dump({"description": "another", **whole}))
    assert load_platform("bodiless.yaml", tmp_path).drivers == platform.drivers


def options_in_tables() -> list[tuple[str, dict[str, Any]]]:
    """The options that a page's table says for some robot."""
    texts = {page.name: page.read_text() for page in sorted(PAGES.glob("*.md"))}
    parts = runpy.run_path(str(ROOT / "docs" / "site" / "driver_messages.py"))["PARTS"]
    texts["trouble.md"] = "\n".join(text for part in parts.values() for text in part())
    return [
        (page, yaml.safe_load(f"{{{text}}}"))
        for page, lines in texts.items()
        for line in lines.splitlines()
        if line.startswith("|")
        for text in re.findall(r"`(\w+: [^`]+)`", line.split("|")[-2])
    ]


@pytest.mark.parametrize(("page", "options"), options_in_tables())
def test_options_in_tables_are_taken_by_a_driver(page: str, options: dict[str, Any]) -> None:
    kinds = (RmwOptions, Ros1Options)
    names = {name for kind in kinds for name in kind.__struct_fields__}
    assert set(options) <= names, page
    for kind in kinds:
        mine = {key: value for key, value in options.items() if key in kind.__struct_fields__}
        msgspec.convert(mine, kind)


def test_each_shipped_robot_has_a_page() -> None:
    text = "".join(page.read_text() for page in PAGES.glob("*.md"))
    assert not [name for name in platform_names() if f"`{name}`" not in text]


def test_each_page_explains_how_its_robot_is_stopped() -> None:
    robots = [page for page in PAGES.glob("*.md") if page.name not in GENERAL]
    wanted = (
        "On the robot",
        "The daemon",
        "How to see that it works",
        "How the command timeout is",
    )
    lacking = [
        (page.name, title) for page in robots for title in wanted if title not in page.read_text()
    ]
    assert not lacking


def test_each_page_names_the_page_on_the_last_word_once() -> None:
    pages = {page.name: page.read_text().count(LAST_WORD) for page in PAGES.glob("*.md")}
    del pages["README.md"], pages["calibration.md"]
    assert set(pages.values()) == {1}, pages


def test_the_multiplexer_gives_swarmd_the_last_word() -> None:
    """A lock masks the inputs of a lower priority (twist_mux)."""
    driver, block = blocks("../last_word.md")
    mux = yaml.safe_load(block)
    priorities = {name: topic["priority"] for name, topic in mux["topics"].items()}
    assert priorities["swarmd"] == max(priorities.values())
    (lock,) = mux["locks"].values()
    assert priorities["swarmd"] >= lock["priority"] > priorities["joystick"]
    options = yaml.safe_load(driver)["driver_options"]
    assert read_options(RosOptions, options, "ros2dds", "r").other_actions


def test_methods_and_inputs_of_a_driver_are_explained() -> None:
    text = (ROOT / "docs" / "drivers.md").read_text()
    said = {
        name
        for kind in (Driver, ZeroSenderProvider, Sink, Rig, ScriptedRig, DetachableRig)
        for name in vars(kind)
    }
    said |= set(Driver.__annotations__) | set(Rig.__annotations__)
    said |= {kind.__name__ for kind in get_args(SensorInput)}
    public = {name for name in said if not name.startswith("_")}
    assert not [name for name in sorted(public) if not re.search(rf"`{name}\b", text)]

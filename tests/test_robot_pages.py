"""The pages on robots: their YAML is what the files hold, their options what the drivers take."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmd.platforms import load_platform, platform_names

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "robots"
BLOCK = re.compile(r"^```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: str) -> list[str]:
    return BLOCK.findall((PAGES / page).read_text())


def differences(shown: Any, real: Any, where: str = "") -> list[str]:
    """Where what a page shows is not what the file holds; the file may hold more."""
    if isinstance(shown, dict) and isinstance(real, dict):
        return [
            line
            for key, value in shown.items()
            for line in differences(value, real.get(key), f"{where}.{key}")
        ]
    return [] if shown == real else [f"{where}: {shown} is {real}"]


def test_the_variant_loads_as_it_stands(tmp_path: Path) -> None:
    (tmp_path / "my_robot.yaml").write_text(blocks("new_robot.md")[0])
    platform = load_platform("my_robot.yaml", tmp_path)
    assert len(platform.scan.bearings) == 720
    assert platform.limits == load_platform("burger").limits


@pytest.mark.parametrize("block", blocks("new_robot.md")[1:])
def test_the_parts_are_those_of_the_thymio(block: str) -> None:
    real = yaml.safe_load((ROOT / "config" / "platforms" / "thymio.yaml").read_text())
    assert not differences(yaml.safe_load(block), real)


def test_each_shipped_robot_has_a_page() -> None:
    text = "".join(page.read_text() for page in PAGES.glob("*.md"))
    assert not [name for name in platform_names() if f"`{name}`" not in text]


def test_each_robot_says_how_it_is_stopped() -> None:
    robots = [page for page in PAGES.glob("*.md") if page.name != "new_robot.md"]
    wanted = ("On the robot", "The daemon", "How to see that it works", "How the deadman is")
    lacking = [
        (page.name, title) for page in robots for title in wanted if title not in page.read_text()
    ]
    assert not lacking

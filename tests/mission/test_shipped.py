"""The shipped missions, and those that docs/missions.md shows."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from swarmd.core.errors import PluginError
from swarmd.pattern_host.loader import PatternLoader
from swarmd.pattern_host.plugin_inspector import check_mission
from swarmd.plugins import find_pattern, pattern_names
from swarmd.settings.settings import load_platform
from tests.support.swarmctl import swarmctl

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "config" / "missions").glob("*.yaml"))
PAGE = (ROOT / "docs" / "missions.md").read_text()
SHOWN = [text for text in re.findall(r"```yaml\n(.*?)```", PAGE, re.S) if "mission:" in text]
WAFFLE = load_platform("waffle_pi")
FIND = PatternLoader(
    {name: (origin.value, origin.is_file) for name, origin in pattern_names(None).items()}
)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_mission_has_no_faults(path: Path) -> None:
    needs = FIND(path.stem).needs
    assert check_mission(path, replace(WAFFLE, provides=WAFFLE.provides | needs), None) == []


def test_a_copy_of_a_shipped_mission_is_no_other_pattern_until_it_differs(tmp_path: Path) -> None:
    (path,) = (Path(shutil.copy(one, tmp_path)) for one in SHIPPED[:1])
    assert check_mission(path, WAFFLE, None) == []
    assert check_mission(path, WAFFLE, tmp_path) == []
    assert find_pattern(path.stem, tmp_path).is_file
    path.write_text(f"{path.read_text()}# changed\n")
    (fault,) = check_mission(path, WAFFLE, tmp_path)
    assert "another pattern" in fault
    with pytest.raises(PluginError, match=path.stem):
        find_pattern(path.stem, tmp_path)


@pytest.mark.parametrize("text", SHOWN)
def test_a_mission_of_the_page_has_no_faults(tmp_path: Path, text: str) -> None:
    path = tmp_path / "shown.yaml"
    path.write_text(text)
    sensed = {"reading:ground", "neighbors.distance"}
    platform = replace(WAFFLE, provides=WAFFLE.provides | sensed)
    assert check_mission(path, platform, tmp_path) == []


def test_the_page_shows_some() -> None:
    assert len(SHOWN) == 5


@pytest.mark.integration
def test_mission_check_prints_all_faults_and_exits_with_2(tmp_path: Path) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(SHOWN[0].replace("0.6, 1.0", "0.4, 0.5").replace("timeout", "timeot"))
    done = swarmctl("mission", "check", str(path))
    assert done.code == 2
    assert len(done.err.splitlines()) == 3
    assert "sequence[0].until " in done.err
    path.write_text(SHOWN[0])
    done = swarmctl("mission", "check", str(path), "-o", "json")
    assert (done.code, done.json["faults"]) == (0, [])


@pytest.mark.integration
def test_patterns_show_lists_its_kind_as_mission() -> None:
    done = swarmctl("patterns", "show", "discuss_then_disperse", "-o", "json")
    row = done.json["pattern"]
    assert (row["kind"], row["needs"]) == ("mission", ["scan"])
    assert row["summary"].startswith("Votes on a distance")


@pytest.mark.integration
def test_text_of_a_file_is_printed_without_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "red.yaml"
    path.write_text('mission: "\\e[31mred"\nparts: {b: {pattern: drive}}\npart: b\n')
    done = swarmctl("patterns", "show", "red", "--plugin-dir", str(tmp_path))
    assert done.out.startswith("red: ?[31mred\n")

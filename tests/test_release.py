"""`make release`: what it refuses, and what an export of the tag gets."""

from __future__ import annotations

import re
import runpy
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
RELEASE = runpy.run_path(str(ROOT / ".ci" / "release"))

URL = "https://forge.example/meadow/swarmd"
CHANGES = (
    "# Changes\n\n## 0.2.0, not released yet\n\nC\n\n## 0.1.0, 2026-11-26\n\nA\nB\n\n## 0.0.9\n"
)
RIGHT: dict[str, Any] = {
    "version": "0.1.0", "url": URL, "changes": [], "changelog": CHANGES, "tags": ["x", "v0.1.0"]
}  # fmt: skip


def test_a_clean_tree_with_its_tag_and_its_entry_is_released() -> None:
    assert RELEASE["refusal"](**RIGHT) == ""


@pytest.mark.parametrize(
    ("wrong", "subject"),
    [
        ({"url": ""}, "URL="),
        ({"url": "/srv/git/swarmd"}, "/srv/git/swarmd"),
        ({"url": "git@forge.example:meadow/swarmd"}, "URL="),
        ({"url": "https://alice:token@forge.example/meadow/swarmd"}, "URL="),
        ({"changes": ["README.md", "setup.py"]}, "README.md"),
        ({"version": "0.2.0", "tags": ["v0.2.0"]}, "CHANGELOG.md"),
        ({"version": "0.0.9", "tags": ["v0.0.9"]}, "CHANGELOG.md"),
        ({"changelog": "# Changes\n"}, "CHANGELOG.md"),
        ({"changelog": "## 0x1.0, 2026-11-26\n\nA\n"}, "CHANGELOG.md"),
        ({"tags": []}, "v0.1.0"),
        ({"tags": ["v0.1.1"]}, "v0.1.1"),
    ],
)
def test_a_release_is_refused_in_one_line(wrong: dict[str, Any], subject: str) -> None:
    why = RELEASE["refusal"](**{**RIGHT, **wrong})
    assert subject in why
    assert "\n" not in why


def test_the_notes_are_the_entry_of_the_version_alone() -> None:
    assert RELEASE["notes_of"](CHANGES, "0.1.0") == "A\nB"


def test_an_entry_of_the_notes_is_one_line() -> None:
    """GitHub shows the end of a line in the notes of a release as a break."""
    changelog = "## 0.1.0, 2026-11-26\n\n- **A**: b\n  c `d`\n  e\n  - f\n    g\n- h\n\n### I\n"
    notes = RELEASE["notes_of"](changelog, "0.1.0")
    assert notes == "- **A**: b c `d` e\n  - f g\n- h\n\n### I"


def test_metadata_names_the_address_of_the_release_alone() -> None:
    """The repository states no address of its own, which would be an invented one."""
    text = (ROOT / "pyproject.toml").read_text()
    project = tomllib.loads(RELEASE["with_urls"](text, URL, "v0.1.0"))["project"]
    assert project.pop("urls") == {
        "Source": URL,
        "Issues": f"{URL}/issues",
        "Changelog": f"{URL}/blob/v0.1.0/CHANGELOG.md",
    }
    assert project == tomllib.loads(text)["project"]


def test_no_link_of_the_readme_on_an_index_of_packages_is_relative() -> None:
    text = RELEASE["with_links"]((ROOT / "README.md").read_text(), URL, "v0.1.0")
    links = re.findall(r"\]\(([^)]*)\)", text)
    assert f"{URL}/raw/v0.1.0/docs/figures/demo.gif" in links
    assert f"{URL}/blob/v0.1.0/docs/safety.md" in links
    assert "https://docs.nav2.org" in links
    assert [link for link in links if not link.startswith("https://")] == []


GOOD = {
    "is_good": True, "problems": [], "kernels": "compiled", "metrics": {"path_length": 0.9},
    "robots": ["tb3-01"], "seconds": 8.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "subject"),
    [
        ({}, ""),
        ({"is_good": False, "problems": ["tb3-01 touched a wall"]}, "tb3-01 touched a wall"),
        ({"kernels": "interpreted"}, "interpreted"),
        ({"metrics": {"path_length": 0.01}}, "0.01 m"),
        ({"metrics": {"path_length": None}}, "0.00 m"),
    ],
)
def test_a_demo_that_did_not_drive_ends_the_release(changed: dict[str, Any], subject: str) -> None:
    why = RELEASE["fault_of"]({**GOOD, **changed})
    assert subject in why
    assert bool(why) == bool(subject)


@pytest.mark.integration
def test_a_python_is_found_behind_a_shim_that_does_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, text in {
        "shims": "exit 127",
        "other": "echo Python 3.1.9",
        "bin": "echo Python 3.12.9",
    }.items():
        (tmp_path / folder).mkdir()
        program = tmp_path / folder / "python3.12"
        program.write_text(f"#!/bin/sh\n{text}\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", ":".join(str(tmp_path / one) for one in ("shims", "other", "bin")))
    assert RELEASE["python_of"]("3.12") == tmp_path / "bin" / "python3.12"
    assert RELEASE["python_of"]("3.13") is None


def test_pages_name_the_archives_of_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    named = {
        one for page in pages for one in re.findall(r"\bswarmd-(\d[\d.]*\d)-", page.read_text())
    }
    assert named == {project["version"]}


@pytest.mark.parametrize(
    ("page", "shown"),
    [
        ("CONTRIBUTING.md", r"\bv(\d+\.\d+\.\d+)\b"),
        ("docs/looking_after.md", r"\bversion +(\d+\.\d+\.\d+);"),
    ],
)
def test_a_page_shows_the_version_of_the_package(page: str, shown: str) -> None:
    """The tag of the next release, and what `doctor` prints."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(re.findall(shown, (ROOT / page).read_text())) == {project["version"]}


def test_the_ros_package_has_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    package = ROOT / "drivers/swarmd_bringup"
    assert ElementTree.parse(package / "package.xml").findtext("version") == project["version"]
    named = re.findall(r'version="(.*?)"', (package / "setup.py").read_text())
    assert named == [project["version"]]


def test_the_changelog_begins_with_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    first = re.search(r"^## (\S+), ", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first is not None
    assert first[1] == project["version"]


def test_no_deprecated_name_outlives_the_version_that_takes_it_away() -> None:
    """Each warning says `X.Y.Z takes NAME away` (CONTRIBUTING.md, deprecation)."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    version = tuple(int(number) for number in project["version"].split("."))
    folders = ("swarmd", "patterns", "drivers", "sim", "config")
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.py")]
    promised = [
        (tuple(int(number) for number in numbers), str(file.relative_to(ROOT)))
        for file in files
        for numbers in re.findall(r"(\d+)\.(\d+)\.(\d+) takes \S+ away", file.read_text())
    ]
    assert [row for row in promised if row[0] <= version] == []

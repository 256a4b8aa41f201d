"""The Containerfile; .ci/try-container builds it where a builder of images is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def test_the_context_of_the_build_has_all_that_the_wheel_is_built_from() -> None:
    admitted = {
        line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line[:1] == "!"
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    folders = project["tool"]["setuptools"]["package-dir"].values()
    named = [project["project"]["readme"], *project["project"]["license-files"]]
    wanted = {"swarmd", "pyproject.toml", "setup.py", "constraints.txt", *named}
    wanted |= {folder.partition("/")[0] for folder in folders}
    assert admitted == wanted


@pytest.mark.integration
@pytest.mark.parametrize(
    ("has_base", "code", "lines"), [(False, 77, 1), (True, 3, 0)], ids=["no base", "build fails"]
)
def test_a_base_that_cannot_be_pulled_is_told_and_a_build_that_fails_is_a_failure(
    tmp_path: Path, has_base: bool, code: int, lines: int
) -> None:
    """A builder that has an image or not, pulls none, and fails to build."""
    for name in ("bash", "dirname"):
        (tmp_path / name).symlink_to(shutil.which(name) or name)
    (tmp_path / "podman").write_text(
        "#!/bin/sh\n"
        'echo "$@" >>"$ASKED"\n'
        f"case $1 in info) exit 0;; inspect) exit {1 - has_base};; pull) exit 125;; esac\n"
        "exit 3\n"
    )
    (tmp_path / "podman").chmod(0o755)
    ended = subprocess.run(
        [
            tmp_path / "bash",
            ROOT / ".ci" / "try-container",
            "--build-arg",
            "BASE=localhost/bookworm",
        ],
        env={**os.environ, "PATH": str(tmp_path), "ASKED": str(tmp_path / "asked")},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout, len(ended.stderr.splitlines())) == (code, "", lines)
    assert ("localhost/bookworm" in ended.stderr) is not has_base
    verbs = [line.split()[0] for line in (tmp_path / "asked").read_text().splitlines()]
    assert verbs == ["info", "inspect", *(["build"] if has_base else ["pull"])]


@pytest.mark.integration
def test_without_a_builder_one_line_tells_that_nothing_was_tried(tmp_path: Path) -> None:
    for name in ("bash", "dirname"):
        (tmp_path / name).symlink_to(shutil.which(name) or name)
    # A client of docker without its server is no builder.
    (tmp_path / "docker").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "docker").chmod(0o755)
    ended = subprocess.run(
        [tmp_path / "bash", ROOT / ".ci" / "try-container"],
        env={**os.environ, "PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout) == (77, "")
    assert len(ended.stderr.splitlines()) == 1

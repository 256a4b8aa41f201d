"""The workflow for a forge: what it runs and may do, and what checkers of workflows say."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / ".github" / "workflows"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "swarmd" / "bin"


def jobs() -> dict[str, dict[str, Any]]:
    """The jobs of the one workflow."""
    (file,) = FOLDER.iterdir()
    workflow = yaml.safe_load(file.read_text())
    assert workflow["permissions"] == {}
    return dict(workflow["jobs"])


def steps(key: str) -> list[str]:
    return [str(step[key]) for job in jobs().values() for step in job["steps"] if key in step]


def checker(name: str, folder: Path, lack: str) -> str:
    """The path of a checker; the test is skipped without it."""
    found = shutil.which(name) or shutil.which(name, path=str(folder))
    if found is None:
        pytest.skip(f"no {name}: {lack}")
    return found


def test_the_workflow_calls_the_gate_and_targets_of_make_on_debian_12_alone() -> None:
    assert {job["container"] for job in jobs().values()} == {"debian:12"}
    assert {".ci/run", "make wheels", "make docs"} <= set(steps("run"))


def test_each_job_reads_the_repository_alone() -> None:
    assert [job["permissions"] for job in jobs().values()] == [{"contents": "read"}]


def test_each_action_is_pinned_by_the_hash_of_a_commit() -> None:
    actions = steps("uses")
    assert actions
    assert [name for name in actions if not re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", name)] == []


@pytest.mark.integration
def test_actionlint_finds_nothing() -> None:
    actionlint = checker("actionlint", CACHE, ".ci/run builds it where go is installed")
    files = [str(file) for file in FOLDER.iterdir()]
    done = subprocess.run([actionlint, *files], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.integration
def test_zizmor_finds_nothing() -> None:
    zizmor = checker("zizmor", Path(sys.executable).parent, "pip install zizmor")
    command = [zizmor, "--offline", "--no-progress", "--format=plain", str(FOLDER)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout

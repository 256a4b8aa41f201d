"""A recording is repeated as it was made: pinned, or with the functions of this processor."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.pin import pinned_environment
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.reader import read_file

pytestmark = [
    pytest.mark.integration,
    pytest.mark.long,
    pytest.mark.skipif(platform.machine() != "x86_64", reason="other machines have no pin"),
]

ROOT = Path(__file__).resolve().parents[3]
MAKE = """
import sys
from pathlib import Path
from tests.support.recorded_stories import Story
story = Story(Path(sys.argv[1]))
story.recorder.begin(story.robot)
story.run("random_walk")
story.robot.advance(3.0)
story.recorder.finish()
"""
REPLAY = "from swarmd.operator.cli.entry import swarmctl; swarmctl()"


def plain() -> dict[str, str]:
    """The environment of a user who pins nothing."""
    pinned = ("GLIBC_TUNABLES", "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE")
    return {name: value for name, value in os.environ.items() if name not in pinned}


def python(
    code: str, environment: Mapping[str, str], *words: str
) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(
        command,
        cwd=ROOT,
        env={**environment, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
    )


def replay(file: Path, environment: Mapping[str, str]) -> subprocess.CompletedProcess[bytes]:
    return python(REPLAY, environment, "replay", str(file), "-o", "json")


def replayed(file: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """The answer on the only robot of a recording, whose commands are all equal."""
    done = replay(file, environment)
    assert done.returncode == 0, done.stderr
    (robot,) = json.loads(done.stdout)["robots"]
    assert robot["safe"]["equal"] == robot["safe"]["count"] > 100
    assert robot["requested"]["equal"] == robot["requested"]["count"] > 10
    return dict(robot)


def recorded(folder: Path, environment: Mapping[str, str]) -> Path:
    done = python(MAKE, environment, str(folder))
    assert done.returncode == 0, done.stderr
    (file,) = folder.glob("*.mcap")
    return file


def test_a_recording_is_repeated_as_it_was_made(tmp_path: Path) -> None:
    pinned = recorded(tmp_path / "pinned", pinned_environment(plain()))
    assert head_of(read_file(pinned).about, "").made["pinned"] == "yes"
    assert replayed(pinned, plain())["notes"] == []

    by_a_daemon = recorded(tmp_path / "plain", plain())
    assert head_of(read_file(by_a_daemon).about, "").made["pinned"] == "no"
    assert replayed(by_a_daemon, plain())["notes"] == []
    # A process that its user has pinned says so; its commands may differ by rounding.
    answer = json.loads(replay(by_a_daemon, pinned_environment()).stdout)
    assert any("pinned no, here yes" in note for note in answer["robots"][0]["notes"])

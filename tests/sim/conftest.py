"""Fixtures of experiments: a scenario of two seconds, and swarmctl."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

DUO = """\
description: Two Burgers gather.
duration: 2
realism: ideal
plugin_dir: plugins
arena: {size: [5, 5]}
groups:
  all: {platform: burger, count: 2, prefix: r, pattern: moody, start: {layout: random}}
"""
# Drives, and ends in the way it is told: the way of some bug, of a full memory, of sys.exit.
MOODY = '''
import os
import signal
import time
from typing import Annotated

from msgspec import Meta

from swarmd.api import Inputs, MovementPattern, Params, Twist


class MoodyParams(Params, frozen=True, kw_only=True):
    speed: Annotated[float, Meta(description="how fast")] = 0.1
    end: Annotated[str, Meta(description="see drive")] = "none"


class Moody(MovementPattern[MoodyParams]):
    """Drives, or takes its process with it."""

    params_type = MoodyParams

    def drive(self, inputs: Inputs) -> Twist:
        if inputs.now > 0.5:
            if self.params.end == "exit":
                print("moody has had enough", flush=True)
                os._exit(7)
            if self.params.end == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.params.end == "slow":
                time.sleep(0.3)
            if self.params.end == "hang":
                while True:
                    pass
            if self.params.end == "freeze":
                os.kill(os.getpid(), signal.SIGSTOP)
            if self.params.end == "close":
                os.closerange(3, 100)
            if self.params.end == "fork" and "FORKED" not in os.environ:
                os.environ["FORKED"] = "yes"  # once; both then go on with the run
                os.fork()
            if self.params.end == "remember":
                os.environ["MOODY"] = "was here"
        elif "MOODY" in os.environ:
            return Twist(linear=-self.params.speed)
        return Twist(linear=self.params.speed)
'''

MAIN = "from swarmd.cli.entry import swarmctl; swarmctl()"

Swarmctl = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def duo(tmp_path: Path) -> Path:
    """The file of a scenario of two robots and two seconds, with a pattern beside it."""
    folder = tmp_path / "duo"
    (folder / "plugins").mkdir(parents=True)
    (folder / "plugins" / "moody.py").write_text(MOODY)
    path = folder / "duo.yaml"
    path.write_text(DUO)
    return path


@pytest.fixture
def swarmctl(tmp_path: Path) -> Swarmctl:
    """Runs swarmctl in the test's folder; words and further environment are given."""

    def run(*words: object, **environ: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", MAIN, *map(str, words)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={**os.environ, "HOME": str(tmp_path), **environ},
            timeout=120,
            check=False,
        )

    return run

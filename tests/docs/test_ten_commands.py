"""The ten commands of docs/field.md, run as they stand there."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.field import ROOT, lacks
from tests.support.processes import CAP, unique_swarm, wait_until

pytestmark = pytest.mark.integration
PAGE = (ROOT / "docs/field.md").read_text()
SECTION = PAGE.partition("## Ten commands to a secured swarm")[2].partition("\n## ")[0]
SETUP, *BLOCKS = re.findall(r"```bash\n(.*?)```", SECTION, re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.splitlines()]


class Shell:
    """Runs the lines of the page, each in a bash with the variables of the set-up."""

    def __init__(self, folder: Path) -> None:
        (folder / "examples").symlink_to(ROOT / "examples")
        name = unique_swarm()
        self._folder = folder
        self._environ = {
            **os.environ,
            "HOME": str(folder / "home"),
            "XDG_CACHE_HOME": str(folder / "cache"),
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "PREFIX": f"swarmd-{name[-6:]}-",
        }
        self._environ.pop("XDG_CONFIG_HOME", None)
        (folder / "home").mkdir()
        self._variables = SETUP.splitlines()[-1]
        self._running: list[subprocess.Popen[str]] = []

    def run(self, line: str) -> str:
        """The output of a line; it must end with 0."""
        done = subprocess.run(
            ["bash", "-c", f"{self._variables}\n{line}"],
            cwd=self._folder,
            env=self._environ,
            capture_output=True,
            text=True,
            timeout=CAP,
        )
        assert done.returncode == 0, (line, done.stdout, done.stderr)
        return done.stdout

    def start(self, line: str, ready: str) -> None:
        """Start a line that runs in the background, and wait for a text in its output."""
        log = self._folder / f"background-{len(self._running)}.log"
        with log.open("wb") as sink:
            process = subprocess.Popen(
                ["bash", "-c", f"{self._variables}\nexec {line.removesuffix('&')}"],
                cwd=self._folder,
                env=self._environ,
                stdout=sink,
                stderr=sink,
                text=True,
            )
        self._running.append(process)

        def is_ready() -> bool:
            text = log.read_text()
            assert process.poll() is None, (line, text)
            return ready in text

        wait_until(is_ready, f"{ready!r} of {line}")

    def close(self) -> None:
        """End what runs in the background, and take the hosts away."""
        for process in reversed(self._running):
            process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(CAP)
        self.run("sh examples/two_pis.sh down")


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    if why := lacks():
        pytest.skip(why)
    with contextlib.closing(Shell(tmp_path)) as made:
        yield made


@pytest.mark.evidence
def test_ten_commands_lead_to_a_secured_swarm(shell: Shell) -> None:
    assert len(COMMANDS) == 10
    *install, bases, first, second, members, run, estop = COMMANDS
    shell.run("\n".join(SETUP.splitlines()[:-1]))
    for line in install:
        shell.run(line)
    shell.start(bases, "2 bases up")
    for line in (first, second):
        shell.start(line, "ready in swarm meadow")
    listed = shell.run(members)
    assert "2/2 alive" in listed
    assert "insecure" not in listed
    assert "2 targeted, 2 applied" in shell.run(run)
    assert "2 targeted, 2 applied" in shell.run(estop)
    states = shell.run(members)
    assert states.count("estopped") >= 2, states

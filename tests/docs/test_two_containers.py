"""The lesson of two containers, run as it stands there, with namespaces in place of containers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.field import ROOT, lacks
from tests.support.processes import CAP, unique_swarm, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.evidence]
PAGE = (ROOT / "docs/tutorial/9-two-containers.md").read_text()
BUILD, *BLOCKS = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.splitlines()]


class Podman:
    """Runs lines of the page with the stand-in for podman."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        stand_in = folder / "podman"
        stand_in.symlink_to(ROOT / "tests/docs/podman_in_namespaces.sh")
        self._environ = {
            **os.environ,
            "HOME": str(folder / "home"),
            "PATH": f"{folder}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "PREFIX": f"swarmd-{unique_swarm()[-6:]}-",
            "CONTAINERS": str(folder),
        }
        self._environ.pop("XDG_CONFIG_HOME", None)
        self._environ.pop("XDG_STATE_HOME", None)
        (folder / "home").mkdir()

    def run(self, line: str, code: int | None = 0) -> str:
        """What a line of the page prints; it must end with `code`, None: with any."""
        done = subprocess.run(
            ["sh", "-c", line],
            cwd=self.folder,
            env=self._environ,
            capture_output=True,
            text=True,
            timeout=2.0 * CAP,
        )
        assert code is None or done.returncode == code, (line, done.stdout, done.stderr)
        return done.stdout

    def await_log(self, name: str, text: str) -> None:
        log = self.folder / f"{name}.log"
        wait_until(lambda: text in log.read_text(), f"{name} says {text!r}")


@pytest.fixture
def podman(tmp_path: Path) -> Iterator[Podman]:
    if why := lacks():
        pytest.skip(why)
    made = Podman(tmp_path)
    try:
        yield made
    finally:
        made.run("podman rm -f world tb3-01 tb3-02 once")
        made.run("podman network rm meadow", code=None)


def test_two_containers_find_each_other(podman: Podman) -> None:
    assert BUILD == "podman build -t swarmd .\n"
    network, world, first, second, members, run, kill, again, stop, clean, gone = COMMANDS
    podman.run(network)
    podman.run(world)
    podman.await_log("world", "2 bases up")
    for line, name in ((first, "tb3-01"), (second, "tb3-02")):
        podman.run(line)
        podman.await_log(name, "ready in swarm meadow")
    assert "2/2 alive" in podman.run(members)
    assert "2 targeted, 2 applied" in podman.run(run)

    podman.run(kill)

    def has_failed() -> bool:
        """While only the word of tb3-01 tells of it, the view is not complete (exit code 3)."""
        listed = podman.run(again, code=None)
        return "1/2 alive" in listed and "failed" in listed

    wait_until(has_failed, "tb3-02 has failed")
    podman.run(stop, code=3)
    podman.run(clean)
    podman.run(gone)

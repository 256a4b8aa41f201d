"""`swarmctl tour` as a new user runs it."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.sim.cli.tour import steps
from tests.support.processes import run_command

SWARMCTL = str(Path(sys.executable).with_name("swarmctl"))
TIMEOUT = 120.0


@pytest.mark.integration
def test_the_tour_runs_all_commands_and_leaves_nothing_behind(tmp_path: Path) -> None:
    words = ("tour", "-n", "2", "--yes")
    done = run_command("swarmctl", *words, cwd=tmp_path, TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    shown = [line for line in done.stdout.splitlines() if line.startswith("$ swarmctl ")]
    assert shown == [f"$ swarmctl {' '.join(one.words)}" for one in steps(("tb3-01", "tb3-02"))]
    assert len(shown) == 5
    assert "2 targeted, 2 applied" in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.integration
def test_each_command_waits_for_enter_and_ctrl_c_ends_the_tour(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [SWARMCTL, "tour", "-n", "1"],
        stdin=theirs, stdout=theirs, stderr=theirs, cwd=tmp_path,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    ) as process, contextlib.ExitStack() as left:  # fmt: skip
        left.callback(process.kill)  # else a test that fails waits for it
        os.close(theirs)
        text, waits = "", 0
        while (chunk := _read(ours, 10.0 if waits == 2 else TIMEOUT)) is None or chunk:
            if chunk is None:
                # A signal just before readline waits for input is noticed at the next one.
                assert waits == 2, text
                process.send_signal(signal.SIGINT)
                continue
            text += chunk
            if text.count("[Enter]") > waits:
                waits += 1
                assert text.count("\n$ swarmctl ") == waits, "no command came too early"
                if waits == 1:
                    os.write(ours, b"\n")
                else:
                    process.send_signal(signal.SIGINT)
        os.close(ours)
        assert process.wait(TIMEOUT) == 130, text
    assert waits == 2
    assert list(tmp_path.iterdir()) == []


def _read(terminal: int, timeout: float) -> str | None:
    """What the terminal shows next; empty once the process has ended, None if nothing comes."""
    if not select.select([terminal], [], [], timeout)[0]:
        return None
    try:
        return os.read(terminal, 4096).decode()
    except OSError:
        return ""


@pytest.mark.integration
def test_without_a_terminal_yes_is_asked_for(tmp_path: Path) -> None:
    done = run_command("swarmctl", "tour", cwd=tmp_path)
    assert done.returncode == 2
    assert "--yes" in done.stderr

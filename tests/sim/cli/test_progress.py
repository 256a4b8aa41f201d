"""Progress is a bar on a terminal and few lines elsewhere, and never on stdout."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

from swarmd.sim.cli.progress import ends_on_sigterm, progress

SHOW = """
import time
from swarmd.sim.cli.progress import progress
with progress() as show:
    for done in range(501):
        show(done, 500, 3 if done > 400 else 0)
        if done == 250:
            time.sleep(0.3)  # a screen of its own for the time left
"""


def test_without_a_terminal_there_are_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(clock=lambda: 0.0) as show:
        for done in range(501):
            show(done, 500, 3 if done > 400 else 0)
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert captured.out == ""
    assert len(lines) == 12
    assert (lines[0], lines[-1]) == ("0 of 500 runs", "500 of 500 runs, 3 failed")


def test_the_time_left_is_shown_from_the_first_run_on(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    with progress(clock=lambda: now) as show:
        for done in range(4, 25):  # four runs are from before
            show(done, 24, 0)
            now += 30.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["4 of 24 runs", "5 of 24 runs, about 10 min left"]
    assert lines[-1] == "24 of 24 runs"


def test_nothing_to_do_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress() as show:
        show(4, 4, 0)
    assert capsys.readouterr().err == "4 of 4 runs\n"


@pytest.mark.parametrize("no_colour", ["", "1"])
def test_on_a_terminal_there_is_a_bar(no_colour: str) -> None:
    ours, theirs = pty.openpty()
    environ = {**os.environ, "TERM": "xterm", "NO_COLOR": no_colour}
    subprocess.run([sys.executable, "-c", SHOW], stderr=theirs, env=environ, check=True)
    os.close(theirs)
    said = os.read(ours, 65536).decode()
    os.close(ours)
    assert "500/500" in said
    assert "3 failed" in said
    assert " ms left" in said
    assert ("\x1b[3" in said) == (not no_colour)


def test_sigterm_ends_in_order_and_only_meanwhile() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as caught, ends_on_sigterm():
        os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before

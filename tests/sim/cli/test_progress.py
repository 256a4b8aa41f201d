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
            time.sleep(0.3)  # so that Rich draws the time left
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


@pytest.mark.parametrize(
    ("per_run", "left"),
    [(4.93, "94 s"), (6.3, "120 s"), (30.0, "10 min"), (600.0, "3 h")],
)
def test_the_time_left_is_shown_after_the_first_run(
    per_run: float, left: str, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    with progress(clock=lambda: now) as show:
        for done in range(4, 25):  # a resumed experiment with four finished runs
            show(done, 24, 0)
            now += per_run
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["4 of 24 runs", f"5 of 24 runs, about {left} left"]
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
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert "500/500" in shown
    assert "3 failed" in shown
    assert " s left" in shown
    assert ("\x1b[3" in shown) == (not no_colour)


def test_sigterm_ends_in_order_and_only_meanwhile() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as caught, ends_on_sigterm():
        os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before

"""Progress is a bar on a terminal and few lines elsewhere, and never on stdout."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

from swarmd.operator.cli.output import signals_end
from swarmd.sim.cli.progress import progress
from swarmd.sim.experiments.simulate import Progress

SHOW = """
import time
from swarmd.sim.cli.progress import progress
from swarmd.sim.experiments.simulate import Progress
now = 0.0
with progress(lambda: now) as show:
    for done in range(501):
        now += 1.0
        show(Progress(done, 500, 3 if done > 400 else 0, done, 500 - done))
        if done == 250:
            time.sleep(0.3)  # so that Rich draws the time left
"""


def at(done: int, total: int, failed: int = 0, worked: float = 0.0) -> Progress:
    return Progress(done, total, failed, worked, left=total - worked)


def test_without_a_terminal_there_are_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(clock=lambda: 0.0) as show:
        for done in range(501):
            show(at(done, 500, 3 if done > 400 else 0, float(done)))
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert captured.out == ""
    assert len(lines) == 11
    assert (lines[0], lines[-1]) == ("0 of 500 runs", "500 of 500 runs, 3 failed")


@pytest.mark.parametrize(
    ("per_run", "left"),
    [(0.5, "9.8 s"), (4.93, "97 s"), (6.09, "120 s"), (30.0, "10 min"), (600.0, "3 h")],
)
def test_the_time_left_is_shown_before_the_first_run_has_ended(
    per_run: float, left: str, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    with progress(clock=lambda: now) as show:
        show(at(4, 24))  # a resumed experiment with four finished runs
        now = 100.0  # in which the workers have started
        for _ in range(3):
            show(Progress(4, 24, 0, (now - 100.0) / per_run + 0.1, 20.0 - (now - 100.0) / per_run))
            now += max(0.2 * per_run, 1.0)
        show(Progress(24, 24, 0, 20.1, 0.0))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "4 of 24 runs"
    assert lines[1].startswith("4 of 24 runs, about ")
    assert lines[-1] == "24 of 24 runs"
    value, unit = lines[1].split()[-3:-1]
    assert unit == left.split()[1]
    assert float(value) == pytest.approx(float(left.split()[0]), rel=0.25)


def test_nothing_to_do_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress() as show:
        show(at(4, 4, worked=4.0))
    assert capsys.readouterr().err == "4 of 4 runs\n"


@pytest.mark.integration
@pytest.mark.parametrize("no_colour", ["", pytest.param("1", marks=pytest.mark.evidence)])
def test_on_a_terminal_there_is_a_bar(no_colour: str) -> None:
    ours, theirs = pty.openpty()
    environ = {**os.environ, "TERM": "xterm", "NO_COLOR": no_colour}
    subprocess.run([sys.executable, "-c", SHOW], stderr=theirs, env=environ, check=True)
    os.close(theirs)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert "500/500" in shown
    assert "3 failed" in shown
    assert " left" in shown
    assert ("\x1b[3" in shown) == (not no_colour)


def test_sigterm_ends_in_order_and_only_meanwhile() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as caught, signals_end(signal.SIGTERM):
        os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before

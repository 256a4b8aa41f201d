"""Stalls on purpose: which processes stand still, for how long, and that all of them go on."""

from __future__ import annotations

import io
import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import stop_process, wait_until
from tests.support.stalls import LONG, SHORT, Stalls, _keep, _locked, _stall, _state, kinds

pytestmark = pytest.mark.integration

TREE = """
import subprocess, sys
wait = "import time; time.sleep(600)"
for words in ([], ["swarmd.operator.cli" + ".daemon"], ["swarmd.sim.live.server"]):
    subprocess.Popen([sys.executable, "-c", wait, *words])
subprocess.Popen(["sleep", "600"])
print(flush=True)
sys.stdin.read()
"""


@pytest.fixture
def worker() -> Iterator[subprocess.Popen[str]]:
    """A process with children: an operator, a daemon, a world, and a program of another kind."""
    pipe = subprocess.PIPE
    words = [sys.executable, "-c", TREE]
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, process_group=0) as started:
        assert started.stdout is not None
        started.stdout.readline()
        yield started
        os.killpg(started.pid, signal.SIGKILL)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("lock", "log"):
        (tmp_path / name).touch()
    return tmp_path


def test_daemons_stand_still_for_a_quarter_of_a_second_at_most(
    worker: subprocess.Popen[str],
) -> None:
    assert SHORT[1] <= 0.25
    wait_until(lambda: len(kinds(worker.pid)) == 4, "the processes of Python are there")
    found = sorted(kinds(worker.pid).values())
    assert found == [SHORT, LONG, LONG, LONG]


@pytest.mark.parametrize("seed", range(3))
def test_what_stood_still_goes_on_and_what_a_test_has_stopped_does_not(
    worker: subprocess.Popen[str], folder: Path, seed: int
) -> None:
    wait_until(lambda: len(kinds(worker.pid)) == 4, "the processes of Python are there")
    notes = io.StringIO()
    stop_process(worker.pid)
    for _ in range(2):
        _stall(worker.pid, random.Random(seed), folder, notes)
    assert len((folder / "log").read_text().splitlines()) == 2
    assert notes.getvalue().endswith("\n\n")
    others = kinds(worker.pid).keys() - {worker.pid}
    wait_until(lambda: "T" not in map(_state, others), "the others go on")
    assert _state(worker.pid) == "T"


def test_what_stands_still_when_the_stalls_end_goes_on(worker: subprocess.Popen[str]) -> None:
    reader, writer = os.pipe()
    stop_process(worker.pid)
    os.write(writer, f"1 2 3\n\n{worker.pid}\n".encode())
    os.close(writer)
    _keep(reader)
    wait_until(lambda: _state(worker.pid) != "T", "it goes on")


def test_the_end_waits_for_a_stall_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stall writes to its folder until it ends; the folder is removed after that."""
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: None)  # no process makes stalls
    monkeypatch.setattr(os, "kill", os.kill)
    stalls = Stalls("1")
    stopping = threading.Thread(target=stalls.stop)
    with _locked(stalls.lock):
        stopping.start()
        stopping.join(0.2)
        assert (stopping.is_alive(), stalls.log.exists()) == (True, True)
    stopping.join()
    assert not stalls.lock.parent.exists()

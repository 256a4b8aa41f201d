"""`swarmctl acceptance` on a pseudo terminal with a daemon: B1 with a person who is not careful."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from swarmd.acceptance.result_file import read_record
from swarmd.acceptance.verdict import Result
from swarmd.core.messages import State, Status
from swarmd.network.operator.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.starting import statuses_of
from tests.support.processes import CAP, unique_swarm, wait_until
from tests.support.swarmctl import SWARMCTL, swarmctl

pytestmark = pytest.mark.integration
ROBOT = "r01"
QUESTION = "[y/N]"
READ_TIME = 1.5  # s that a person reads a question


class Person:
    """What a person sees and types: `swarmctl acceptance` in a process with a terminal."""

    def __init__(self, swarm: str, *words: str) -> None:
        self.text = ""
        self._read_to = 0
        self.pid, self.keyboard = pty.fork()
        if self.pid == 0:
            os.environ.update(SWARM=swarm, COLUMNS="40")
            os.execv(SWARMCTL[0], [*SWARMCTL, "acceptance", ROBOT, *words])

    def see(self, seconds: float) -> None:
        """Take what comes within `seconds`."""
        if select.select([self.keyboard], [], [], seconds)[0]:
            try:
                self.text += os.read(self.keyboard, 4096).decode(errors="replace")
            except OSError:  # the process has ended
                time.sleep(seconds)

    def read_on(self, word: str, cap: float = CAP) -> None:
        """Read until a word comes that was not read before."""
        end = time.monotonic() + cap
        while (place := self.text.find(word, self._read_to)) < 0:
            assert time.monotonic() < end, self.text
            self.see(0.1)
        self._read_to = place + len(word)

    def answer(self, text: str) -> None:
        """Read the next question, and answer it."""
        self.read_on(QUESTION)
        time.sleep(READ_TIME)
        os.write(self.keyboard, f"{text}\n".encode())

    def press(self, key: bytes) -> None:
        os.write(self.keyboard, key)

    def end(self) -> int:
        """The exit code."""
        found: list[int] = []

        def has_ended() -> bool:
            self.see(0.05)
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                found.append(os.waitstatus_to_exitcode(status))
            return bool(pid)

        wait_until(has_ended, "the test ends")
        os.close(self.keyboard)
        return found[0]


@contextmanager
def person(swarm: str, *words: str) -> Iterator[Person]:
    one = Person(swarm, *words)
    try:
        yield one
    finally:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(one.pid, signal.SIGKILL)
            os.waitpid(one.pid, 0)


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The swarm of one Burger in a room of 5 x 3 m."""
    name = unique_swarm()
    folder = tmp_path_factory.mktemp("fleet")
    spec = FleetSpec(
        swarm=name, robots={ROBOT: "burger"}, folder=folder, arena="5x3", layout="grid:0.6"
    )
    with Fleet(spec):
        wait_until(lambda: is_so(name, lambda one: one.health.scan_rate > 0.0), "it scans", 60.0)
        yield name


def is_so(swarm: str, condition: Callable[[Status], bool]) -> bool:
    with Operator(NetworkSettings(swarm=swarm)) as operator:
        status = statuses_of(operator.members()).get(ROBOT)
    return status is not None and condition(status)


def test_a_stop_is_measured_although_the_first_answers_are_none(swarm: str, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    with person(swarm, "--only", "B1", "--folder", str(folder)) as one:
        one.read_on("platform")
        one.press(b"y\ny\n")  # before the question
        one.answer("sure")
        one.read_on("y, n, q")
        time.sleep(READ_TIME)
        one.press(b"y\n")
        one.read_on("B1 PASS")
        assert one.end() == 0
    found = read_record(folder).verdicts["B1"]
    assert found.result is Result.PASS
    assert 0.05 < float(found.values["speed"]) < 0.15
    assert 0.0 <= float(found.values["seconds"]) < 1.0
    (file,) = tmp_path.glob("*.zip")
    assert read_record(file).verdicts["B1"] == found
    shown = swarmctl("acceptance", "--show", str(file))
    assert (shown.code, "B1 stop: PASS" in shown.out) == (0, True)
    assert not re.search(r"\d+\.\d+\.\d+\.\d+:", shown.out)


@pytest.mark.parametrize("end", [b" ", b"\x03"])
def test_a_key_and_ctrl_c_stop_a_robot_that_drives(swarm: str, tmp_path: Path, end: bytes) -> None:
    folder = tmp_path / "results"
    with person(swarm, "--only", "B1", "--folder", str(folder)) as one:
        one.answer("y")
        wait_until(lambda: is_so(swarm, lambda status: status.state is State.RUNNING), "it drives")
        one.press(end)
        one.end()
    assert is_so(swarm, lambda status: status.state is not State.RUNNING)
    verdicts = read_record(folder).verdicts
    assert "B1" not in verdicts or "key" in verdicts["B1"].reason

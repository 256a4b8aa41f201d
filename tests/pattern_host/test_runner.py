"""The process runner with real hosts; tests/faults has faults of patterns inside a daemon."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from swarmd.core.host_messages import (
    HostDied,
    HostEvent,
    KillHost,
    Load,
    Loaded,
    LoadRefused,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.values import Inputs, Outputs, Twist
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.robot.timeouts import LOAD_TIMEOUT
from swarmd.settings.settings import load_platform

pytestmark = pytest.mark.integration

PLUGIN = """
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Plugin(MovementPattern[Params]):
    '''A test's.'''
    needs = frozenset()
    def drive(self, inputs: Inputs) -> Twist:
        print("printed")
        {body}
"""


class RunnerHarness:
    """A runner on its loop, and its events so far."""

    def __init__(self, folder: Path) -> None:
        self.events: list[HostEvent] = []
        self._has_events = asyncio.Event()
        self.runner = ProcessRunner(asyncio.get_running_loop(), folder, self._wake)

    def _wake(self) -> None:
        self.events.extend(self.runner.events())
        self._has_events.set()

    async def next(self) -> HostEvent:
        async with asyncio.timeout(30.0):
            while not self.events:
                self._has_events.clear()
                await self._has_events.wait()
        return self.events.pop(0)


def load(pattern: str, generation: int = 1) -> Load:
    return Load(generation, pattern, (), "tb3-01", load_platform("burger"), 1)


def step(generation: int = 1) -> Step:
    return Step(generation, Inputs(now=1.0, dt=0.0))


def play(
    folder: Path, body: str, *commands: Load | Step | KillHost | StartTrial
) -> list[HostEvent]:
    """The host's answers to the commands in turn."""
    (folder / "plugin.py").write_text(PLUGIN.format(body=body))

    async def run() -> list[HostEvent]:
        harness = RunnerHarness(folder)
        try:
            answers = []
            for command in commands:
                harness.runner.send(command)
                if not isinstance(command, KillHost):
                    answers.append(await harness.next())
            return answers
        finally:
            harness.runner.close()

    return asyncio.run(run())


@pytest.mark.parametrize(
    ("body", "name", "subject"),
    [
        ("return Twist()", "plugim", "'plugin'"),
        ("return Twist()", "drive", "drive.py"),
        ("return Twist()\n    channels = {'*': int}", "plugin", "'*'"),
    ],
)
def test_a_pattern_that_cannot_be_had_is_refused(
    tmp_path: Path, body: str, name: str, subject: str
) -> None:
    (tmp_path / "drive.py").write_text("")  # an installed pattern has this name
    (refused,) = play(tmp_path, body, load(name))
    assert isinstance(refused, LoadRefused)
    assert subject in refused.text


def test_a_refused_load_keeps_the_pattern_before(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("import nothing_of_that_name")
    ready, refused, stepped = play(
        tmp_path, "return Twist(0.1)", load("plugin"), load("broken", 2), step(1)
    )
    assert isinstance(ready, Loaded)
    assert isinstance(refused, LoadRefused)
    assert "nothing_of_that_name" in refused.text
    assert isinstance(stepped, Stepped)
    assert stepped.outputs == Outputs(Twist(0.1))


def test_code_that_loads_too_slowly_fails_its_trial(tmp_path: Path) -> None:
    body = f"return Twist(0.1)\nimport time\ntime.sleep({LOAD_TIMEOUT + 0.1})"
    (result,) = play(tmp_path, body, StartTrial(load("plugin")))
    assert isinstance(result, TrialDone)
    assert "loading took 3." in result.text


def test_a_host_may_take_a_gigabyte_at_each_load_and_less_in_a_step(tmp_path: Path) -> None:
    body = """
        try:
            mmap.mmap(-1, 300 << 20)
        except OSError:
            return Twist(0.1)
        return Twist()

    def __init__(self, params, context):
        super().__init__(params, context)
        mmap.mmap(-1, 900 << 20).close()
        try:
            mmap.mmap(-1, 1100 << 20)
        except OSError:
            return
        raise AssertionError

import mmap
"""
    answers = play(tmp_path, body, load("plugin"), step(), load("plugin", 2), step(2))
    assert [type(one) for one in answers] == [Loaded, Stepped] * 2
    twists = [one.outputs.twist for one in answers if isinstance(one, Stepped)]
    assert twists == [Twist(0.1), Twist(0.1)]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("import os; os.kill(os.getpid(), 9)", "SIGKILL"),
        ("raise SystemExit", "code 0"),
        ("import ctypes; ctypes.string_at(0)", "SIGSEGV"),
        ("bytearray(1 << 33)", "more memory"),
    ],
)
def test_the_end_of_a_host_is_reported_with_cause(tmp_path: Path, body: str, words: str) -> None:
    _, end = play(tmp_path, body, load("plugin"), step())
    assert isinstance(end, HostDied)
    assert words in end.text


def test_a_fresh_host_takes_the_load_after_a_kill(tmp_path: Path) -> None:
    answers = play(
        tmp_path, "return Twist(0.1)", load("plugin"), KillHost(), load("plugin", 2), step(2)
    )
    assert [type(answer) for answer in answers] == [Loaded, Loaded, Stepped]


def test_closing_leaves_no_process_behind(tmp_path: Path) -> None:
    async def run() -> int | None:
        harness = RunnerHarness(tmp_path)
        harness.runner.send(load("drive"))
        await harness.next()
        pid = harness.runner.pid
        harness.runner.close()
        async with asyncio.timeout(30.0):
            while pid is not None and os.path.exists(f"/proc/{pid}"):
                await asyncio.sleep(0.01)
        return pid

    assert asyncio.run(run()) is not None

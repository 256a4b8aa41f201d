"""The process runner with real hosts; faults of patterns inside a daemon are in tests/faults."""

from __future__ import annotations

import asyncio
import os
import re
from pathlib import Path

import pytest

from swarmd.core.host_messages import (
    HostDied,
    HostEvent,
    KillHost,
    Load,
    Loaded,
    LoadRefused,
    PatternFailed,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.values import Inputs, Outputs, Twist
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.robot.pattern_run import LOAD_TIMEOUT
from swarmd.settings.settings import load_platform

pytestmark = pytest.mark.integration

PLUGIN = """
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Plugin(MovementPattern[Params]):
    '''A test's.'''
    needs = frozenset()
    def drive(self, inputs: Inputs) -> Twist:
        print("said aloud")
        {body}
"""


class Played:
    """A runner on its loop, with the events it gave so far."""

    def __init__(self, folder: Path) -> None:
        self.events: list[HostEvent] = []
        self._news = asyncio.Event()
        self.runner = ProcessRunner(asyncio.get_running_loop(), folder, self._wake)

    def _wake(self) -> None:
        self.events.extend(self.runner.events())
        self._news.set()

    async def next(self) -> HostEvent:
        async with asyncio.timeout(30.0):
            while not self.events:
                self._news.clear()
                await self._news.wait()
        return self.events.pop(0)


def load(pattern: str, generation: int = 1) -> Load:
    return Load(generation, pattern, (), "tb3-01", load_platform("burger"), 1)


def step(generation: int = 1) -> Step:
    return Step(generation, Inputs(now=1.0, dt=0.0))


def play(
    folder: Path, body: str, *commands: Load | Step | KillHost | StartTrial
) -> list[HostEvent]:
    """What a host answers to each command in turn."""
    (folder / "plugin.py").write_text(PLUGIN.format(body=body))

    async def run() -> list[HostEvent]:
        played = Played(folder)
        try:
            answers = []
            for command in commands:
                played.runner.send(command)
                if not isinstance(command, KillHost):
                    answers.append(await played.next())
            return answers
        finally:
            played.runner.close()

    return asyncio.run(run())


def test_loads_and_steps_in_a_child_process(tmp_path: Path) -> None:
    ready, stepped = play(tmp_path, "return Twist(0.1, 0.2)", load("plugin"), step())
    assert isinstance(ready, Loaded)
    assert isinstance(stepped, Stepped)
    assert stepped.outputs == Outputs(Twist(0.1, 0.2))


def test_an_unknown_pattern_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    (refused,) = play(tmp_path, "return Twist()", load("plugim"))
    assert isinstance(refused, LoadRefused)
    assert "did you mean 'plugin'" in refused.text


def test_a_file_that_has_the_name_of_an_installed_pattern_is_not_ignored(tmp_path: Path) -> None:
    (tmp_path / "drive.py").write_text("")
    (refused,) = play(tmp_path, "return Twist()", load("drive"))
    assert isinstance(refused, LoadRefused)
    assert "there twice" in refused.text


def test_a_channel_that_is_no_id_is_refused(tmp_path: Path) -> None:
    (refused,) = play(tmp_path, "return Twist()\n    channels = {'*': int}", load("plugin"))
    assert isinstance(refused, LoadRefused)
    assert "a channel of pattern 'plugin' is '*'" in refused.text


def test_a_refused_load_keeps_the_pattern_before(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("import nothing_of_that_name")
    ready, refused, stepped = play(
        tmp_path, "return Twist(0.1)", load("plugin"), load("broken", 2), step(1)
    )
    assert isinstance(ready, Loaded)
    assert isinstance(refused, LoadRefused)
    assert "nothing_of_that_name" in refused.text
    assert isinstance(stepped, Stepped)


def test_code_that_a_run_would_not_wait_for_fails_its_trial(tmp_path: Path) -> None:
    body = f"return Twist(0.1)\nimport time\ntime.sleep({LOAD_TIMEOUT + 0.1})"
    (tried,) = play(tmp_path, body, StartTrial(load("plugin")))
    assert isinstance(tried, TrialDone)
    assert re.fullmatch(r"loading took 3.\d s; a run waits for 3 s", tried.text)


def test_a_step_that_raises_says_where(tmp_path: Path) -> None:
    _, failed = play(tmp_path, "return 1 / 0", load("plugin"), step())
    assert isinstance(failed, PatternFailed)
    assert "ZeroDivisionError" in failed.text
    assert "plugin.py:9" in failed.text


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("import os; os.kill(os.getpid(), 9)", "SIGKILL"),
        ("import os; os._exit(5)", "code 5"),
        ("raise SystemExit", "code 0"),
        ("import ctypes; ctypes.string_at(0)", "SIGSEGV"),
        ("bytearray(1 << 33)", "more memory"),
        (
            "import os, time\n        if os.fork() == 0: time.sleep(60)\n        os._exit(3)",
            "code 3",
        ),
    ],
)
def test_a_death_is_told_with_its_cause(tmp_path: Path, body: str, words: str) -> None:
    _, died = play(tmp_path, body, load("plugin"), step())
    assert isinstance(died, HostDied)
    assert words in died.text


def test_after_a_kill_a_fresh_host_takes_the_next_load(tmp_path: Path) -> None:
    answers = play(
        tmp_path, "return Twist(0.1)", load("plugin"), KillHost("test"), load("plugin", 2), step(2)
    )
    assert [type(answer) for answer in answers] == [Loaded, Loaded, Stepped]


def test_closing_leaves_no_process_behind(tmp_path: Path) -> None:
    async def run() -> int | None:
        played = Played(tmp_path)
        played.runner.send(load("drive"))
        await played.next()
        pid = played.runner.pid
        played.runner.close()
        async with asyncio.timeout(30.0):
            while pid is not None and os.path.exists(f"/proc/{pid}"):
                await asyncio.sleep(0.01)
        return pid

    assert asyncio.run(run()) is not None

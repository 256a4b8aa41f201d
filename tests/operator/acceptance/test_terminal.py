"""The shell on a pseudo terminal of 40 columns, with a robot that is no more than its actions."""

from __future__ import annotations

import math
import os
import pty
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError
from swarmd.core.values import Pose
from swarmd.operator.acceptance.dialogue import (
    SOON,
    Closed,
    Dialogue,
    Input,
    Judged,
    Key,
    Line,
    Refused,
    Sight,
)
from swarmd.operator.acceptance.result_file import (
    AcceptanceRecord,
    read_record,
    result_of,
    with_step,
)
from swarmd.operator.acceptance.step import End, Motion, Step
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, passed
from swarmd.operator.cli import dialogue as shell
from swarmd.operator.verbs.acceptance.results import Results, wanted_steps
from swarmd.operator.verbs.acceptance.talk import Talk
from swarmd.settings.platforms import load_platform

CAP = 20.0  # s
SHORT = Motion("drive", {"speed": 0.1}, 60.0, 0.1, 0.0, reach=2.0)
DRIVE = Step("B1", "a drive", "A reason.", lambda _: passed("fine"), question="Free?", motion=SHORT)
LOOK = Step("A1", "a look", "Another reason.", lambda _: passed("well", "5 Hz", "4 Hz"))
RECORD = AcceptanceRecord(robot="r", platform="burger", driver="none", began="2026-11-27")


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of a terminal that is standard input."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "rb", buffering=0) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        monkeypatch.setenv("COLUMNS", "40")
        yield ours
    os.close(ours)


def typed(terminal: shell.Terminal, *, gives_lines: bool) -> Input | None:
    """What the terminal gives next."""
    end = time.monotonic() + CAP
    while time.monotonic() < end:
        if (found := terminal.read(gives_lines, 0.05)) is not None:
            return found
    return None


def test_lines_while_asked_and_keys_while_moving(keyboard: int) -> None:
    terminal = shell.Terminal()
    os.write(keyboard, b"yes\n")
    assert typed(terminal, gives_lines=True) == Line("yes\n")
    assert terminal.read(False, 0.0) is None
    os.write(keyboard, b" ")
    assert typed(terminal, gives_lines=False) == Key()
    os.write(keyboard, b"y\n")
    time.sleep(0.1)
    assert terminal.read(True, 0.1) is None, "typed before the question"
    terminal.close()


def test_what_is_typed_before_a_question_is_discarded(keyboard: int) -> None:
    terminal = shell.Terminal()
    os.write(keyboard, b"y\ny\n")
    time.sleep(0.1)
    terminal.discard()
    assert terminal.read(True, 0.2) is None
    os.write(keyboard, b"n\n")
    assert typed(terminal, gives_lines=True) == Line("n\n")


def test_a_yes_that_waited_for_a_frozen_program_is_no_answer(
    keyboard: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = shell.Terminal()
    assert terminal.read(True, 0.0) is None
    os.write(keyboard, b"y\n")
    monkeypatch.setattr(shell, "boottime", lambda: boottime() + 30.0)  # as after SIGCONT
    assert typed_within(terminal, 5) == []
    assert "too late" in " ".join(capsys.readouterr().err.split())
    os.write(keyboard, b"y\n")
    assert typed(terminal, gives_lines=True) == Line("y\n")


def typed_within(terminal: shell.Terminal, reads: int) -> list[Input]:
    """What so many reads of 0.05 s give."""
    return [found for _ in range(reads) if (found := terminal.read(True, 0.05)) is not None]


def test_the_end_of_the_terminal_is_told(keyboard: int) -> None:
    terminal = shell.Terminal()
    os.write(keyboard, b"\x04")
    assert typed(terminal, gives_lines=True) == Closed()


class FakeRobot:
    """Rests, and moves from the begin of a step until it is stopped."""

    def __init__(self) -> None:
        self.inputs: queue.SimpleQueue[Input] = queue.SimpleQueue()
        self.did: list[str] = []
        self.said_at = math.nan
        self.fault: Exception | None = None
        self.is_moving = threading.Event()
        self.is_over = threading.Event()
        threading.Thread(target=self._tell, daemon=True).start()

    def _tell(self) -> None:
        while not self.is_over.wait(0.05):
            pattern = "drive" if self.is_moving.is_set() else ""
            self.inputs.put(Sight(pattern, False, Pose()))

    def begin(self, step: Step, said_at: float) -> None:
        self.did.append(f"begin {step.id}")
        self.said_at = said_at
        if step.motion is not None:
            self.is_moving.set()

    def bring(self, end: End) -> None:
        self.did.append(f"bring {end}")

    def stop(self) -> None:
        self.did.append("stop")
        self.is_moving.clear()

    def check(self) -> None:
        if self.fault is not None and self.is_moving.is_set():
            raise self.fault

    def wait_for_stop(self) -> str:
        self.did.append("waited")
        return "commanded zero"

    def judge(self, step: Step, verdicts: Any) -> None:
        self.inputs.put(Judged(step.judge(None)))  # type: ignore[arg-type]


@pytest.fixture
def robot() -> Iterator[FakeRobot]:
    made = FakeRobot()
    yield made
    made.is_over.set()


def talk(robot: FakeRobot, folder: Path, *steps: Step) -> Talk:
    results = Results(folder, RECORD, steps)
    return Talk(Dialogue(steps, {}), robot, shell.Terminal(), results)  # type: ignore[arg-type]


class Person:
    """Answers each question by the next of `lines`, or the last, and stops the robot that moves."""

    def __init__(self, keyboard: int, one: Talk, robot: FakeRobot, *lines: bytes) -> None:
        self._keyboard, self._one, self._robot, self._lines = keyboard, one, robot, list(lines)
        self._asked = threading.Event()
        assert isinstance(one._person, shell.Terminal)
        self._terminal = one._person
        discard = self._terminal.discard

        def discard_and_tell() -> None:  # what was typed before a question is discarded
            discard()
            self._asked.set()

        self._terminal.discard = discard_and_tell  # type: ignore[method-assign]
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self) -> None:
        while not self._robot.is_moving.is_set():
            self._asked.wait(2.0)
            self._asked.clear()
            time.sleep(1.5)  # the dialogue refuses an answer within the first second
            if self._one._is_asked:
                os.write(self._keyboard, self._lines[0])
                self._lines = self._lines[1:] or self._lines

    def stops(self, stop: Callable[[], object]) -> None:
        """Call `stop` once the robot moves and single keys are read, until it stands."""

        def stop_moving() -> None:
            self._robot.is_moving.wait(CAP)
            while self._robot.is_moving.is_set():
                if not self._terminal._gives_lines:
                    time.sleep(0.3)
                    stop()
                    time.sleep(3.0)

        threading.Thread(target=stop_moving, daemon=True).start()


@pytest.mark.long
def test_a_drive_on_40_columns_that_a_key_stops(
    keyboard: int, robot: FakeRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = talk(robot, tmp_path, LOOK, DRIVE)
    Person(keyboard, one, robot, b"what?\n", b"y\n").stops(lambda: os.write(keyboard, b"x"))
    one.run()
    assert robot.did[:3] == ["begin A1", "begin B1", "stop"]
    assert read_record(tmp_path).is_whole
    verdicts = read_record(tmp_path).verdicts
    assert verdicts["A1"].result is Result.PASS
    assert (verdicts["B1"].result, "key" in verdicts["B1"].reason) == (Result.NOT_SHOWN, True)
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 40
    text = " ".join(" ".join(lines).split())
    for words in ("B1 a drive (2/2", "A reason.", "2.00 m at most", "Free? [y/N]", "4 Hz"):
        assert words in text


@pytest.mark.parametrize(("age", "begun"), [(60.0, ["begin C1"]), (3 * 86400.0, [])])
def test_a_pass_of_days_ago_lets_nothing_move_in_a_dialogue_left_open(
    keyboard: int, robot: FakeRobot, tmp_path: Path, age: float, begun: list[str]
) -> None:
    """docs/acceptance.md: a pass counts for a day."""
    second = replace(DRIVE, id="C1", needs=("B1",))
    steps, verdict = [DRIVE, second], passed("fine")
    kept = result_of(DRIVE, verdict, (), time.time() - age, {})
    record = with_step(RECORD, kept, ["B1", "C1"])
    dialogue, results = Dialogue(steps, {"B1": verdict}), Results(tmp_path, record, steps)
    one = Talk(dialogue, robot, shell.Terminal(), results)  # type: ignore[arg-type]
    one._begin(second)
    assert robot.did == begun
    refused = [robot.inputs.get(timeout=CAP) for _ in range(3)]
    assert [type(one) for one in refused if not isinstance(one, Sight)] == [
        Refused for _ in range(not begun)
    ]
    one._person.close()


@pytest.mark.long
def test_ctrl_c_stops_and_waits_for_the_stop(
    keyboard: int, robot: FakeRobot, tmp_path: Path
) -> None:
    one = talk(robot, tmp_path, DRIVE)
    Person(keyboard, one, robot, b"y\n").stops(lambda: os.kill(os.getpid(), signal.SIGINT))
    one.run()
    assert robot.did == ["begin B1", "stop", "waited"]
    assert read_record(tmp_path).verdicts == {}
    assert not read_record(tmp_path).is_whole


@pytest.mark.long
def test_an_error_stops_the_robot_and_is_raised(
    keyboard: int, robot: FakeRobot, tmp_path: Path
) -> None:
    robot.fault = RuntimeError("a fault of the program")
    one = talk(robot, tmp_path, DRIVE)
    Person(keyboard, one, robot, b"y\n")
    with pytest.raises(RuntimeError):
        one.run()
    assert robot.did == ["begin B1", "stop", "waited"]


def test_a_yes_that_was_given_before_answers_questions_and_at_last_no(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It lets no robot move that never comes to rest, and no key is read."""
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    keyboard = shell.GivenYes(42.0)
    words: list[Input | None] = []
    while not words or words[-1] == Line("y"):
        keyboard.discard()  # at a question
        now += SOON  # a yes until then does not count
        assert keyboard.read(True, 0.0) is None
        now += 5.0
        assert keyboard.read(False, 0.0) is None
        words.append(keyboard.read(True, 0.0))
    assert words[-1] == Line("n")
    assert len(words) == 3


def test_a_run_counts_as_issued_when_the_person_said_yes(robot: FakeRobot, keyboard: int) -> None:
    """A robot that was stopped since then refuses the run."""
    Talk(Dialogue([DRIVE], {}), robot, shell.GivenYes(42.0))._begin(DRIVE)  # type: ignore[arg-type]
    assert robot.said_at == 42.0
    terminal = shell.Terminal()
    os.write(keyboard, b"y\n")
    before = boottime()
    assert typed(terminal, gives_lines=True) == Line("y\n")
    after = boottime()
    Talk(Dialogue([DRIVE], {}), robot, terminal)._begin(DRIVE)  # type: ignore[arg-type]
    assert before <= robot.said_at <= after
    terminal.close()


def test_a_part_or_a_step_is_picked() -> None:
    steps = steps_of(load_platform("burger"))
    assert {one.id[0] for one in wanted_steps(steps, ("B",))} == {"B"}
    picked = {
        "A1": "A1",
        "A6": "A6 A7 A8 A9 A10 A11 A16",
        "B2": "B2",
        "C2": "C2 C3 C4 C5 C6 C7 C10",
    }
    for only, ids in picked.items():
        assert [one.id for one in wanted_steps(steps, (only,))] == ids.split()
    assert len(wanted_steps(steps, ())) == len(steps)
    with pytest.raises(ConfigError):
        wanted_steps(steps, ("B1", "E"))


def test_long_texts_are_wrapped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    for step in steps_of(load_platform("jackal")):
        shell.say(replace(step).prepare, "  ")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 50
    assert max(map(len, lines)) <= 40

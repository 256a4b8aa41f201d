"""Carries out the dialogue of an acceptance test: the one way in which a person lets it move.

`Talk` hands the actions of the dialogue to the robot, and its questions to a `Person`: the keyboard
of a terminal (`swarmd/operator/cli/dialogue.py`), or a function of a program (`Answers`).
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from msgspec import Struct

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError
from swarmd.operator.acceptance import dialogue as actions_of
from swarmd.operator.acceptance.dialogue import (
    SOON,
    Closed,
    Dialogue,
    Key,
    Line,
    Phase,
    Refused,
    Sight,
    Stop,
    Tick,
)
from swarmd.operator.session.clocks import TOO_LATE, InputWatch
from swarmd.operator.verbs.acceptance import words

if TYPE_CHECKING:
    from swarmd.operator.acceptance.dialogue import Action, Input
    from swarmd.operator.acceptance.step import Step
    from swarmd.operator.acceptance.verdict import Verdict
    from swarmd.operator.verbs.acceptance.results import Results
    from swarmd.operator.verbs.acceptance.tested_robot import TestedRobot

MAX_HASTY = 3
"""Answers of a program within SOON of the same question, after which the test ends."""
_PERIOD = 0.05  # s between two looks at the person and at the robot


class Question(Struct, frozen=True, kw_only=True):
    """A step that waits for an answer: `y`, `n`, `q` to end the test, or the number of a step.

    `told`: the lines since the question before, such as verdicts. `why`: one sentence. `prepare`:
    what the person does before the answer. `moves`: what moves, how far, how fast and for how long,
    at most; empty: nothing moves. `asks`: the question itself, which a yes confirms.
    """

    id: str
    head: str
    why: str
    prepare: str
    moves: str
    asks: str
    told: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """All of it, a line each, for a person."""
        shown = (*self.told, self.head, self.why, self.prepare, self.moves, self.asks)
        return "\n".join(line for line in shown if line)


class Person(Protocol):
    """Who is asked.

    `said_at`: when the last answer was given, in s on the clock since boot.
    """

    said_at: float

    @property
    def stop(self) -> str:
        """What stops a robot that moves, in words."""

    def ask(self, question: Question) -> None:
        """Show a question; what was answered before does not count."""

    def ask_for_key(self, question: Question) -> None:
        """Show what is asked of the person while no line is asked for; any answer is a key."""

    def read(self, gives_lines: bool, seconds: float) -> Input | None:
        """What the person did, within `seconds`; None for nothing. `gives_lines`: is asked."""

    def tell(self, text: str, indent: str = "") -> None:
        """Show a text."""

    def progress(self, line: str) -> None:
        """Show what the test does now, in place of the line before."""

    def close(self) -> None:
        """The dialogue has ended."""


class Talk:
    """Carries out the actions of a dialogue with a person and a robot.

    `results` keeps the verdicts on the disk; None: they stay in the dialogue.
    """

    def __init__(
        self,
        dialogue: Dialogue,
        robot: TestedRobot,
        person: Person,
        results: Results | None = None,
    ) -> None:
        self._dialogue = dialogue
        self._robot = robot
        self._person = person
        self._results = results
        self._end = ""
        self._doing = ""  # what the robot says that it does
        self._told = ""  # the line of progress that is shown

    @property
    def end(self) -> str:
        """Why the dialogue has ended; empty before."""
        return self._end

    def run(self) -> None:
        """Talk until the dialogue ends; Ctrl-C, signals and errors stop a robot that may move."""
        self._carry_out(self._dialogue.begin(time.monotonic()))
        try:
            while not self._end:
                self._take(self._person.read(self._is_asked, _PERIOD))
                while not self._robot.inputs.empty():
                    self._take(self._robot.inputs.get())
                self._take(Tick())
                self._robot.check()
                self._tell_progress()
        except (KeyboardInterrupt, SystemExit):
            pass
        finally:
            # Stops a robot that may move, after any error.
            last_actions = self._dialogue.take(Closed(), time.monotonic())
            self._carry_out(last_actions)
            self._person.close()
            answer = self._robot.wait_for_stop()
            if Stop() in last_actions:
                self._say(answer)

    @property
    def _is_asked(self) -> bool:
        return self._dialogue.phase is Phase.ASKED

    def _take(self, input: Input | None) -> None:
        if isinstance(input, Sight):
            self._doing = input.text
        if input is not None:
            self._carry_out(self._dialogue.take(input, time.monotonic()))

    def _carry_out(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case actions_of.Ask(step=step):
                    self._ask(step)
                case actions_of.Tell(text=text):
                    self._say(text)
                case actions_of.Await(step=step, text=text):
                    self._ask_for_key(step, text)
                case actions_of.Begin(step=step):
                    if not step.is_asked:
                        self._say(f"\n{self._head(step)}")
                        self._say(step.why, "  ")
                    self._begin(step)
                case actions_of.Bring(end=end):
                    self._robot.bring(end)
                case actions_of.Stop():
                    self._robot.stop()
                case actions_of.Judge(step=step):
                    self._robot.judge(step, self._dialogue.verdicts)
                case actions_of.Keep(step=step, verdict=verdict):
                    self._keep(step, verdict)
                case actions_of.Finish(text=text, is_whole=is_whole):
                    self._finish(text, is_whole)

    def _head(self, step: Step) -> str:
        return words.head(step, self._dialogue.place, self._dialogue.seconds_left)

    def _begin(self, step: Step) -> None:
        """Begin a step, unless a pass that it needs is not of the last day any more."""
        if self._results is not None and (old := self._results.outdated(step)):
            self._robot.inputs.put(Refused(words.outdated(old)))
            return
        self._robot.begin(step, self._person.said_at)

    def _ask(self, step: Step) -> None:
        self._told = ""
        question = Question(
            id=step.id,
            head=self._head(step),
            why=step.why,
            prepare=step.prepare,
            moves=words.moves(step.motion, self._person.stop),
            asks=words.question(step),
        )
        self._person.ask(question)

    def _ask_for_key(self, step: Step, text: str) -> None:
        self._told = ""
        head = self._head(step)
        self._person.ask_for_key(
            Question(id=step.id, head=head, why="", prepare="", moves="", asks=text)
        )

    def _tell_progress(self) -> None:
        """Show the line of progress when it changes, unless a question is open."""
        if self._is_asked or self._end:
            return
        line = words.progress(self._dialogue.phase, self._doing, self._person.stop)
        if line != self._told:
            self._person.progress(line)
            self._told = line

    def _keep(self, step: Step, verdict: Verdict) -> None:
        """Keep the verdict of a step, and show it."""
        if self._results is not None:
            self._results.keep(step, verdict)
        self._say(words.verdict_line(step, verdict), "  ")

    def _finish(self, text: str, is_whole: bool) -> None:
        self._end = text
        if self._results is not None:
            self._results.end(is_whole=is_whole)
        if not is_whole:
            self._say(f"\n{text}")

    def _say(self, text: str, indent: str = "") -> None:
        """Replace the line of progress by a text."""
        self._told = ""
        self._person.tell(text, indent)


class Answers:
    """The person behind a function that takes each question and returns the answer.

    `answer_all` calls the function on the thread of its caller; the other methods are called by the
    thread of the dialogue. `is_cancelled` returns True once the caller no longer waits: a robot
    that may move is then stopped, as by the end of a terminal.
    """

    stop = "Ctrl-C, or a stop from anywhere,"

    def __init__(self, is_cancelled: Callable[[], bool] = lambda: False) -> None:
        self.said_at = boottime()
        self._is_cancelled = is_cancelled
        self._is_left = False  # the caller does not answer any more
        self._questions: queue.SimpleQueue[Question | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[tuple[Question, float, str]] = queue.SimpleQueue()
        self._told: list[str] = []
        self._question: Question | None = None
        self._is_answered = False  # the answer to the question was read
        self._is_for_key = False  # any answer to the question is a key
        self._asked_at = boottime()
        self._watch = InputWatch(boottime())
        self._hasty = 0  # answers in a row that came within SOON of the question

    @property
    def told(self) -> tuple[str, ...]:
        """What was said since the last question."""
        return tuple(self._told)

    def answer_all(self, answer: Callable[[Question], str]) -> None:
        """Answer each question by `answer`, until the dialogue has ended.

        ConfigError if it returns no text. Any error ends the dialogue, which stops the robot.
        """
        try:
            while (question := self._questions.get()) is not None:
                text = answer(question)
                if not isinstance(text, str):  # a True would be no word of a person
                    raise ConfigError(
                        f"answer gave {text!r} for {question.id}; expected a text: y, n, q, or the"
                        " number of a step"
                    )
                self._answers.put((question, boottime(), text))
        except BaseException:
            self._is_left = True
            raise

    def ask(self, question: Question) -> None:
        """Hand a question to the function."""
        if self._question is None or question.id != self._question.id:
            self._hasty = 0
        self._is_for_key = False
        self._hand(question)

    def ask_for_key(self, question: Question) -> None:
        """Hand a question to the function, any answer to which is a key."""
        self._is_for_key = True
        self._hand(question)

    def _hand(self, question: Question) -> None:
        self._question = Question(
            id=question.id,
            head=question.head,
            why=question.why,
            prepare=question.prepare,
            moves=question.moves,
            asks=question.asks,
            told=tuple(self._told),
        )
        self._told.clear()
        self._is_answered = False
        self._asked_at = boottime()
        self._watch = InputWatch(self._asked_at)
        self._questions.put(self._question)

    def read(self, gives_lines: bool, seconds: float) -> Input | None:
        """The answer, within `seconds`.

        An answer to a program that stood still meanwhile is none: the question is asked again, as
        after an answer that the dialogue does not know.
        ConfigError if the same question was answered too often sooner than a person can read it.
        """
        if self._is_left or self._is_cancelled():
            return Closed()
        if gives_lines and self._is_answered and self._question is not None:
            self.ask(self._question)  # the dialogue did not take the answer, and has said why
        try:
            answered, said_at, text = self._answers.get(timeout=seconds)
        except queue.Empty:
            self._watch.look(boottime())
            return None
        question = self._question
        if question is None or answered is not question:  # one that is over, such as for a key
            return None
        if self._is_for_key:
            return None if gives_lines else Key()
        if not gives_lines:
            return None
        if not self._watch.is_unbroken(self._asked_at, boottime()):
            self.tell(f"No answer was taken: {TOO_LATE}")
            self.ask(question)
            return None
        self._hasty = self._hasty + 1 if said_at - self._asked_at < SOON else 0
        if self._hasty > MAX_HASTY:
            raise ConfigError(
                f"answer gave {text!r} for {question.id} {self._hasty} times within {SOON} s of the"
                " question; expected the answer of a person who has read it"
            )
        self.said_at = said_at
        self._is_answered = True
        return Line(text)

    def tell(self, text: str, indent: str = "") -> None:
        """Keep a text for the next question."""
        self._told.append(f"{indent}{text.strip()}")

    def progress(self, line: str) -> None:
        """Nobody watches."""

    def close(self) -> None:
        """End `answer_all` once the function has returned."""
        self._questions.put(None)

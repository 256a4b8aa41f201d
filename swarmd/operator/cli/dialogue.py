"""Carries out a dialogue on a terminal: the one way in which a person is asked for motion."""

from __future__ import annotations

import os
import select
import sys
import termios
import textwrap
import time
import tty
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.clock import boottime
from swarmd.operator.cli.output import rewrite, terminal_width
from swarmd.operator.client.input_watch import TOO_LATE, InputWatch
from swarmd.operator.texts.values import printable

if TYPE_CHECKING:
    from swarmd.operator.acceptance.dialogue import Action, Dialogue, Input
    from swarmd.operator.acceptance.step import Step
    from swarmd.operator.acceptance.verdict import Verdict
    from swarmd.operator.cli.acceptance import Results
    from swarmd.operator.cli.acceptance_robot import TestedRobot

_PERIOD = 0.05  # s between two looks at the keyboard and at the robot
_WIDEST = 78  # columns of a line
_YES_AFTER = 2.5  # s from a question to a yes that was given before: the robot must be seen at rest
_YES_TIMES = 2  # questions that are answered by it: a robot refuses a start that is 8 s old


class Talk:
    """Carries out the actions of a dialogue on a terminal.

    `results` keeps the verdicts on the disk; None: they stay in the dialogue.
    """

    def __init__(
        self,
        dialogue: Dialogue,
        robot: TestedRobot,
        keyboard: Terminal | GivenYes,
        results: Results | None = None,
    ) -> None:
        self._dialogue = dialogue
        self._robot = robot
        self._keyboard = keyboard
        self._results = results
        self._end = ""
        self._doing = ""  # what the robot says that it does
        self._told = ""  # the line of progress that is shown

    def run(self) -> None:
        """Talk until the dialogue ends; Ctrl-C, signals and errors stop a robot that may move."""
        from swarmd.operator.acceptance.dialogue import Closed, Stop, Tick

        self._carry_out(self._dialogue.begin(time.monotonic()))
        try:
            while not self._end:
                self._take(self._keyboard.read(self._is_asked, _PERIOD))
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
            self._keyboard.close()
            answer = self._robot.wait_for_stop()
            if Stop() in last_actions:
                self._say(answer)

    @property
    def _is_asked(self) -> bool:
        return self._dialogue.phase == "asked"

    def _take(self, input: Input | None) -> None:
        from swarmd.operator.acceptance.dialogue import Sight

        if isinstance(input, Sight):
            self._doing = input.text
        if input is not None:
            self._carry_out(self._dialogue.take(input, time.monotonic()))

    def _carry_out(self, actions: Sequence[Action]) -> None:
        from swarmd.operator.acceptance import dialogue

        for action in actions:
            match action:
                case dialogue.Ask(step=step):
                    self._ask(step)
                case dialogue.Tell(text=text):
                    self._say(text)
                case dialogue.Begin(step=step):
                    if not step.is_asked:
                        self._head(step)
                    self._begin(step)
                case dialogue.Bring(end=end):
                    self._robot.bring(end)
                case dialogue.Stop():
                    self._robot.stop()
                case dialogue.Judge(step=step):
                    self._robot.judge(step, self._dialogue.verdicts)
                case dialogue.Keep(step=step, verdict=verdict):
                    self._keep(step, verdict)
                case dialogue.Finish(text=text, is_whole=is_whole):
                    self._finish(text, is_whole)

    def _head(self, step: Step) -> None:
        left = round(self._dialogue.seconds_left / 60.0)
        self._say(f"\n{step.id} {step.name} ({self._dialogue.place}, {left} min left)")
        self._say(step.why, "  ")

    def _begin(self, step: Step) -> None:
        """Begin a step, unless a pass that it needs is not of the last day any more."""
        if self._results is not None and (old := self._results.outdated(step)):
            from swarmd.operator.acceptance.dialogue import Refused

            why = f"the pass of {old} is not of the last day: the same command asks it again"
            self._robot.inputs.put(Refused(why))
            return
        self._robot.begin(step, self._keyboard.said_at)

    def _ask(self, step: Step) -> None:
        self._head(step)
        self._say(step.prepare, "  ")
        if step.motion is not None:
            self._say(f"MOVES: {step.motion.text}; {self._keyboard.stop} stops it.", "  ")
        self._say(f"{step.question or 'Ready?'} [y/N]", "  ")
        self._keyboard.discard()

    def _tell_progress(self) -> None:
        """Show the line of progress when it changes, unless a question is open."""
        if self._is_asked or self._end:
            return
        words = {"measuring": "measures", "moving": "MOVES", "resting": "waits for rest"}
        word = words.get(self._dialogue.phase, "judges")
        doing = f": {self._doing}" if self._doing else ""
        line = f"  {word}{doing}; {self._keyboard.stop} ends it"
        if line != self._told:
            rewrite(line)
            self._told = line

    def _keep(self, step: Step, verdict: Verdict) -> None:
        """Keep the verdict of a step, and show it."""
        if self._results is not None:
            self._results.keep(step, verdict)
        bound = f" (bound {verdict.bound})" if verdict.bound else ""
        figure = f" {verdict.figure}{bound}:" if verdict.figure else ""
        self._say(f"{step.id} {verdict.result.upper()}{figure} {verdict.reason}", "  ")

    def _finish(self, text: str, is_whole: bool) -> None:
        self._end = text
        if self._results is not None:
            self._results.end(is_whole=is_whole)
        if not is_whole:
            self._say(f"\n{text}")

    def _say(self, text: str, indent: str = "") -> None:
        """Replace the line of progress by a text."""
        rewrite("")
        self._told = ""
        say(text, indent, err=True)


class GivenYes:
    """Answers with the consent that was given at `said_at`, in s on the clock since boot."""

    stop = "Ctrl-C"

    def __init__(self, said_at: float) -> None:
        self.said_at = said_at
        self._answers = _YES_TIMES * ["y"]
        self._asked_at = time.monotonic()

    def read(self, gives_lines: bool, seconds: float) -> Input | None:
        """A yes once the question has stood for _YES_AFTER, to so many questions; then a no."""
        from swarmd.operator.acceptance.dialogue import Line

        time.sleep(seconds)
        if not gives_lines or time.monotonic() - self._asked_at < _YES_AFTER:
            return None
        return Line(self._answers.pop() if self._answers else "n")

    def discard(self) -> None:
        """Note that a question was asked."""
        self._asked_at = time.monotonic()

    def close(self) -> None:
        """There is no terminal to restore."""


class Terminal:
    """The keyboard: lines while a question is open, else single keys.

    `said_at`: when the last line was read, in s on the clock since boot.
    """

    stop = "any key"

    def __init__(self) -> None:
        self.said_at = boottime()
        self._descriptor = sys.stdin.fileno()
        self._before: list[Any] = termios.tcgetattr(self._descriptor)
        self._gives_lines = True
        self._watch = InputWatch(boottime())

    def read(self, gives_lines: bool, seconds: float) -> Input | None:
        """What was typed, within `seconds`; None for nothing.

        A line that may have waited for this program while it stood still is no answer.
        """
        from swarmd.operator.acceptance.dialogue import Closed, Key, Line

        if gives_lines is not self._gives_lines:
            self._gives_lines = gives_lines
            if gives_lines:
                self.close()
            else:
                tty.setcbreak(self._descriptor)
                mode = termios.tcgetattr(self._descriptor)
                mode[0] &= ~termios.IXON  # Ctrl-S is a key, too, and blocks no line of progress
                termios.tcsetattr(self._descriptor, termios.TCSANOW, mode)
        now = boottime()
        if not select.select([self._descriptor], [], [], seconds)[0]:
            self._watch.look(now)
            return None
        try:
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal has gone
            return Closed()
        if not data:
            return Closed()
        self.said_at = boottime()
        if gives_lines and self._watch.arrival(self.said_at) < 0.0:
            self.discard()
            say(f"No answer was taken: {TOO_LATE}", err=True)
            return None
        return Line(data.decode(errors="replace")) if gives_lines else Key()

    def discard(self) -> None:
        """Discard what was typed before now."""
        termios.tcflush(self._descriptor, termios.TCIFLUSH)

    def close(self) -> None:
        """The terminal as it was; what was typed is discarded."""
        termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._before)


def say(text: str, indent: str = "", *, err: bool = False) -> None:
    """Print a text, wrapped to the terminal; nothing for an empty text."""
    if not text:
        return

    width = min(terminal_width(), _WIDEST)
    begin = "\n" if text.startswith("\n") else ""
    lines = textwrap.wrap(
        printable(text.strip()), width, initial_indent=indent, subsequent_indent=indent + "  "
    )
    click.echo(begin + "\n".join(lines), err=err)

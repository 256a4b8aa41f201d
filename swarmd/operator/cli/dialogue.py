"""The person of a dialogue at a terminal, and a consent that was given with the command.

`Talk` of `swarmd/operator/verbs/acceptance/talk.py` asks them before each motion.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import textwrap
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.clock import boottime
from swarmd.operator.cli.output import rewrite, terminal_width
from swarmd.operator.session.clocks import TOO_LATE, InputWatch
from swarmd.operator.texts.values import printable

if TYPE_CHECKING:
    from swarmd.operator.acceptance.dialogue import Input
    from swarmd.operator.cli.options import CommonOptions
    from swarmd.operator.verbs.acceptance.talk import Question
    from swarmd.operator.verbs.acceptance.tested_robot import Sessions

_WIDEST = 78  # columns of a line
_YES_AFTER = 2.5  # s from a question to a yes that was given before: the robot must be seen at rest
_YES_TIMES = 2  # questions that are answered by it: a robot refuses a start that is 8 s old


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

    def ask(self, question: Question) -> None:
        """Show a question."""
        _show(question)
        self.discard()

    def ask_for_key(self, question: Question) -> None:
        """Show what is asked; the consent is none to it."""
        _tell(question.asks)

    def tell(self, text: str, indent: str = "") -> None:
        """Show a text."""
        _tell(text, indent)

    def progress(self, line: str) -> None:
        """Show what the test does now."""
        rewrite(f"  {line}")

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

    def ask(self, question: Question) -> None:
        """Show a question; what was typed before now is discarded."""
        _show(question)
        self.discard()

    def ask_for_key(self, question: Question) -> None:
        """Show what is asked; the terminal gives keys meanwhile."""
        _tell(question.asks)

    def tell(self, text: str, indent: str = "") -> None:
        """Show a text in place of the line of progress."""
        _tell(text, indent)

    def progress(self, line: str) -> None:
        """Show what the test does now."""
        rewrite(f"  {line}")

    def discard(self) -> None:
        """Discard what was typed before now."""
        termios.tcflush(self._descriptor, termios.TCIFLUSH)

    def close(self) -> None:
        """The terminal as it was; what was typed is discarded."""
        termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._before)


@contextmanager
def sessions_of(options: CommonOptions) -> Iterator[Sessions]:
    """Sessions with the robots of these options, without lines for the user about each look."""
    from swarmd.operator.client.operator_pool import OperatorPool
    from swarmd.operator.client.swarm import Swarm

    with Swarm(OperatorPool(partial(options.operator, lambda text: None))) as swarm:
        yield swarm._sessions


def _show(question: Question) -> None:
    _tell(f"\n{question.head}")
    for line in (question.why, question.prepare, question.moves, question.asks):
        _tell(line, "  ")


def _tell(text: str, indent: str = "") -> None:
    """Replace the line of progress by a text."""
    rewrite("")
    say(text, indent, err=True)


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

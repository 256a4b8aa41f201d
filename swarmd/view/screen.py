"""A terminal's alternate screen: keys come unbuffered, lines are painted when they change."""

from __future__ import annotations

import contextlib
import os
import sys
import termios
import tty
from collections.abc import Sequence
from typing import Any, Self

from rich.console import Console
from rich.text import Text

# Alternate screen, hidden cursor, no wrapping, pasted text in brackets (xterm's control sequences).
_ENTER = "\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[?2004h"
_LEAVE = "\x1b[0m\x1b[?2004l\x1b[?7h\x1b[?25h\x1b[?1049l"


class Screen:
    """A context manager: the terminal is as before after every end of the block.

    Ctrl-C, Ctrl-Z and Ctrl-\\ stay signals. `resume` and `suspend` may be called in between.
    """

    def __init__(self) -> None:
        self.input = sys.stdin.fileno()
        self._output = sys.stdout
        self._console = Console(file=self._output, highlight=False)
        self._before: list[Any] | None = None
        self._painted: list[Text] = []
        self._size = (0, 0)

    def __enter__(self) -> Self:
        self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        self.suspend()

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        size = os.get_terminal_size(self._output.fileno())
        return max(size.columns, 1), max(size.lines, 1)

    def resume(self) -> None:
        """Take the terminal."""
        self._before = termios.tcgetattr(self.input)
        tty.setcbreak(self.input)
        self._write(_ENTER)
        self.forget()

    def suspend(self) -> None:
        """Give the terminal back as it was, also if it is gone; keys that wait are dropped."""
        before, self._before = self._before, None
        if before is None:
            return
        with contextlib.suppress(OSError):
            self._write(_LEAVE)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self.input, termios.TCSAFLUSH, before)

    def forget(self) -> None:
        """Paint everything anew at the next `paint`."""
        self._painted = []

    def paint(self, lines: Sequence[Text]) -> None:
        """Show these lines; writes those that have changed, all if the terminal has a new size."""
        if self.size != self._size:
            self._size = self.size
            self.forget()
        changes = [] if self._painted else ["\x1b[2J"]
        for number, line in enumerate(lines):
            if number >= len(self._painted) or line != self._painted[number]:
                changes.append(f"\x1b[{number + 1};1H\x1b[2K{self._ansi(line)}")
        if len(lines) < len(self._painted):
            changes.append(f"\x1b[{len(lines) + 1};1H\x1b[J")
        self._painted = list(lines)
        if changes:
            self._write("".join(changes))

    def _ansi(self, line: Text) -> str:
        with self._console.capture() as capture:
            self._console.print(line, end="", no_wrap=True, overflow="crop", crop=True)
        return capture.get()

    def _write(self, text: str) -> None:
        self._output.write(text)
        self._output.flush()

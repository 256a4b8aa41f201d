"""A terminal's alternate screen, of which changed lines are painted anew, and its typed keys.

Not `textual`: its import takes five times as long (2.2 s against 0.45 s on one busy machine), and
its packages take 24 MB.
"""

from __future__ import annotations

import contextlib
import os
import re
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
_SEQUENCE = re.compile(
    rb"\x1b\[200~.*?\x1b\[201~"  # pasted text
    rb"|\x1b\[(?!200~)[0-?]*[ -/]*[@-~]|\x1bO."  # CSI and SS3 of ECMA-48
    rb"|\x1b(?=[^\[O])",
    re.DOTALL,
)
SEQUENCE_TIME = 0.5
"""A sequence that does not go on for this time, in s, is dropped: it swallows no later key."""


class Screen:
    """The terminal as a screen; a context manager that restores the terminal at its end.

    Ctrl-C, Ctrl-Z and Ctrl-\\ stay signals. `resume` and `suspend` may be called within the block.
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
        """Columns and rows; 80 and 24 where the terminal does not know them."""
        size = os.get_terminal_size(self._output.fileno())
        return size.columns or 80, size.lines or 24

    def resume(self) -> None:
        """Take the terminal."""
        self._before = termios.tcgetattr(self.input)
        tty.setcbreak(self.input)
        self._write(_ENTER)
        self._painted = []

    def suspend(self) -> None:
        """Restore the terminal, even if it is gone; waiting keys are dropped."""
        before = self._before
        self._before = None
        if before is None:
            return
        with contextlib.suppress(OSError):
            self._write(_LEAVE)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self.input, termios.TCSAFLUSH, before)

    def paint(self, lines: Sequence[Text]) -> None:
        """Show these lines; writes only changed lines, or all if the terminal was resized."""
        if self.size != self._size:
            self._size = self.size
            self._painted = []
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


class TypedKeys:
    """The bytes that a user types at a terminal. Pure.

    Pasted text and the sequences of other keys, as of arrows, are left out whole, so that none of
    their letters acts as a key.
    """

    def __init__(self) -> None:
        self._pending = b""
        self._fed_at = 0.0

    def feed(self, data: bytes, now: float) -> bytes:
        """The typed bytes of `data`, which was read at `now` in s; 0 in place of a sequence."""
        if now - self._fed_at > SEQUENCE_TIME:
            self._pending = b""
        self._fed_at = now
        typed, escape, rest = _SEQUENCE.sub(b"\0", self._pending + data).partition(b"\x1b")
        # The begin and the end tell when the sequence is complete: a long paste is not kept.
        begun = escape + rest
        self._pending = begun[:6] + begun[6:][-6:]
        return typed

"""A terminal's alternate screen, of which changed lines are painted anew, and a decoder of keys.

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
_CSI = re.compile(rb"\x1b\[[0-?]*[ -/]*([@-~])")
_SS3 = re.compile(rb"\x1bO(.)", re.DOTALL)
_NAMES = {**{b"A": "up", b"B": "down", b"C": "right", b"D": "left", b"H": "home", b"F": "end"}}
_NUMBERED = {b"1": "home", b"4": "end", b"5": "pageup", b"6": "pagedown", b"7": "home", b"8": "end"}
_CONTROLS = {
    **{"\r": "enter", "\n": "enter", "\t": "tab", "\x7f": "backspace", "\x08": "backspace"},
    **{" ": "space", "\x05": "ctrl-e", "\x15": "ctrl-u", "\x0c": "ctrl-l"},
}
_PASTE, _PASTE_END = b"\x1b[200~", b"\x1b[201~"
PASTED = "pasted:"
"""Prefix of a key that stands for pasted text."""
MAX_PENDING = 4096


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
        self.forget()

    def suspend(self) -> None:
        """Restore the terminal, even if it is gone; waiting keys are dropped."""
        before, self._before = self._before, None
        if before is None:
            return
        with contextlib.suppress(OSError):
            self._write(_LEAVE)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self.input, termios.TCSAFLUSH, before)

    def forget(self) -> None:
        """Let the next `paint` write all lines."""
        self._painted = []

    def paint(self, lines: Sequence[Text]) -> None:
        """Show these lines; writes only changed lines, or all if the terminal was resized."""
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


class KeyDecoder:
    """Decodes bytes into names of keys, such as `up`, `enter`, `a`; pasted text is one key. Pure.

    Sequences follow ECMA-48: CSI is ESC [, parameters 0x30-0x3f, intermediates 0x20-0x2f and a
    final byte 0x40-0x7e; SS3 is ESC O and one byte. An unknown sequence is dropped whole, so that
    none of its letters acts as a key.
    """

    def __init__(self) -> None:
        self._pending = b""

    @property
    def is_pending(self) -> bool:
        """True while an ESC may be the begin of a sequence; call `flush` if no byte follows."""
        return bool(self._pending)

    def feed(self, data: bytes) -> list[str]:
        """The keys that are complete now."""
        self._pending += data
        keys: list[str] = []
        while self._pending and (taken := self._take(keys)):
            self._pending = self._pending[taken:]
        if len(self._pending) > MAX_PENDING:
            self._pending = b""
        return keys

    def flush(self) -> list[str]:
        """The keys of an incomplete sequence that was not continued: a single ESC is `escape`."""
        pending, self._pending = self._pending, b""
        return ["escape"] if pending == b"\x1b" else []

    def _take(self, keys: list[str]) -> int:
        """Append the first key, unless it is unknown; its length in bytes, 0 while incomplete."""
        data = self._pending
        if data.startswith(_PASTE):
            end = data.find(_PASTE_END)
            if end < 0:
                return 0
            keys.append(PASTED + data[len(_PASTE) : end].decode(errors="replace"))
            return end + len(_PASTE_END)
        if data[:1] != b"\x1b":
            return self._take_character(keys)
        if found := _CSI.match(data) or _SS3.match(data):
            numbers = found[0][2:-1].split(b";")[0]
            name = _NUMBERED.get(numbers) if found[1] == b"~" else _NAMES.get(found[1])
            if name is not None:
                keys.append(name)
            return found.end()
        if len(data) == 1 or data[1:2] in (b"[", b"O"):
            return 0 if len(data) < 64 else len(data)
        keys.append("escape")
        return 1

    def _take_character(self, keys: list[str]) -> int:
        first = self._pending[0]
        size = 1 if first < 0xC0 else 2 if first < 0xE0 else 3 if first < 0xF0 else 4
        if len(self._pending) < size:
            return 0
        character = self._pending[:size].decode(errors="replace")
        key = _CONTROLS.get(character, character)
        if len(key) > 1 or key.isprintable():
            keys.append(key)
        return size

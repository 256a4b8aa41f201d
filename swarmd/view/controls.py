"""The state of a terminal view's controls, and the commands that keys give. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from fnmatch import fnmatchcase
from itertools import takewhile
from typing import Any

from swarmd.view.screen import PASTED

HELP = "e ESTOP  s stop  r run  x reset  ? keys  space select  a all  / filter  q quit"
KEYS = (
    "arrows, page up, page down, home, end: move    space: select    a: all, or none",
    "r: run on the selected robots, else on the one at the cursor; asks the pattern",
    "x: reset the same robots; asks    s: stop the selected robots, else all",
    "e: emergency-stop of the whole swarm, never asks; Ctrl-E also while you type",
    "/: show robots by a text in name, state, reason or pattern    Escape: show all",
    "Ctrl-L: draw anew    q: quit, the robots go on",
)
PAGE = 10


class Mode(StrEnum):
    """The present meaning of the keys."""

    LOOK = "look"
    FILTER = "filter"
    RUN = "run"
    RESET = "reset"


@dataclass(frozen=True, slots=True)
class Command:
    """The command of a key: `quit`, or a request with its robots; None: all robots of the swarm."""

    verb: str
    targets: tuple[str, ...] | None = None
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class Controls:
    """The cursor, the selection, the filter, and the text that is being typed."""

    patterns: Sequence[str] = ()
    mode: Mode = Mode.LOOK
    cursor: str = ""
    selected: set[str] = field(default_factory=set)
    filter: str = ""
    text: str = ""
    note: str = ""
    is_help_shown: bool = False
    targets: tuple[str, ...] = ()

    def shown(self, rows: Mapping[str, str]) -> tuple[str, ...]:
        """The robots that pass the filter; `rows`: by robot, the text that the filter searches."""
        wanted = self.filter.lower()
        return tuple(
            robot
            for robot, text in rows.items()
            if wanted in f"{robot} {text}".lower() or fnmatchcase(robot, wanted)
        )

    def follow(self, robots: Sequence[str], before: Sequence[str] = ()) -> None:
        """Keep the cursor on a shown robot, near its place in the earlier order `before`."""
        if self.cursor not in robots:
            at = before.index(self.cursor) if self.cursor in before else 0
            self.cursor = robots[min(at, len(robots) - 1)] if robots else ""

    def on_key(self, key: str, robots: Sequence[str], known: Sequence[str]) -> Command | None:
        """Act on a key; takes the robots that are shown, and all that are known."""
        self.note = ""
        self.is_help_shown = key == "?" and self.mode is Mode.LOOK and not self.is_help_shown
        if key == "ctrl-e":
            return Command("estop")
        if self.mode in (Mode.RUN, Mode.FILTER):
            return self._on_text(key)
        if self.mode is Mode.RESET:
            self.mode = Mode.LOOK
            if key in ("y", "Y"):
                return Command("reset", self.targets)
            self.note = "reset: nothing was sent"
            return Command("estop") if key in ("e", "E") else None
        return self._on_list_key(key, robots, known)

    @property
    def prompt(self) -> str:
        """The last line of the screen."""
        if self.mode is Mode.FILTER:
            return f"show robots with: {self.text}_   (Enter keeps it, Escape shows all)"
        if self.mode is Mode.RUN:
            typed, hints = self.text, ""
            if " " not in typed:
                hints = " ".join(self._matching(typed)) or "not installed here; robots may have it"
            return f"run on {names_of(self.targets)}: PATTERN [KEY=VALUE]... {typed}_   {hints}"
        if self.mode is Mode.RESET:
            return f"reset {names_of(self.targets)}? y resets, any other key does not"
        return self.note or HELP

    def _on_list_key(self, key: str, robots: Sequence[str], known: Sequence[str]) -> Command | None:
        """Act on a key while the list of robots has the keys; returns the command to send, if any.

        `robots`: the shown robots. `known`: all robots, also those that the filter hides. Stops
        need no confirmation. Keys r and x only open the line for a run or a reset.
        """
        # 1. Stops, and the end of the program.
        if key in ("e", "E"):
            return Command("estop")
        if key == "q":
            return Command("quit")
        if key in ("s", "S"):  # the selected robots; None: all robots
            return Command("stop", tuple(sorted(self.selected)) or None)
        # 2. The cursor and the selection.
        if key in ("up", "down", "pageup", "pagedown", "home", "end", "k", "j"):
            self._move(key, robots)
        elif key == "space" and self.cursor:
            self.selected ^= {self.cursor}
            self._move("down", robots)
        elif key == "a":  # selects all shown robots; if all are selected: none
            are_all_selected = self.selected.issuperset(robots)
            self.selected = set() if are_all_selected else {*self.selected, *robots}
        # 3. The filter.
        elif key == "/":
            self.mode, self.text = Mode.FILTER, self.filter
        elif key == "escape":
            self.filter = ""
        # 4. A run or a reset.
        elif key in ("r", "x"):
            self._begin(Mode.RUN if key == "r" else Mode.RESET, known)
        return None

    def _begin(self, mode: Mode, known: Sequence[str]) -> None:
        """Begin a run or reset of the selected robots, or else of the robot at the cursor."""
        selected = self.selected & set(known)
        at_cursor = {self.cursor} if self.cursor else set()
        self.targets = tuple(sorted(selected or at_cursor))
        if self.targets:
            self.mode, self.text = mode, ""
        else:
            self.note = "no robot is selected"

    def _on_text(self, key: str) -> Command | None:
        if key == "escape":
            self.filter = "" if self.mode is Mode.FILTER else self.filter
            self.mode, self.text = Mode.LOOK, ""
        elif key == "enter":
            return self._on_enter()
        elif key == "backspace":
            self.text = self.text[:-1]
        elif key == "ctrl-u":
            self.text = ""
        elif key == "tab" and self.mode is Mode.RUN:
            self.text = self._completed(self.text)
        elif key == "space" or len(key) == 1 or key.startswith(PASTED):
            typed = " " if key == "space" else key.removeprefix(PASTED)
            self.text += "".join(filter(str.isprintable, typed))
        if self.mode is Mode.FILTER:
            self.filter = self.text
        return None

    def _on_enter(self) -> Command | None:
        mode, self.mode = self.mode, Mode.LOOK
        if mode is Mode.FILTER:
            return None
        pattern, _, params = self.text.strip().partition(" ")
        if not pattern:
            self.note = "run: no pattern was given; nothing was sent"
            return None
        return Command("run", self.targets, {"pattern": pattern, "params": params})

    def _move(self, key: str, robots: Sequence[str]) -> None:
        if not robots:
            return
        steps = {"up": -1, "k": -1, "down": 1, "j": 1, "pageup": -PAGE, "pagedown": PAGE}
        at = robots.index(self.cursor) if self.cursor in robots else 0
        at = {"home": 0, "end": len(robots) - 1}.get(key, at + steps.get(key, 0))
        self.cursor = robots[min(max(at, 0), len(robots) - 1)]

    def _matching(self, begin: str) -> list[str]:
        return [name for name in self.patterns if name.startswith(begin)]

    def _completed(self, begin: str) -> str:
        """The typed text, extended by the common prefix of all patterns that begin with it."""
        found = self._matching(begin)
        if not found:
            return begin
        if len(found) == 1:
            return f"{found[0]} "
        shared = takewhile(lambda letters: len(set(letters)) == 1, zip(*found, strict=False))
        return "".join(letters[0] for letters in shared)


def names_of(names: Sequence[str], most: int = 4) -> str:
    """The names; for many, their number and the first names."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{len(names)} robots ({', '.join(names[: most - 1])}, ...)"

"""How far an experiment is, on stderr, and what ends it early."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from swarmd.cli.output import has_colour, warn

OnProgress = Callable[[int, int, int], None]
LINES = 10  # at most, where there is no terminal


@contextmanager
def progress() -> Iterator[OnProgress]:
    """Something to be told how many runs are done, of how many, and how many failed.

    It shows a bar on a terminal, else a line for each tenth.
    """
    if not sys.stderr.isatty():
        yield _Lines().tell
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True, no_color=not has_colour(True))
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs{task.fields[lost]}"))
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task("", total=None, lost="")

        def tell(done: int, total: int, failed: int) -> None:
            lost = f", {failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, lost=lost)

        yield tell


@contextmanager
def ends_on_sigterm() -> Iterator[None]:
    """SIGTERM ends what is within through its `finally` blocks. SIGHUP stays: it may be ignored."""

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _Lines:
    """A line each time another tenth is done."""

    def __init__(self) -> None:
        self._told = -1

    def tell(self, done: int, total: int, failed: int) -> None:
        """Say it, if it is worth a line."""
        part = LINES * done // total if total else LINES
        if part > self._told:
            self._told = part
            warn(f"{done} of {total} runs{f', {failed} failed' if failed else ''}")

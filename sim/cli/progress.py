"""Progress of an experiment on stderr, and an orderly end on SIGTERM."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from swarmd.cli.output import has_colour, seconds, warn

OnProgress = Callable[[int, int, int], None]
MAX_LINES = 10  # where there is no terminal, besides the first two


@contextmanager
def progress(clock: Callable[[], float] = time.monotonic) -> Iterator[OnProgress]:
    """A function to call with the numbers of finished, planned and failed runs.

    On a terminal it shows a bar, elsewhere a line for each tenth. Both show the time left once the
    first run has finished.
    """
    left = _TimeLeft(clock)
    if not sys.stderr.isatty():
        part = -1

        def show_lines(done: int, total: int, failed: int) -> None:
            nonlocal part
            text = left.text(done, total)
            now = MAX_LINES * done // total if total else MAX_LINES
            if now > part or left.is_first(done):
                part = now
                warn(f"{done} of {total} runs{_failed(failed)}{text}")

        yield show_lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True, no_color=not has_colour(True))
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs{task.fields[notes]}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, notes="")

        def show(done: int, total: int, failed: int) -> None:
            notes = _failed(failed) + left.text(done, total)
            bar.update(task, completed=done, total=total, notes=notes)

        yield show


@contextmanager
def ends_on_sigterm() -> Iterator[None]:
    """Within it SIGTERM raises SystemExit, so that `finally` blocks run.

    SIGHUP keeps its handler: it may be ignored on purpose.
    """

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _TimeLeft:
    """The time left, from the mean over the runs that have finished since the start.

    Rich's own estimate needs two samples some time apart: with few long runs it comes late.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._start: tuple[float, int] | None = None

    def text(self, done: int, total: int) -> str:
        """Such as `, about 5 min left`; empty before the first run and after the last."""
        now = self._clock()
        if self._start is None:
            self._start = now, done  # those of before, if an experiment is resumed
        began, before = self._start
        if done <= before or done >= total:
            return ""
        return f", about {seconds((now - began) / (done - before) * (total - done))} left"

    def is_first(self, done: int) -> bool:
        """True for the first run that finishes after the start."""
        return self._start is not None and done == self._start[1] + 1


def _failed(count: int) -> str:
    return f", {count} failed" if count else ""

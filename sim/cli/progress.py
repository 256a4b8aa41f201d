"""Progress of an experiment on stderr, and an orderly end on SIGTERM."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from swarmd.cli.output import has_colour, warn

OnProgress = Callable[[int, int, int], None]
MAX_LINES = 10  # where there is no terminal, besides the first two


@contextmanager
def progress(clock: Callable[[], float] = time.monotonic) -> Iterator[OnProgress]:
    """A function to call with the numbers of finished, planned and failed runs.

    A terminal shows a bar; other outputs get a line for each tenth. Both show the time left
    once the first run has finished. It is based on the mean time of a run since the start: Rich's
    own estimate needs two samples some time apart, so with few long runs it comes late.
    """
    start: tuple[float, int] | None = None  # time, and runs finished before

    def notes(done: int, total: int, failed: int) -> str:
        nonlocal start
        now = clock()
        start = start or (now, done)  # a resumed experiment has finished runs
        began, before = start
        text = f", {failed} failed" if failed else ""
        if not before < done < total:
            return text
        return f"{text}, about {_rounded((now - began) / (done - before) * (total - done))} left"

    if not sys.stderr.isatty():
        part = -1

        def show_lines(done: int, total: int, failed: int) -> None:
            nonlocal part
            text = notes(done, total, failed)
            now = MAX_LINES * done // total if total else MAX_LINES
            if now > part or (start is not None and done == start[1] + 1):
                part = now
                warn(f"{done} of {total} runs{text}")

        yield show_lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True, no_color=not has_colour(True))
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs{task.fields[notes]}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, notes="")
        yield lambda done, total, failed: bar.update(
            task, completed=done, total=total, notes=notes(done, total, failed)
        )


def _rounded(left: float) -> str:
    """A time left in whole seconds, above 120 s in minutes, above 120 min in hours."""
    if left <= 120:
        return f"{left:.0f} s"
    return f"{left / 60:.0f} min" if left <= 7200 else f"{left / 3600:.0f} h"


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

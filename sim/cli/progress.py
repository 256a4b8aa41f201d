"""Progress of an experiment on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from swarmd.cli.output import has_colour, warn

if TYPE_CHECKING:
    from swarmd.sim.experiments.simulate import OnProgress, Progress

MAX_LINES = 10  # where there is no terminal, besides the first two
FIRST_ESTIMATE = 2.0  # s of progress before there is an estimate


@contextmanager
def progress(clock: Callable[[], float] = time.monotonic) -> Iterator[OnProgress]:
    """A function to call with the progress of an experiment.

    A terminal shows a bar. Any other output gets a line for the first estimate, and for each tenth.
    The time left is estimated from the robot-seconds simulated since the first report of progress.
    So the estimate needs no finished run, and the start of workers does not count.
    """
    start: tuple[float, float] | None = None  # time, and work that was done before

    def notes(now: Progress) -> str:
        nonlocal start
        text = f", {now.failed} failed" if now.failed else ""
        if start is None and now.worked > 0.0:
            start = clock(), now.worked
        if start is None or now.left <= 0.0:
            return text
        passed, worked = clock() - start[0], now.worked - start[1]
        if passed < FIRST_ESTIMATE or worked <= 0.0:
            return text
        return f"{text}, about {time_span(passed / worked * now.left)} left"

    if not sys.stderr.isatty():
        part, has_estimate = -1, False

        def show_lines(now: Progress) -> None:
            nonlocal part, has_estimate
            text = notes(now)
            tenth = MAX_LINES * now.done // now.total if now.total else MAX_LINES
            is_first = not has_estimate and "left" in text
            if tenth > part or is_first:
                part, has_estimate = tenth, has_estimate or is_first
                warn(f"{now.done} of {now.total} runs{text}")

        yield show_lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True, no_color=not has_colour(True))
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs{task.fields[notes]}"))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, notes="")
        yield lambda now: bar.update(task, completed=now.done, total=now.total, notes=notes(now))


def time_span(seconds: float) -> str:
    """A time in seconds, above 120 s in minutes, above 120 min in hours."""
    if seconds <= 120:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds <= 7200 else f"{seconds / 3600:.0f} h"

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
    """Yield a function that shows the progress of an experiment on stderr.

    A terminal shows a bar. Any other output gets a line for the first estimate of the time left,
    and for each tenth of the runs. The estimate takes the rate of simulated robot-seconds since
    the first report with progress. So no run has to be finished, and the start of workers does not
    count.
    """
    first_report: tuple[float, float] | None = None  # time in s, robot-seconds simulated so far

    def failures_and_time_left(now: Progress) -> str:
        """Text such as ", 2 failed, about 30 s left". Sets `first_report`."""
        nonlocal first_report
        text = f", {now.failed} failed" if now.failed else ""
        if first_report is None and now.worked > 0.0:
            first_report = clock(), now.worked
        if first_report is None or now.left <= 0.0:
            return text
        first_time, first_worked = first_report
        elapsed, worked = clock() - first_time, now.worked - first_worked
        if elapsed < FIRST_ESTIMATE or worked <= 0.0:
            return text
        return f"{text}, about {time_span(elapsed / worked * now.left)} left"

    if not sys.stderr.isatty():
        printed_tenths, has_estimate = -1, False

        def show_lines(now: Progress) -> None:
            nonlocal printed_tenths, has_estimate
            text = failures_and_time_left(now)
            # Tenths of the runs that have ended, 0 to 10; without any run all have ended.
            tenths = MAX_LINES * now.done // now.total if now.total else MAX_LINES
            is_first_estimate = not has_estimate and text.endswith(" left")
            if tenths > printed_tenths or is_first_estimate:
                printed_tenths, has_estimate = tenths, has_estimate or is_first_estimate
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

        def show_bar(now: Progress) -> None:
            notes = failures_and_time_left(now)
            bar.update(task, completed=now.done, total=now.total, notes=notes)

        yield show_bar


def time_span(seconds: float) -> str:
    """A time in seconds, above 120 s in minutes, above 120 min in hours."""
    if seconds <= 120:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds <= 7200 else f"{seconds / 3600:.0f} h"

"""Progress of an experiment on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from swarmd.operator.cli.output import has_colour, warn

if TYPE_CHECKING:
    from swarmd.sim.experiments.simulate import OnProgress, Progress

MAX_LINES = 10  # without a terminal: a line for each tenth of the runs
FIRST_ESTIMATE = 2.0  # s of progress before there is an estimate


@contextmanager
def progress(clock: Callable[[], float] = time.monotonic) -> Iterator[OnProgress]:
    """Yield a function that shows the progress of an experiment on stderr.

    A terminal shows a bar. Any other output gets a line for the first estimate of the time left,
    and for each tenth of the runs.
    """
    notes = _Notes()
    if not sys.stderr.isatty():
        lines = _Lines(notes)
        yield lambda now: lines.show(now, clock())
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True, no_color=not has_colour(True))
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("runs{task.fields[notes]}"))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, notes="")

        def show_bar(now: Progress) -> None:
            text = notes.text(now, clock())
            bar.update(task, completed=now.done, total=now.total, notes=text)

        yield show_bar


class _Notes:
    """The text on failures and on the time left.

    The time left follows from the rate of simulated robot-seconds, so that an estimate needs no
    finished run. The rate is measured from the first report with simulated time on: before this
    report the workers start and simulate nothing.
    """

    def __init__(self) -> None:
        # Time in s and simulated robot-seconds of the first report with simulated time.
        self._first_report: tuple[float, float] | None = None

    def text(self, now: Progress, time: float) -> str:
        """Text such as ", 2 failed, about 30 s left"; empty if there is nothing to tell.

        `time`: of the report `now`, in s.
        """
        failures = f", {now.failed} failed" if now.failed else ""
        seconds = self._seconds_left(now, time)
        return failures if seconds is None else f"{failures}, about {time_span(seconds)} left"

    def _seconds_left(self, now: Progress, time: float) -> float | None:
        """The estimate of the time left in s; None before the first estimate, and at the end."""
        if now.worked == 0.0:  # a new experiment: a tuning has several
            self._first_report = None
        if self._first_report is None and now.worked > 0.0:
            self._first_report = time, now.worked
        if self._first_report is None or now.left <= 0.0:
            return None
        first_time, first_worked = self._first_report
        elapsed = time - first_time
        worked = now.worked - first_worked
        if elapsed < FIRST_ESTIMATE or worked <= 0.0:
            return None
        return elapsed / worked * now.left


class _Lines:
    """Prints a line for the first estimate of the time left, and for each tenth of the runs."""

    def __init__(self, notes: _Notes) -> None:
        self._notes = notes
        self._printed_tenths = -1
        self._has_estimate = False

    def show(self, now: Progress, time: float) -> None:
        text = self._notes.text(now, time)
        is_first_estimate = not self._has_estimate and text.endswith(" left")
        # Tenths of the runs that have ended; an experiment without runs has ended.
        tenths = MAX_LINES * now.done // now.total if now.total else MAX_LINES
        if tenths > self._printed_tenths or is_first_estimate:
            self._printed_tenths = tenths
            self._has_estimate = self._has_estimate or is_first_estimate
            warn(f"{now.done} of {now.total} runs{text}")


def time_span(seconds: float) -> str:
    """A time in seconds, above 120 s in minutes, above 120 min in hours."""
    if seconds <= 120:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds <= 7200 else f"{seconds / 3600:.0f} h"

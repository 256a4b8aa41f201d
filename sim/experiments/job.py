"""One run as a job: what it takes, what comes of it, and the doing itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.errors import SwarmError
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenariofile import scenario_of


@dataclass(frozen=True, slots=True)
class Job:
    """A run to be done: a whole scenario in plain values, a seed, and where its trace goes."""

    run: str
    effective: Mapping[str, Any]
    seed: int
    trace: Path | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job: `metrics` by name, or None and the reason in one line.

    `obstacle` is set where the trace could not be written: no other run's could be either. `wall`
    is in s.
    """

    run: str
    metrics: Mapping[str, float | None] | None = None
    wall: float = 0.0
    reason: str = ""
    obstacle: str = ""


def perform(job: Job, on_progress: Callable[[float], None] | None = None) -> Outcome:
    """Simulate, measure, and write the trace down, in this process.

    Nothing is raised for what goes wrong in the run: patterns and metrics may be anyone's.
    `on_progress` is told after each step which share has been simulated.
    """
    begin = time.perf_counter()
    try:
        trace = simulate_run(scenario_of(job.effective), job.seed, on_progress)
        metrics = measure(trace)
    except SwarmError as error:
        return Outcome(job.run, reason=one_line(str(error)))
    except Exception as error:
        return Outcome(job.run, reason=one_line(f"{type(error).__name__}: {error}"))
    if job.trace is not None:
        try:
            job.trace.parent.stat()  # a folder that was taken away is not made anew
            trace.save(job.trace)
        except OSError as error:
            remove_partial(job.trace)
            return Outcome(job.run, obstacle=f"{job.trace.parent}: {error.strerror or error}")
    return Outcome(job.run, metrics, time.perf_counter() - begin)


def remove_partial(trace: Path) -> None:
    """Remove what is left of a trace that was not written to its end, if it can be."""
    with suppress(OSError):
        trace.with_name(f".{trace.name}.partial").unlink(missing_ok=True)


def one_line(text: str) -> str:
    """The text on one line of at most 300 characters."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return line if len(line) <= 300 else f"{line[:297]}..."

"""Random walk: beside its rows, whether the turns of all runs together are to both sides."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from studies.outcomes.outcome import PATTERNS, Outcome, at_most
from studies.outcomes.rows import outcomes_with_runs
from swarmd.sim.experiments.outcomes import NAME as ROWS
from swarmd.sim.experiments.outcomes import read_outcomes
from swarmd.sim.trace import Trace

NAME = "random_walk"
SHORT_FORM = {"duration": 40.0}
FILM = {"stop": 60.0}
DURATION = 120.0
BIAS = 0.75
_PLACE = 3
"""How many rows stand above it."""


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run of walkers, and one of robots that drive straight ahead."""
    file = read_outcomes(PATTERNS / NAME / ROWS)
    sets = {name: {"duration": duration} for name in file.runs}
    rows, results = outcomes_with_runs(file, NAME, seeds, jobs, sets, traces=True)
    walkers = results["walkers"].traces
    bias = at_most(
        NAME,
        "turned more to one side, as a share",
        BIAS,
        [one_sidedness(walkers)],
        "both sides alike",
        len(walkers),
    )
    return [*rows[:_PLACE], bias, *rows[_PLACE:]]


def one_sidedness(traces: Iterable[Trace]) -> float:
    """The net turn of all robots as a share of all their turning."""
    turns = np.concatenate([np.diff(trace.pose[..., 2], axis=0).ravel() for trace in traces])
    return float(abs(turns.sum()) / np.abs(turns).sum())

"""Source seeking: robots reach the peak of a field, sooner and more of them than by random walk."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from studies.outcomes.outcome import (
    Outcome,
    at_least,
    at_most,
    mean_of,
    median_of,
    no_contacts,
    ratio_of,
)
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

NAME = "source_seeking"
IS_LONG = True
FILM = {"title": "up to the right", "stop": 120.0}
SOURCE, WITHIN = (2.0, 1.5), 1.7
"""The peak, and how near in m a robot has arrived: the reading is 79 % of the peak there."""
DURATION = 180.0
ARRIVED, GAIN, TIME = 0.9, 2.0, 100.0
"""The least share of robots that are there at the end, that share as a multiple of random walkers',
and the longest median time in s."""


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run of the pattern, and one of random walkers."""
    found = simulate(NAME, seeds, jobs=jobs, set={"duration": duration})
    walk = {"duration": duration, "groups.tb3.pattern": "random_walk"}
    walkers = simulate(NAME, seeds, jobs=jobs, set=walk)
    own, random = shares_there(found.traces), shares_there(walkers.traces)
    times = median_of(float(np.median(arrivals(trace))) for trace in found.traces)
    return [
        at_least(NAME, "share of robots at the source", ARRIVED, mean_of(own), "ours"),
        at_least(NAME, "that share / of random walkers", GAIN, ratio_of(own, random), "ours"),
        at_most(NAME, "median time to the source [s]", TIME, times, "ours"),
        no_contacts(NAME, found),
    ]


def shares_there(traces: Iterable[Trace]) -> list[float]:
    """The share of robots that are at the source at the end of each run."""
    return [float(_is_there(trace)[-1].mean()) for trace in traces]


def arrivals(trace: Trace) -> list[float]:
    """When each robot is first at the source, in s; infinite for one that never is."""
    is_there = _is_there(trace)
    first = np.where(is_there.any(axis=0), trace.t[is_there.argmax(axis=0)], np.inf)
    return [float(time) for time in first]


def _is_there(trace: Trace) -> np.ndarray:
    away = np.hypot(trace.pose[..., 0] - SOURCE[0], trace.pose[..., 1] - SOURCE[1])
    found: np.ndarray = away < WITHIN
    return found

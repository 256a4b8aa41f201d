"""Flocking: the robots move, together, and split less often than random walkers do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, number
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.aggregation import cluster_counts
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.trace import Trace

NAME = "flocking"
LINK = 1.5
"""m between axles of one flock: twice the rest length of a spring."""
SPEED, WAY, APART, MARGIN = 0.3, 0.8, 1.2, 3.0
"""Least mean speed as a share of the limit; least way of the centroid as a share of that of a
robot; most parts on average; and how many fewer than random walkers of the same start."""
_SPLITS = "Moeslinger et al. 2011: flocks rarely split; the margin: ours"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All of them: a run of the flock a seed, and one of random walkers from the same places."""
    results = simulate(NAME, seeds, jobs=jobs)
    walkers = simulate(NAME, seeds, jobs=jobs, set={"groups.tb3.pattern": "random_walk"})
    flocks = list(results.traces)
    numbers = [measure(trace) for trace in flocks]
    speeds = tuple(number(n["mean_speed"]) / 0.22 for n in numbers)
    shared = tuple(together(trace) for trace in flocks)
    touches = tuple(number(n["robot_contacts"]) + number(n["arena_contacts"]) for n in numbers)
    apart = tuple(parts(trace) for trace in flocks)
    margin = tuple(parts(trace) - own for trace, own in zip(walkers.traces, apart, strict=True))
    return [
        Outcome(NAME, "mean speed / limit", f">= {SPEED}", speeds, at_least(SPEED, speeds), "ours"),
        Outcome(
            NAME,
            "way of the centroid / way of a robot, last half",
            f">= {WAY}",
            shared,
            at_least(WAY, shared),
            "ours: n robots that are independent come to 1 / sqrt(n), here 0.38",
        ),
        Outcome(
            NAME, "parts, mean over time", f"<= {APART}", apart, at_most(APART, apart), _SPLITS
        ),
        Outcome(
            NAME,
            "parts fewer than of random walkers",
            f">= {MARGIN:g}",
            margin,
            at_least(MARGIN, margin),
            _SPLITS,
        ),
        Outcome(NAME, "touches", "0", touches, at_most(0.0, touches), "docs/safety.md"),
    ]


def parts(trace: Trace) -> float:
    """How many clusters there are, lone robots included, on average over the run."""
    return float(cluster_counts(trace, LINK).mean())


def together(trace: Trace) -> float:
    """The way of the centroid as a share of a robot's mean way, over the last half of the run.

    1 if all move alike, 0 if they mill or stand where they are.
    """
    half = len(trace.t) // 2
    place = trace.pose[half::10, :, :2]
    own = np.hypot(*np.moveaxis(np.diff(place, axis=0), -1, 0)).sum()
    centre = np.diff(place.mean(axis=1), axis=0)
    if own == 0.0:
        return 0.0
    return float(np.hypot(centre[:, 0], centre[:, 1]).sum() * place.shape[1] / own)

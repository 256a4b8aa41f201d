"""Flocking: the robots move, together, and split less often than random walkers do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.aggregation import cluster_counts
from swarmd.sim.trace import Trace

NAME = "flocking"
SHORT_FORM = {"duration": 30.0}
FILM = {"stop": 40.0, "seed": 1}
LINK = 1.5
"""Distance in m between axles of one flock: twice the rest length of a spring."""
SPEED, PATH, APART, MARGIN = 0.3, 0.8, 1.2, 3.0
"""Lower bounds of the mean speed as a share of the limit and of the centroid's path as a share of a
robot's; upper bound of the mean number of parts; how many fewer than random walkers."""
DURATION = 60.0
_SPLITS = "Moeslinger et al. 2011: flocks rarely split; the margin: ours"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run of the flock, and one of random walkers."""
    found = simulate(NAME, seeds, jobs=jobs, set={"duration": duration})
    changes = {"duration": duration, "groups.tb3.pattern": "random_walk"}
    walkers = simulate(NAME, seeds, jobs=jobs, set=changes)
    flocks = list(found.traces)
    speed = [value / 0.22 for value in metric(found, "mean_speed")]
    shared = [together(trace) for trace in flocks]
    apart = [parts(trace) for trace in flocks]
    margin = [parts(trace) - own for trace, own in zip(walkers.traces, apart, strict=True)]
    independent = "ours: n independent robots reach 1 / sqrt(n), here 0.38"
    shared_path = "path of the centroid / path of a robot, last half"
    return [
        at_least(NAME, "mean speed / limit", SPEED, speed, "ours"),
        at_least(NAME, shared_path, PATH, shared, independent),
        at_most(NAME, "parts, mean over time", APART, apart, _SPLITS),
        at_least(NAME, "parts fewer than of random walkers", MARGIN, margin, _SPLITS),
        no_contacts(NAME, found),
    ]


def parts(trace: Trace) -> float:
    """The mean number of clusters over the run, lone robots included."""
    return float(cluster_counts(trace, LINK).mean())


def together(trace: Trace) -> float:
    """The centroid's path as a share of a robot's mean path, over the last half of the run.

    1 if all move alike, 0 if they mill or stand.
    """
    half = len(trace.t) // 2
    place = trace.pose[half::10, :, :2]
    own = np.hypot(*np.moveaxis(np.diff(place, axis=0), -1, 0)).sum()
    centre = np.diff(place.mean(axis=1), axis=0)
    if own == 0.0:
        return 0.0
    return float(np.hypot(centre[:, 0], centre[:, 1]).sum() * place.shape[1] / own)

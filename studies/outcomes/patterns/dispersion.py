"""Dispersion: the robots reach their distance, keep it and stand; there is no contact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts
from studies.paper_exp2 import ranges
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.window import late
from swarmd.sim.trace import Trace

NAME = "dispersion"
FILM = {"stop": 40.0, "sets": {"arena.size": [6, 6]}}
DISTANCE, TOLERANCE, TOO_FAR = 1.0, 0.03, 1.3
"""In m: the distance to keep, three standard deviations of the lidar, and the upper bound."""
SETTING = {"groups.tb3.count": 5, "duration": 40}
SPEED, PATH = 0.03, 0.73
_PAPER = "Kaiser et al. 2022, experiment 2"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: a run for each seed."""
    found = simulate(NAME, seeds, jobs=jobs, set=SETTING)
    ranges = [late_ranges(trace) for trace in found.traces]
    nearest, loosest = [least for least, _ in ranges], [median for _, median in ranges]
    path, speed = metric(found, "path_length"), metric(found, "mean_speed_late_share")
    no_further = "ours: it spreads no further than its distance"
    return [
        at_least(NAME, "least late range [m]", DISTANCE - TOLERANCE, nearest, _PAPER),
        at_most(NAME, "median late range to the nearest [m]", TOO_FAR, loosest, no_further),
        at_most(NAME, "mean path [m]", PATH, path, "ours: no detours"),
        at_most(NAME, "late speed / limit", SPEED, speed, _PAPER),
        no_contacts(NAME, found),
    ]


def late_ranges(trace: Trace, seconds: float = 10.0) -> tuple[float, float]:
    """The least and the median true range in m to the nearest robot or wall, at the end."""
    found = ranges(late(trace, seconds))
    return float(found.min()), float(np.median(found))

"""Random walk: it moves, covers the room as random search does, and turns to both sides."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts, number
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.coverage import COVER, covered_area
from swarmd.sim.trace import Trace

NAME = "random_walk"
SHORT_FORM = {"duration": 40.0}
FILM = {"stop": 60.0}
FLOOR = 36.0
"""Area of the scenario's room in m2."""
ALONE = {"groups.tb3.parameters.recovery": False}
"""Without recovery; with it, robots that drive straight ahead would cover as much."""
DURATION = 120.0
SPEED, SHARE, GAIN, BIAS, DUTY = 0.5, 0.7, 1.5, 0.75, 0.1
_KOOPMAN = "random search: Koopman, Operations Research 4, 1956"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run of walkers, and one of robots that drive straight ahead."""
    changes = {**ALONE, "duration": duration}
    found = simulate(NAME, seeds, jobs=jobs, set=changes)
    straight = simulate(NAME, seeds, jobs=jobs, set={**changes, "groups.tb3.pattern": "drive"})
    walks = list(found.traces)
    speed = [value / 0.22 for value in metric(found, "mean_speed")]
    search = [of_random_search(trace) for trace in walks]
    covered = metric(found, "covered_area"), metric(straight, "covered_area")
    gain = [walk / drive for walk, drive in zip(*covered, strict=True)]
    duty = metric(found, "protection_duty")
    bias = [one_sidedness(walks)]
    return [
        at_least(NAME, "mean speed / limit", SPEED, speed, "ours"),
        at_least(NAME, "floor covered / by random search", SHARE, search, _KOOPMAN),
        at_least(NAME, "floor covered / by drive", GAIN, gain, "ours"),
        at_most(
            NAME, "turned more to one side, as a share", BIAS, bias, "both sides alike", len(walks)
        ),
        at_most(NAME, "protection duty", DUTY, duty, "ours"),
        no_contacts(NAME, found),
    ]


def of_random_search(trace: Trace) -> float:
    """The covered floor as a share of the floor that a random search with an equal path covers.

    Random search covers the share 1 - exp(-w L / A) of the floor A: w is the search width, twice
    0.5 m, and L the length of the paths of all robots. NaN without any path.
    """
    path = np.hypot(*np.moveaxis(np.diff(trace.pose[..., :2], axis=0), -1, 0)).sum()
    expected = FLOOR * (1.0 - math.exp(-2.0 * COVER * float(path) / FLOOR))
    return number(covered_area(trace)) / expected if expected else math.nan


def one_sidedness(traces: Sequence[Trace]) -> float:
    """The net turn of all robots as a share of all their turning."""
    turns = np.concatenate([np.diff(trace.pose[..., 2], axis=0).ravel() for trace in traces])
    return float(abs(turns.sum()) / np.abs(turns).sum())

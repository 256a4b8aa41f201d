"""Cue aggregation: most robots gather at the warmer of two spots; a robot alone does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, no_contacts, ratio_of
from swarmd.core.values import Array
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

NAME = "cue_aggregation"
IS_LONG = True
FILM = {"title": "the right is warmer", "stop": 240.0}
WARMER, WARM, RADIUS = (1.5, 0.0), (-1.5, 0.0), 1.0
"""The spots and how far around them robots count, in m: 0.21 of the floor."""
_MAJORITY = "Schmickl and Hamann 2011: of two optima the majority is at the better one"
_ALONE = "Schmickl et al. 2009: a robot alone meets none and finds nothing; chance is 0.21"


def outcomes(
    seeds: Sequence[int], jobs: int = 1, duration: float = 240.0, *, has_alone: bool = True
) -> list[Outcome]:
    """All outcomes: for each seed twelve Burgers, and `has_alone` one alone."""

    def found(count: int) -> Results:
        changes = {"duration": duration, "trace_rate": 2.0, "groups.tb3.count": count}
        return simulate(NAME, seeds, jobs=jobs, set=changes)

    twelve = found(12)
    shares, less = ([share(t.pose, spot) for t in twelve.traces] for spot in (WARMER, WARM))
    what, ratio = "share of robots at the warmer spot", ratio_of(shares, less)
    main = [
        at_least(NAME, f"{what}, mean", 0.42, mean_of(shares), _MAJORITY),
        at_least(NAME, "at the warmer spot / at the other, mean", 1.5, ratio, _MAJORITY),
        no_contacts(NAME, twelve),
    ]
    if not has_alone:
        return main
    one = mean_of(share(trace.pose, WARMER) for trace in found(1).traces)
    return [*main, at_most(NAME, f"one robot: {what}, mean", 0.31, one, _ALONE)]


def share(pose: Array, spot: tuple[float, float]) -> float:
    """The mean share of robots near a spot in the last half, of poses (T, n, 3)."""
    late = pose[len(pose) // 2 :, :, :2]
    return float((np.hypot(late[..., 0] - spot[0], late[..., 1] - spot[1]) < RADIUS).mean())

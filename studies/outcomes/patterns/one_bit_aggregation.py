"""One-bit aggregation: the robots gather in one cluster, and block each other without recovery."""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, metric, no_contacts
from swarmd.sim.experiments.simulate import simulate

NAME = "one_bit_aggregation"
SHORT_FORM = {"duration": 120.0}
IS_LONG = True
FILM = {"stop": 240.0}
DURATION = 240.0
BLOCKED = {"groups.tb3.parameters.recovery": False}
"""No robot gives way to another: the blocked one stands, and none pushes it as an e-puck would."""
BLIND = {"groups.tb3.parameters.sight": 0.15}
"""A robot is never seen, so that the bit is always 0."""
_GAUCI = "Gauci et al. 2014: 0.986 of 40 e-pucks, mean of 30 trials"
_DAYMUDE = "deadlocks: Daymude et al. 2021; without chance none ends"
_CHANCE = "ours: the bit must be what gathers them"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run, one without recovery and one of blind robots."""
    changes = {"duration": duration, "trace_rate": 2.0}
    found = simulate(NAME, seeds, jobs=jobs, set=changes, traces=False)
    blocked = simulate(NAME, seeds, jobs=jobs, set={**changes, **BLOCKED}, traces=False)
    blind = simulate(NAME, seeds, jobs=jobs, set={**changes, **BLIND}, traces=False)
    shares = [metric(some, "largest_cluster_share") for some in (found, blocked, blind)]
    means = [mean_of(share) for share in shares]
    what = "share of the robots in the largest cluster"
    return [
        at_least(NAME, f"{what}, mean", 0.93, means[0], _GAUCI),
        at_least(NAME, f"{what}, each run", 0.7, shares[0], _GAUCI),
        at_most(NAME, "the same, mean, recovery off", 0.93, means[1], _DAYMUDE),
        at_most(NAME, "the same, mean, blind", 0.5, means[2], _CHANCE),
        no_contacts(NAME, found),
    ]

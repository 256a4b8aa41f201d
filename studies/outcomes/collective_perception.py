"""Collective perception: robots agree on the colour that covers more, later where it is closer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

NAME = "collective_perception"
EASY, HARD = 0.66, 0.55
"""Shares of black tiles."""
DURATION = 200.0
RIGHT, RIGHT_HARD, QUICKER = 0.9, 0.6, 0.9
"""Least shares of runs that end in agreement on black; most median time of the majority rule as a
share of the voter's."""
_SOURCE = "Valentini et al. 2016"


def outcomes(
    seeds: Sequence[int], jobs: int = 1, duration: float = DURATION, *, is_short: bool = False
) -> list[Outcome]:
    """All outcomes, or with `is_short` those of the majority rule on the easier floor."""

    def runs(rule: str, share: float) -> Results:
        patch = {"rectangle": [0, 0, 4, 4], "tiles": 0.2, "share": share, "seed": 1}
        changes = {
            "duration": duration,
            "fields": [{"kind": "floor", "name": "ground", "patches": [patch]}],
            "parameters": {NAME: {"rule": rule}},
        }
        return simulate(NAME, seeds, jobs=jobs, set=changes)

    easy = runs("majority", EASY)
    found = [
        at_least(NAME, f"majority, {EASY:.0%} black: right", RIGHT, [right(easy)], _SOURCE),
        no_contacts(NAME, easy),
    ]
    if is_short:
        return found
    hard, voter = runs("majority", HARD), runs("voter", EASY)
    faster = median_time(easy) / median_time(voter)
    slower = median_time(hard) / median_time(easy)
    of_voter = "median time of the majority rule / of the voter"
    of_easy = f"majority: median time at {HARD:.0%} / at {EASY:.0%} black"
    return [
        *found,
        at_least(NAME, f"majority, {HARD:.0%} black: right", RIGHT_HARD, [right(hard)], _SOURCE),
        at_least(NAME, f"voter, {EASY:.0%} black: right", RIGHT, [right(voter)], _SOURCE),
        at_most(NAME, of_voter, QUICKER, [faster], _SOURCE),
        at_least(NAME, of_easy, 1.0, [slower], _SOURCE),
    ]


def right(results: Results) -> float:
    """The share of runs that end in agreement on black, opinion 0."""
    return float(np.mean([opinion == 0.0 for opinion in metric(results, "consensus_opinion")]))


def median_time(results: Results) -> float:
    """The median time in s until all agree; infinite for a run in which they do not."""
    times = metric(results, "consensus_time")
    return float(np.median([math.inf if math.isnan(time) else time for time in times]))

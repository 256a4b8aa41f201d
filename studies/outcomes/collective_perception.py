"""Collective perception: the robots agree on the colour that covers more of the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, metric, no_contacts
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

NAME = "collective_perception"
SHARE = 0.66
"""Share of black tiles."""
DURATION = 300.0
RIGHT = 0.9
"""The least share of runs that end in agreement on black."""


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes of the majority rule."""
    patch = {"rectangle": [0, 0, 4, 4], "tiles": 0.1, "share": SHARE, "seed": 1}
    fields = [{"kind": "floor", "name": "ground", "patches": [patch]}]
    found = simulate(NAME, seeds, jobs=jobs, set={"duration": duration, "fields": fields})
    what = f"majority, {SHARE:.0%} black: share of runs that agree on black"
    return [at_least(NAME, what, RIGHT, [right(found)], "ours"), no_contacts(NAME, found)]


def right(results: Results) -> float:
    """The share of runs that end in agreement on black, opinion 0."""
    return float(np.mean([opinion == 0.0 for opinion in metric(results, "consensus_opinion")]))

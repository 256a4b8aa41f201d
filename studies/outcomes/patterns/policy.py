"""The learned policy: it gathers robots of held-out seeds, which a random walk does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.learning import ROOM
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, metric, no_contacts
from swarmd.sim.experiments.simulate import simulate

NAME = "policy"
IS_LONG = True
FILM = {"title": "a learned network"}
DURATION = 40.0
_OURS = "ours: it was trained to lower this distance"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: for each seed a run of the policy, and one of random_walk."""
    changes = {**ROOM, "duration": duration, "groups.tb3.pattern": NAME}
    found = simulate("aggregation", seeds, jobs=jobs, set=changes, traces=False)
    walk = {**changes, "groups.tb3.pattern": "random_walk"}
    walked = simulate("aggregation", seeds, jobs=jobs, set=walk, traces=False)
    ends, starts, walks = (
        np.array(metric(some, f"mean_distance_to_centroid_{when}"))
        for some, when in ((found, "late"), (found, "start"), (walked, "late"))
    )
    what = "mean distance to the centroid, late / at the start, mean"
    return [
        at_most(NAME, what, 0.6, mean_of(ends / starts), _OURS),
        at_least(NAME, "the same of random_walk", 0.7, mean_of(walks / starts), "the control"),
        no_contacts(NAME, found),
    ]

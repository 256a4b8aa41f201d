"""Attraction: seven Burgers in a row gather in one cluster and rest; docs/paper.md has more."""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts
from swarmd.sim.experiments.simulate import simulate

NAME = "attraction"
SHORT_FORM = {"duration": 40.0}
IS_LONG = True
FILM = {"stop": 90.0}
DURATION = 60.0
MDC, SHARE, SPEED, NEAR = 0.86, 0.9, 0.2, 0.5
"""Upper bound of the late distance to the centroid in m; lower bound of the share of the late time
in one cluster; upper bound of the late speed as a share of the limit; lower bound of the distance
between neighbours in m, the paper's protection threshold."""
_PAPER = "Kaiser et al. 2022, experiment 1; bounds as in docs/paper.md"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """All outcomes: a run of experiment 1 for each seed, half as long as in docs/paper.md."""
    setting = {"duration": duration}
    found = simulate("paper_exp1_burger", seeds, jobs=jobs, set=setting, traces=False)
    return [
        at_most(NAME, "late distance to the centroid [m]", MDC,
                metric(found, "mean_distance_to_centroid_late"), _PAPER),
        at_least(NAME, "one cluster at the end", 1.0, metric(found, "one_cluster_at_end"), _PAPER),
        at_least(NAME, "share of late time in one cluster", SHARE,
                 metric(found, "time_in_one_cluster_late"), _PAPER),
        at_most(NAME, "late speed / limit", SPEED, metric(found, "mean_speed_late_share"), _PAPER),
        at_least(NAME, "late distance to the nearest [m]", NEAR,
                 metric(found, "nearest_neighbor_median_late"), _PAPER),
        no_contacts(NAME, found),
    ]  # fmt: skip

"""Attraction: seven Burgers in a row gather in one cluster and rest; docs/paper.md has more."""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.outcome import Outcome, at_least, at_most
from swarmd.sim.experiments.simulate import simulate

NAME = "attraction"
SETTING = {"duration": 60}
MDC, SHARE, SPEED, NEAR = 0.86, 0.9, 0.2, 0.5
"""Most m to the centroid, late; least share of the late time in one cluster; most late speed as a
share of the limit; least m between neighbours, the paper's protection threshold."""
_PAPER = "Kaiser et al. 2022, experiment 1; bounds as in docs/paper.md"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All of them, of one run of experiment 1 a seed, half as long as in docs/paper.md."""
    results = simulate("paper_exp1_burger", seeds, jobs=jobs, set=SETTING, traces=False)

    def of(metric: str) -> tuple[float, ...]:
        return tuple(float(value) for value in results.metric(metric))

    one, share = of("one_cluster_at_end"), of("time_in_one_cluster_late")
    away, speed = of("mean_distance_to_centroid_late"), of("mean_speed_late_share")
    near = of("nearest_neighbor_median_late")
    touches = tuple(a + b for a, b in zip(of("robot_contacts"), of("arena_contacts"), strict=True))
    return [
        _outcome("one cluster at the end", "1", one, at_least(1.0, one)),
        _outcome("share of late time in one cluster", f">= {SHARE}", share, at_least(SHARE, share)),
        _outcome("late distance to the centroid [m]", f"<= {MDC}", away, at_most(MDC, away)),
        _outcome("late speed / limit", f"<= {SPEED}", speed, at_most(SPEED, speed)),
        _outcome("late distance to the nearest [m]", f">= {NEAR}", near, at_least(NEAR, near)),
        _outcome("touches", "0", touches, at_most(0.0, touches)),
    ]


def _outcome(what: str, wanted: str, values: tuple[float, ...], is_reached: bool) -> Outcome:
    return Outcome(NAME, what, wanted, values, is_reached, _PAPER)


# What packs a group shows in a swarm only after minutes, and then by some centimetres.
_UNITS = "tests/patterns/test_attraction.py"

"""Patrol: idleness falls with the number of robots, near that of robots on one closed way."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of
from studies.outcomes.rows import RowsOf
from studies.point_swarm import CLEAR, PointSwarm
from swarmd.core.values import Value
from swarmd.patterns.patrol.metrics import EVERY, PLACES, Idleness, ideal, idleness
from tests.support.voting_sim import Air

NAME = "patrol"
SHORT_FORM = {"numbers": (1, 4), "has_bodies": False}
FILM = {"title": "nine places", "stop": 150.0}
TEXT = ", ".join(f"{x} {y}" for x, y in PLACES)
NUMBERS = (1, 2, 4, 8)
MUTE = Air(loss=1.0)
SECONDS, SETTLED = 900.0, 200.0
_ARRIVAL = 0.05  # m, the parameter `arrival` of points
_CYCLE = "Machado et al. 2003; ideal: robots evenly on the shortest closed way, half its time / N"
_FALLS = "Machado et al. 2003: idleness falls with the number of agents"
_WORST = "no place is forgotten; the bound: ours"
_MUTE = "ours: what the messages are good for"


def outcomes(
    seeds: Sequence[int],
    jobs: int = 1,
    *,
    numbers: Sequence[int] = NUMBERS,
    has_bodies: bool = True,
) -> list[Outcome]:
    """Measure idleness, the time since a robot last visited a place, by the number of robots.

    For each seed there is a run of point robots (no bodies) with each of `numbers`. `has_bodies`:
    also a run of four points whose messages are all lost, and of three Burgers. The ideal is the
    mean idleness if N robots drive evenly spaced on the shortest closed way. Each outcome has the
    measured values, their bound and the source of the bound.
    """
    by_number = {
        number: each(run, [(seed, number, CLEAR) for seed in seeds], jobs) for number in numbers
    }
    means = [float(np.mean([idle.mean for idle in runs])) for runs in by_number.values()]
    falls = [fewer / more for fewer, more in pairwise(means)]  # by the number of robots
    worst_ratios = [
        idle.worst / ideal(number) for number, runs in by_number.items() for idle in runs
    ]
    point_outcomes = [
        *(
            at_most(
                NAME, f"mean idleness / ideal, N = {number}", 1.4, _of_ideal(runs, number), _CYCLE
            )
            for number, runs in by_number.items()
        ),
        at_least(
            NAME, "mean idleness of fewer / of the next number", 1.6, falls, _FALLS, len(seeds)
        ),
        at_most(NAME, "longest idleness / ideal mean, all N", 6.0, worst_ratios, _WORST),
    ]
    if not has_bodies:
        return point_outcomes
    mute_runs = each(run, [(seed, 4, MUTE) for seed in seeds], jobs)
    mute_mean = mean_of(_of_ideal(mute_runs, 4))
    return [
        *point_outcomes,
        at_least(NAME, "no message arrives: mean idleness / ideal, N = 4", 1.4, mute_mean, _MUTE),
        *RowsOf(NAME).outcomes(seeds, jobs),
    ]


def _of_ideal(runs: Sequence[Idleness], number: int) -> list[float]:
    return [idle.mean / ideal(number) for idle in runs]


def run(given: tuple[int, int, Air]) -> Idleness:
    """So many points that begin at random places of the square."""
    seed, number, air = given
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(0.0, 4.0, (number, 2)), rng.uniform(-3.1, 3.1, number)])
    params: dict[str, Value] = {"places": TEXT, "reach": 2.1, "arrival": _ARRIVAL}
    swarm = PointSwarm(NAME, poses, seed=seed, params=params, air=air)
    return idleness(swarm.run(SECONDS, every=EVERY).pose[:, :, :2], _ARRIVAL, SETTLED)

"""Patrol: idleness falls with the number of robots, near that of robots on one closed way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, no_contacts
from studies.point_swarm import CLEAR, PointSwarm
from swarmd.core.values import Array, Value
from swarmd.sim.experiments.simulate import simulate
from tests.support.voting_sim import Air

NAME = "patrol"
SHORT_FORM = {"numbers": (1, 4), "has_bodies": False}
FILM = {"title": "nine places", "stop": 150.0}
PLACES = ((0, 0), (2, 0), (4, 0), (4, 2), (2, 2), (0, 2), (0, 4), (2, 4), (4, 4))
TEXT = ", ".join(f"{x} {y}" for x, y in PLACES)
WAY = 16.0 + 2.0 * math.sqrt(2.0)
"""The shortest closed way in m past all places: a grid of three by three."""
NUMBERS = (1, 2, 4, 8)
SPEED, EVERY = 0.22, 0.2
MUTE = Air(loss=1.0)
SECONDS, SETTLED, BODY_SETTLED = 900.0, 200.0, 100.0
_ARRIVAL, _BODY_ARRIVAL = 0.05, 0.2  # m, the parameter `arrival` of points and of Burgers
_SCENARIO_SHIFT = 2.0  # m along both axes, from the places of the scenario to PLACES
_CYCLE = "Machado et al. 2003; ideal: robots evenly on the shortest closed way, half its time / N"
_FALLS = "Machado et al. 2003: idleness falls with the number of agents"
_WORST = "no place is forgotten; the bound: ours"
_MUTE = "ours: what the messages are good for"


@dataclass(frozen=True, slots=True)
class Idleness:
    """The mean over places and time in s, and the longest of any place."""

    mean: float
    worst: float


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
    results = simulate(NAME, seeds, jobs=jobs, set={"trace_rate": 1.0 / EVERY})
    burgers = [
        idleness(trace.pose[:, :, :2] + _SCENARIO_SHIFT, _BODY_ARRIVAL, BODY_SETTLED)
        for trace in results.traces
    ]
    burger_means = _of_ideal(burgers, 3)
    return [
        *point_outcomes,
        at_least(NAME, "no message arrives: mean idleness / ideal, N = 4", 1.4, mute_mean, _MUTE),
        at_most(NAME, "Burgers: mean idleness / ideal, N = 3", 1.4, burger_means, _CYCLE),
        no_contacts(NAME, results),
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


def idleness(places: Array, arrival: float, settled: float) -> Idleness:
    """Of robots at places (T, n, 2) every `EVERY` s, from `settled` s on."""
    off = places[:, :, None] - np.array(PLACES, float)
    near = arrival + 0.5 * SPEED * EVERY
    is_visited = (np.hypot(off[..., 0], off[..., 1]) <= near).any(axis=1)
    times = np.arange(len(places)) * EVERY
    last = np.maximum.accumulate(np.where(is_visited, times[:, None], 0.0), axis=0)
    late = (times[:, None] - last)[times >= settled]
    return Idleness(float(late.mean()), float(late.max()))


def ideal(number: int) -> float:
    """The mean idleness in s of robots evenly on the shortest closed way, 2 m for each place."""
    return 0.5 * WAY / SPEED / number

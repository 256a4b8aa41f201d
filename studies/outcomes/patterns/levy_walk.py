"""Levy walk: flights follow the power law; first-passage times follow the law of random search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Joined, Outcome, at_least, at_most, ratio_of, within
from studies.point_swarm import PointSwarm, Track
from swarmd.core.values import Array, Scan
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan

NAME = "levy_walk"
SHORT_FORM = {"has_slow": False}
IS_LONG = True
SIDE, SECONDS, ROBOTS, SIGHT, TARGETS = 10.0, 600.0, 10, 0.5, 200
"""Points in a square whose opposite sides are joined; a target is found within the sight in m."""
_SEARCH = "random search: P(T > t) = exp(-2 rho s v t), Varadharajan 2024"
_POWER = "Viswanathan et al. 1999: (l / shortest)^(1 - mu)"


@dataclass(frozen=True, slots=True)
class Search:
    """How fast walkers find random targets."""

    mean: float  # s, mean time to find a target, of those found after the start
    law: float  # s, the same by the law of random search
    missed: float  # share of the targets that were never found
    displaced: float  # m, mean distance between the places of a robot now and a minute ago


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    exponent: float
    robots: int = ROBOTS
    sight: float = SIGHT


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_slow: bool = True) -> list[Outcome]:
    """Compare the times in which walkers find random targets with the law of random search.

    For each seed nearly ballistic walkers (exponent mu 1.1) search, and walkers that see twice as
    far. `has_slow`: also twice as many walkers, and walkers with mu 2 and 4, whose paths bend more.
    Each outcome has the measured values, their bound and the source of the bound.
    """

    def searches(exponent: float, robots: int = ROBOTS, sight: float = SIGHT) -> list[Search]:
        return each(search, [_Setting(seed, exponent, robots, sight) for seed in seeds], jobs)

    def as_law(label: str, runs: Sequence[Search]) -> Outcome:
        return within(NAME, f"{label}: mean time / law", 0.85, 1.15, _of_law(runs), _SEARCH)

    ballistic, far_sighted = searches(1.1), searches(1.1, sight=2.0 * SIGHT)
    by_law = [as_law("mu 1.1", ballistic), as_law("mu 1.1, a sight of 1 m", far_sighted)]
    # The mean time of a random search is inverse to the sight s and to the number N of walkers.
    sight_ratio = ratio_of(_times(ballistic), _times(far_sighted))
    missed = [run.missed for run in ballistic]
    ballistic_outcomes = [
        at_least(NAME, "mu 1.1: mean time / that of twice the sight", 1.7, sight_ratio, "1/s"),
        at_most(NAME, "mu 1.1: share of searches without success", 0.01, missed, _SEARCH),
    ]
    if not has_slow:
        return [*by_law, *ballistic_outcomes]
    twice_as_many = searches(1.1, robots=2 * ROBOTS)
    levy, slow = searches(2.0), searches(4.0)
    number_ratio = ratio_of(_times(ballistic), _times(twice_as_many))
    displacement_ratio = ratio_of(_displacements(ballistic), _displacements(slow))
    return [
        *by_law,
        as_law("mu 1.1, 20 robots", twice_as_many),
        *ballistic_outcomes,
        at_least(NAME, "mu 1.1: mean time / that of 20 robots", 1.7, number_ratio, "1/N"),
        at_least(NAME, "mu 2: mean time / law", 1.0, _of_law(levy), "places seen twice"),
        at_least(NAME, "mu 4: mean time / law", 1.3, _of_law(slow), "the same"),
        at_least(NAME, "way in a minute, mu 1.1 / mu 4", 1.5, displacement_ratio, _POWER),
    ]


def _times(runs: Sequence[Search]) -> list[float]:
    return [run.mean for run in runs]


def _displacements(runs: Sequence[Search]) -> list[float]:
    return [run.displaced for run in runs]


def _of_law(runs: Sequence[Search]) -> Joined:
    return ratio_of(_times(runs), [run.law for run in runs])


def search(setting: _Setting) -> Search:
    """One run, and the times at which random targets are found."""
    rng = np.random.default_rng(setting.seed)
    x, y = rng.uniform(0.0, SIDE, (2, setting.robots))
    poses = np.column_stack([x, y, rng.uniform(-np.pi, np.pi, setting.robots)])
    nothing = empty_scan(load_platform("burger"), 0, 0.0)

    def see(row: int, now: Array) -> Scan:
        return nothing

    params = {"exponent": setting.exponent}
    swarm = PointSwarm(NAME, poses, seed=setting.seed, params=params, torus=SIDE, see=see)
    track = swarm.run(SECONDS, every=0.5)
    return _judge(track, rng.uniform(0.0, SIDE, (TARGETS, 2)), setting)


def _judge(track: Track, targets: Array, setting: _Setting) -> Search:
    """The times until the robots find the targets, from a track with a sample every 0.5 s.

    `targets`: (m, 2) in m. Every 30 s of the first half of the run a search for each target begins.
    """
    place = track.pose[..., :2]
    begins = np.arange(0, len(place) // 2, 60)
    search_s = np.full((len(targets), len(begins)), np.inf)
    for index, target in enumerate(targets):
        offset = place - target
        offset -= SIDE * np.round(offset / SIDE)  # the shortest way on the torus
        is_near = np.hypot(offset[..., 0], offset[..., 1]) <= setting.sight
        seen = np.flatnonzero(is_near.any(axis=1))
        first = np.searchsorted(seen, begins)
        is_seen = first < len(seen)
        search_s[index, is_seen] = 0.5 * (seen[first[is_seen]] - begins[is_seen])
    search_s = search_s[search_s > 0.0]  # without the targets in sight at the start
    is_found = np.isfinite(search_s)
    step = np.diff(place, axis=0)
    speed = np.hypot(step[..., 0], step[..., 1]).sum() / SECONDS / setting.robots
    law = SIDE**2 / (2.0 * setting.robots * setting.sight * speed)
    minute = place[120:] - place[:-120]  # 120 samples of 0.5 s
    displaced = float(np.hypot(minute[..., 0], minute[..., 1]).mean())
    return Search(float(search_s[is_found].mean()), law, float((~is_found).mean()), displaced)

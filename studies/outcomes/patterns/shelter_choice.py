"""Shelter choice: the robots rest under one of two equal shelters, and under both small ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.keeper import each
from studies.outcomes.outcome import Joined, Outcome, at_least, at_most, mean_of, share_of
from studies.point_swarm import PointSwarm
from swarmd.core.values import Array, Scan, Value
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan

NAME = "shelter_choice"
SHORT_FORM = {"robots": 8, "seconds": 240.0, "has_controls": False}
FILM = {"title": "two equal shelters", "colour": "report:state"}
ROBOTS, SIDE, SECONDS, EVERY = 12, 6.0, 400.0, 10.0
"""Points in a square in m whose opposite sides are joined."""
SHELTERS, RADIUS = np.array([[1.5, 3.0], [4.5, 3.0]]), 0.7
ALONE = {"social": 0.0}
_AME = "Ame et al. 2006: one shelter is chosen if it holds all"
_SMALL = "Ame et al. 2006: both are used if each holds half"
_EQUAL = "equal shelters: none is preferred; four standard deviations of 20 fair coins"
_CONTROL = "ours: without the others none is chosen"


@dataclass(frozen=True, slots=True)
class Choice:
    """The mean of the last third: the share of robots at rest, and of these under the first."""

    resting: float
    first: float

    @property
    def larger(self) -> float:
        """The share under the shelter with more."""
        return max(self.first, 1.0 - self.first)


def outcomes(
    seeds: Sequence[int],
    jobs: int = 1,
    *,
    robots: int = ROBOTS,
    seconds: float = SECONDS,
    has_controls: bool = True,
) -> list[Outcome]:
    """Measure how the robots divide between two equal shelters.

    For each seed there is a run with shelters that hold all robots. `has_controls`: also a run with
    shelters that hold half of the robots each, and a run in which robots ignore each other. Each
    outcome has the measured values, their bound and the source of the bound.
    """

    def choices_with(**params: Value) -> list[Choice]:
        all_params = {"capacity": robots, **params}
        return each(choose, [(seed, robots, seconds, all_params) for seed in seeds], jobs)

    choices = choices_with()
    label = "share of those at rest that are under one shelter"
    larger = [choice.larger for choice in choices]
    resting = [choice.resting for choice in choices]
    main_outcomes = [
        at_least(NAME, "share of the robots at rest", 0.6, resting, "ours"),
        at_least(NAME, f"{label}, mean", 0.8, mean_of(larger), _AME),
    ]
    if not has_controls:
        return main_outcomes
    small, alone = choices_with(capacity=robots // 2), choices_with(**ALONE)
    # The share of runs that the first shelter wins should be a half.
    bias = abs(float(np.mean([choice.first > 0.5 for choice in choices])) - 0.5)
    small_larger, alone_larger = (
        mean_of(choice.larger for choice in runs) for runs in (small, alone)
    )
    alone_resting = [choice.resting for choice in alone]
    return [
        *main_outcomes,
        at_least(NAME, "runs with 0.8 of them under one, share", 0.5, _won(choices), _AME),
        at_most(
            NAME, "share of runs won by the first, off from half", 0.45, [bias], _EQUAL, len(seeds)
        ),
        at_most(NAME, f"each holds half: {label}, mean", 0.7, small_larger, _SMALL),
        at_most(NAME, f"social 0: {label}, mean", 0.65, alone_larger, _CONTROL),
        at_most(NAME, "social 0: share of the robots at rest", 0.5, alone_resting, _CONTROL),
    ]


def _won(choices: Sequence[Choice]) -> Joined:
    return share_of(choice.larger >= 0.8 for choice in choices)


def choose(given: tuple[int, int, float, Mapping[str, Value]]) -> Choice:
    """One run from random places."""
    seed, robots, seconds, params = given
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, SIDE, (robots, 2))
    poses = np.column_stack([places, rng.uniform(-np.pi, np.pi, robots)])
    nothing = empty_scan(load_platform("burger"), 0, 0.0)

    def sense(now: float, row: int, poses: Array) -> Mapping[str, float]:
        return {"ground": 1.0 - float(_under(poses[row, :2]).any())}

    def see(row: int, poses: Array) -> Scan:
        return nothing

    swarm = PointSwarm(
        NAME, poses, seed=seed, params=params, torus=SIDE, reach=2.0, sense=sense, see=see
    )
    track = swarm.run(seconds, every=EVERY)
    late = len(track.t) * 2 // 3
    rests = np.array([[one.get("state") == "rest" for one in now] for now in track.reports[late:]])
    under = _under(track.pose[late:, :, :2]) & rests[..., None]
    first, second = under.mean(axis=(0, 1))
    return Choice(float(rests.mean()), float(first / max(first + second, 1e-9)))


def _under(places: Array) -> NDArray[np.bool_]:
    """(..., 2) whether places (..., 2) are under each of the shelters."""
    off = np.mod(places, SIDE)[..., None, :] - SHELTERS
    return np.asarray(np.hypot(off[..., 0], off[..., 1]) < RADIUS)

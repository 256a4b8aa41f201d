"""Shelter choice: the robots rest under one of two equal shelters, and under both small ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.outcomes.outcome import Joined, Outcome, at_least, at_most, mean_of, share_of
from studies.point_swarm import PointSwarm, each
from swarmd.core.values import Array, Scan, Value
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan

NAME = "shelter_choice"
SHORT_FORM = {"robots": 8, "seconds": 240.0, "has_controls": False}
FILM = {"title": "two equal shelters", "colour": "report:state", "camera": "top"}
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
    """All outcomes: for each seed a run, and `has_controls` one alone and one of small shelters."""

    def chosen(**params: Value) -> list[Choice]:
        given = {"capacity": robots, **params}
        return each(choose, [(seed, robots, seconds, given) for seed in seeds], jobs)

    found = chosen()
    what = "share of those at rest that are under one shelter"
    larger = [one.larger for one in found]
    resting = [one.resting for one in found]
    main = [
        at_least(NAME, f"{what}, mean", 0.8, mean_of(larger), _AME),
        at_least(NAME, "share of the robots at rest", 0.6, resting, "ours"),
    ]
    if not has_controls:
        return main
    small, alone = chosen(capacity=robots // 2), chosen(**ALONE)
    wins = float(np.mean([one.first > 0.5 for one in found]))
    halves, apart = (mean_of(one.larger for one in some) for some in (small, alone))
    return [
        *main,
        at_least(NAME, "runs with 0.8 of them under one, share", 0.5, _won(found), _AME),
        at_most(
            NAME, "share of runs won by the first, off from half", 0.45, [abs(wins - 0.5)], _EQUAL
        ),
        at_most(NAME, f"each holds half: {what}, mean", 0.7, halves, _SMALL),
        at_most(NAME, f"social 0: {what}, mean", 0.65, apart, _CONTROL),
        at_most(
            NAME, "social 0: share of the robots at rest", 0.5, [o.resting for o in alone], _CONTROL
        ),
    ]


def _won(found: Sequence[Choice]) -> Joined:
    return share_of(one.larger >= 0.8 for one in found)


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

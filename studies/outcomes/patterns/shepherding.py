"""Shepherding: a herd arrives at the goal together, and herds of single sheep do not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Joined, Outcome, at_least, at_most, mean_of, ratio_of, share_of
from studies.point_swarm import PointSwarm
from swarmd.core.values import Scalar, Value

NAME = "shepherding"
SHORT_FORM = {"sizes": (4, 8), "has_loose": False}
IS_LONG = True
FILM = {"title": "to the goal on the left", "stop": 240.0, "colour": "report:role"}
SIZES = (4, 8, 12)
SECONDS, EVERY = 600.0, 2.0
NEAR = 2.5
"""m from the goal within which every sheep is at a success; the herd begins 6 m away."""
LOOSE = {"nearest": 1}
"""Each sheep goes to one other alone."""
_ALL = "Strombom et al. 2014: herds arrive where sheep go to most others (n > 0.53 N)"
_LOOSE = "Strombom et al. 2014: herds of few neighbours fall apart"
_TIME = "Strombom et al. 2014: larger herds take longer"


@dataclass(frozen=True, slots=True)
class Drive:
    """Whether all sheep arrived, and after how many s."""

    is_success: bool
    at: float


def outcomes(
    seeds: Sequence[int], jobs: int = 1, *, sizes: Sequence[int] = SIZES, has_loose: bool = True
) -> list[Outcome]:
    """All outcomes: for each seed a herd of each size, and `has_loose` eight loose sheep."""
    found = [each(drive, [(seed, size, {}) for seed in seeds], jobs) for size in sizes]
    wins = [(size, _won(some)) for size, some in zip(sizes, found, strict=True)]
    first, last = ([one.at for one in some] for some in (found[0], found[-1]))
    tight = [
        *(
            at_least(NAME, f"{size} sheep: share of runs in which all arrive", 0.9, won, _ALL)
            for size, won in wins
        ),
        at_most(NAME, f"{sizes[0]} sheep: time, mean [s]", 300.0, mean_of(first), "ours"),
    ]
    if not has_loose:
        return tight
    loose = each(drive, [(seed, 8, LOOSE) for seed in seeds], jobs)
    what = f"mean time of {sizes[-1]} sheep / of {sizes[0]}"
    return [
        *tight,
        at_least(NAME, what, 1.2, ratio_of(last, first), _TIME),
        at_most(NAME, "8 sheep, nearest 1: the same share", 0.5, _won(loose), _LOOSE),
    ]


def _won(found: Sequence[Drive]) -> Joined:
    return share_of(one.is_success for one in found)


def drive(given: tuple[int, int, Mapping[str, Value]]) -> Drive:
    """One herd in a square of 3 m; the goal is the first robot, the shepherd the second."""
    seed, size, params = given
    rng = np.random.default_rng(seed)
    places = np.vstack([[[0.0, 0.0], [0.5, 0.5]], rng.uniform(3.0, 6.0, (size, 2))])
    poses = np.column_stack([places, rng.uniform(-math.pi, math.pi, size + 2)])
    own: Mapping[int, Mapping[str, Value]] = {0: {"role": "goal"}, 1: {"role": "shepherd"}}
    swarm = PointSwarm(NAME, poses, seed=seed, params=params, own=own)
    track = swarm.run(SECONDS, every=EVERY, until=_has_arrived)
    herd = track.pose[-1, 2:, :2]
    is_near = bool((np.hypot(herd[:, 0], herd[:, 1]) <= NEAR).all())
    return Drive(_has_arrived(track.reports[-1]) and is_near, float(track.t[-1]))


def _has_arrived(reports: Sequence[Mapping[str, Scalar]]) -> bool:
    return reports[1].get("state") == "arrived"

"""Cross-inhibition: one opinion prevails despite stubborn robots, where direct switching wavers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of
from studies.point_swarm import PointSwarm, at_places
from swarmd.core.values import Value
from tests.support.voting_sim import Air

NAME = "cross_inhibition"
SHORT_FORM = {"has_bounds": False}
IS_LONG = True
FILM = {"title": "quality 0.6 and 0.9", "colour": "report:opinion"}
ROBOTS, STUBBORN, SECONDS, SETTLED = 40, 4, 150.0, 50.0
"""So many stubborn robots hold either opinion."""
HEARERS = 8
"""A message reaches so many random robots, as of robots that walk among each other."""
MAJORITY = 0.7
SHORT: Mapping[str, Value] = {"window": 0.5, "share_period": 0.25, "expiry": 1.0}
"""Which opinion prevails does not depend on how long a window is."""
_AIR = Air(delay=0.02, jitter=0.01)
_REINA = "Reina et al. 2023: a majority despite stubborn robots"
_DIRECT = "the same: direct switching stays undecided"
_THIRD = "mean field: a third of those that are not stubborn is as many as are stubborn"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    rule: str
    stubborn: int = STUBBORN


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_bounds: bool = True) -> list[Outcome]:
    """All outcomes: either rule with few stubborn robots; `has_bounds`: also none and many."""

    def shares(rule: str, stubborn: int = STUBBORN) -> list[float]:
        return each(decided, [_Setting(seed, rule, stubborn) for seed in seeds], jobs)

    what = "share of the time with a majority of 0.7"
    crossed, direct = mean_of(shares("cross_inhibition")), mean_of(shares("direct"))
    found = [
        at_least(NAME, f"{what}, mean", 0.7, crossed, _REINA),
        at_most(NAME, "the same, direct", 0.5, direct, _DIRECT),
    ]
    if not has_bounds:
        return found
    free, many = shares("cross_inhibition", 0), mean_of(shares("cross_inhibition", 10))
    return [
        *found,
        at_least(NAME, "the same, no stubborn robot, each run", 0.9, free, "ours"),
        at_most(NAME, "the same, ten stubborn ones each", 0.2, many, _THIRD),
    ]


def decided(setting: _Setting) -> float:
    """The share of the time after `SETTLED` in which 0.7 of all robots hold one opinion."""
    own: dict[int, dict[str, Value]] = {row: {"initial": 1 + row % 2} for row in range(ROBOTS)}
    for row in range(2 * setting.stubborn):
        own[row]["is_stubborn"] = True
    swarm = PointSwarm(
        NAME,
        at_places(np.zeros((ROBOTS, 2))),
        seed=setting.seed,
        params={**SHORT, "rule": setting.rule},
        own=own,
        hearers=HEARERS,
        air=_AIR,
    )
    track = swarm.run(SECONDS, every=0.5)
    opinions = track.reported("opinion")[track.t >= SETTLED]
    most = np.maximum((opinions == 1).mean(axis=1), (opinions == 2).mean(axis=1))
    return float((most >= MAJORITY).mean())

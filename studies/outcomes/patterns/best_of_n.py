"""Best of n: the better option wins; the majority rule is faster than the weighted voter model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Joined, Outcome, at_least, ratio_of, share_of
from studies.point_swarm import PointSwarm, at_places
from swarmd.core.values import Scalar
from tests.support.voting_sim import Air

NAME = "best_of_n"
SHORT_FORM = {"has_hard": False}
IS_LONG = True
FILM = {"title": "quality 0.6 and 0.9", "colour": "report:opinion"}
ROBOTS, SECONDS, AGREED = 50, 300.0, 0.9
HEARERS = 8
"""A message reaches so many random robots, as of robots that walk among each other."""
_AIR = Air(delay=0.02, jitter=0.01)
_VALENTINI = "Valentini et al. 2016, 100 Kilobots: the better option wins"
_FASTER = "Valentini et al. 2016: 1.89 times (rho_b 0.5)"
_LIMITS = "Valentini et al. 2016: 2 times (rho_b 0.5) to 20 times (0.99)"
_GROUPS = "Valentini et al. 2016: consensus after 55-69 min (25), 66-80 min (5)"
_OURS = "speed against accuracy; the bounds: ours"
SEEDS = 40
"""The interval of a ratio of times is wide with twenty."""
_EASY, _HARD = 0.5, 0.9
"""The quality of the worse option; the better option has the quality 1."""
_SMALL_GROUP, _LARGE_GROUP = 5, 25
"""Robots whose opinions a robot counts."""


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    rule: str
    worse: float
    group: int = _SMALL_GROUP


@dataclass(frozen=True, slots=True)
class Choice:
    """Whether the better option won, and the time in s until nine tenths held one option."""

    is_best: bool
    at: float


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_hard: bool = True) -> list[Outcome]:
    """Compare with the papers how often, and how fast, the better of two options wins.

    A swarm of point robots (no bodies) makes one run for each seed, rule and pair of qualities. The
    choice between the qualities 1 and 0.5 is easy. `has_hard`: the choice between 1 and 0.9 is
    measured too. Each outcome has the measured values, their bound and the source of the bound.
    """

    def runs_of(rule: str, worse_quality: float, group: int = _SMALL_GROUP) -> list[Choice]:
        settings = [_Setting(seed, rule, worse_quality, group) for seed in seeds]
        return each(choose, settings, jobs)

    majority, voter = runs_of("majority", _EASY), runs_of("voter", _EASY)
    easy, hard = "qualities 1 and 0.5", "qualities 1 and 0.9"
    easy_outcomes = [
        at_least(
            NAME, f"{easy}: share won by the better, majority", 0.9, won(majority), _VALENTINI
        ),
        at_least(NAME, f"{easy}: share won by the better, voter", 0.9, won(voter), _VALENTINI),
    ]
    if not has_hard:
        return easy_outcomes
    hard_majority, hard_voter = runs_of("majority", _HARD), runs_of("voter", _HARD)
    large_group = runs_of("majority", _HARD, _LARGE_GROUP)
    easy_ratio = ratio_of(times(voter), times(majority))
    hard_ratio = ratio_of(times(hard_voter), times(hard_majority))
    group_ratio = ratio_of(times(hard_majority), times(large_group))
    ratio_label = "time of the voter / of the majority"
    return [
        *easy_outcomes,
        at_least(NAME, f"{easy}: {ratio_label}", 1.0, easy_ratio, _FASTER),
        at_least(NAME, f"{hard}: share won, majority", 0.4, won(hard_majority), _OURS),
        at_least(NAME, f"{hard}: share won, majority, groups of 25", 0.3, won(large_group), _OURS),
        at_least(NAME, f"{hard}: share won, voter", 0.5, won(hard_voter), _OURS),
        at_least(NAME, f"{hard}: {ratio_label}", 1.5, hard_ratio, _LIMITS),
        at_least(NAME, f"{hard}: time in groups of 5 / of 25", 1.0, group_ratio, _GROUPS),
    ]


def won(choices: Sequence[Choice]) -> Joined:
    """The share of the runs that the better option won."""
    return share_of(choice.is_best for choice in choices)


def times(choices: Sequence[Choice]) -> list[float]:
    """The time in s until nine tenths of the robots agree, at most `SECONDS`, of each run."""
    return [min(choice.at, SECONDS) for choice in choices]


def choose(setting: _Setting) -> Choice:
    """One run from an even split, until nine tenths agree; option 0 is the better one."""
    readings = {"quality_0": 1.0, "quality_1": setting.worse}
    swarm = PointSwarm(
        NAME,
        at_places(np.zeros((ROBOTS, 2))),
        seed=setting.seed,
        params={"rule": setting.rule, "group": setting.group},
        own={row: {"initial": row % 2} for row in range(ROBOTS)},
        hearers=HEARERS,
        air=_AIR,
        sense=lambda now, row, poses: readings,
    )
    track = swarm.run(SECONDS, until=lambda reports: max(_shares(reports)) >= AGREED)
    best, other = _shares(track.reports[-1])
    at = float(track.t[-1]) if max(best, other) >= AGREED else math.inf
    return Choice(best >= AGREED, at)


def _shares(reports: Sequence[Mapping[str, Scalar]]) -> tuple[float, float]:
    opinions = [report.get("opinion") for report in reports]
    return opinions.count(0) / ROBOTS, opinions.count(1) / ROBOTS

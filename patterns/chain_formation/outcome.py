"""Chain formation: a chain joins a nest and a goal that no robot senses from there, and holds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, difference_of, share_of
from studies.point_swarm import PointSwarm, Track, each
from swarmd.core.values import Array, Scalar, Scan, Value
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_of

NAME = "chain_formation"
SHORT_FORM = {"has_more": False}
FILM = {
    "title": "from the nest in the middle to the goal on the right",
    "stop": 150.0,
    "camera": "top",
}
ROBOTS, FAR, REACH = 10, 3.0, 2.0
"""Robots, m from the nest to the goal, and m of the radio."""
SECONDS, HELD, EVERY = 300.0, 30, 1.0
"""s of a run, samples after the chain is complete, and s between two samples."""
DISTANCE = 0.8
"""m between two members: the default on a Burger."""
ALIGNING, STATIC = {"sweep": 0.0}, {"sweep": 0.0, "leave": 0.0}
_PATH = "Nouyan et al. 2008, 2009: chains join nest and prey; the bound: ours"
_MOTION = "Nouyan et al. 2008: chains that move find the prey; the bound: ours"


@dataclass(frozen=True, slots=True)
class Chain:
    """When a chain joined nest and goal, and how well."""

    at: float  # s until the nest learned of the goal; inf: never
    gap: float  # longest gap in the chain at that time, over the distance of members; NaN: no chain
    held: float  # share of later samples in which the nest's chain leads to the goal; NaN: no chain


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_more: bool = True) -> list[Outcome]:
    """All outcomes: for each seed a run with the defaults; `has_more`: also with fixed chains."""
    runs = each(run, [(seed, {}) for seed in seeds], jobs)
    done = [one for one in runs if one.at <= SECONDS]
    joined = share_of(map(_is_joined, runs))
    found = [
        at_least(NAME, "share of runs in which a chain joins both", 0.9, joined, _PATH),
        at_most(NAME, "longest gap of it / distance", 1.6, [one.gap for one in done], "ours"),
        at_least(NAME, "share of 30 s after it for which it holds", 0.9, _held(done), "ours"),
    ]
    if not has_more:
        return found
    aligning = each(run, [(seed, ALIGNING) for seed in seeds], jobs)
    static = each(run, [(seed, STATIC) for seed in seeds], jobs)
    what = "the same share, less than with the defaults by"
    fewer, fewest = (
        difference_of(map(_is_joined, runs), map(_is_joined, some)) for some in (aligning, static)
    )
    return [
        *found,
        at_least(NAME, f"sweep 0: {what}", 0.1, fewer, _MOTION),
        at_least(NAME, f"sweep 0, leave 0: {what}", 0.3, fewest, _MOTION),
    ]


def _is_joined(chain: Chain) -> bool:
    return chain.at <= SECONDS


def _held(runs: Sequence[Chain]) -> list[float]:
    return [one.held for one in runs]


def run(given: tuple[int, Mapping[str, Value]]) -> Chain:
    """One run: robot 0 is the nest, robot 1 the goal, the others begin at random around the nest.

    The run ends `HELD` samples after the nest learned of the goal.
    """
    seed, params = given
    rng = np.random.default_rng(seed)
    to_goal = float(rng.uniform(-math.pi, math.pi))
    around = np.column_stack([rng.uniform(-1.2, 1.2, (ROBOTS, 2)), rng.uniform(-3.0, 3.0, ROBOTS)])
    ends = [[0.0, 0.0, 0.0], [FAR * math.cos(to_goal), FAR * math.sin(to_goal), 0.0]]
    own: Mapping[int, Mapping[str, Value]] = {0: {"role": "nest"}, 1: {"role": "goal"}}
    free, left = scan_of(load_platform("burger")), [HELD]

    def see(_: int, __: Array) -> Scan:
        return free

    def is_over(reports: Sequence[Mapping[str, Scalar]]) -> bool:
        left[0] -= left[0] < HELD or bool(reports[0].get("leads"))
        return left[0] < 0

    swarm = PointSwarm(
        NAME, np.vstack([ends, around]), seed=seed, params=params, own=own, reach=REACH, see=see
    )
    track = swarm.run(SECONDS, EVERY, is_over)
    leads = track.reported("leads", 0.0)[:, 0] > 0.0
    if not leads.any():
        return Chain(math.inf, math.nan, math.nan)
    first = int(leads.argmax())
    return Chain(float(track.t[first]), _longest_gap(track, first), float(leads[first:].mean()))


def _longest_gap(track: Track, row: int) -> float:
    """The longest gap on the way from nest to goal over members, over the distance of members.

    The way is the one whose longest gap is least.
    """
    places = track.pose[row, :, :2]
    states = [one.get("state") for one in track.reports[row]]
    members = [k for k, one in enumerate(states) if one in ("nest", "goal", "chain")]
    x, y = places[members].T
    apart = np.asarray(np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y)))
    for k in range(len(members)):  # minimax paths by the algorithm of Floyd and Warshall
        apart = np.minimum(apart, np.maximum(apart[:, k : k + 1], apart[k : k + 1, :]))
    return float(apart[0, 1] / DISTANCE)

"""Chain formation: a chain joins a nest and a goal that no robot senses from there, and holds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import (
    Joined,
    Outcome,
    at_least,
    at_most,
    difference_of,
    reported,
    share_of,
)
from studies.point_swarm import PointSwarm, Track
from swarmd.core.values import Array, Scalar, Scan, Value
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_of

NAME = "chain_formation"
SHORT_FORM = {"has_more": False}
FILM = {
    "title": "from the nest in the middle to the goal on the right",
    "stop": 150.0,
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
    """Measure how often a chain of robots joins the nest to the goal, and how well the chain holds.

    A swarm of point robots (no bodies) makes one run for each seed with the default parameters.
    `has_more`: also runs with chains that align but do not turn about the nest (`sweep` 0), and
    with chains that no member leaves either (`leave` 0). Each outcome has the measured values,
    their bound and the source of the bound.
    """
    runs = each(run, [(seed, {}) for seed in seeds], jobs)
    joined_runs = [chain for chain in runs if _is_joined(chain)]
    joined_share = share_of(map(_is_joined, runs))
    gaps = [chain.gap for chain in joined_runs]  # at the moment of joining
    held_shares = [chain.held for chain in joined_runs]  # of the 30 s after joining
    default_outcomes = [
        at_least(NAME, "share of runs in which a chain joins both", 0.9, joined_share, _PATH),
        at_most(NAME, "longest gap of it / distance", 1.6, gaps, "ours"),
        at_least(NAME, "share of 30 s after it for which it holds", 0.9, held_shares, "ours"),
    ]
    if not has_more:
        return default_outcomes

    def lost_share(params: Mapping[str, Value]) -> Joined:
        """The share of joined runs with the defaults, less their share with these parameters."""
        changed_runs = each(run, [(seed, params) for seed in seeds], jobs)
        return difference_of(map(_is_joined, runs), map(_is_joined, changed_runs))

    label = "the same share, less than with the defaults by"
    return [
        *default_outcomes,
        reported(NAME, "time until it joins both [s]", [chain.at for chain in joined_runs], "-"),
        at_least(NAME, f"sweep 0: {label}", 0.1, lost_share(ALIGNING), _MOTION),
        at_least(NAME, f"sweep 0, leave 0: {label}", 0.3, lost_share(STATIC), _MOTION),
    ]


def _is_joined(chain: Chain) -> bool:
    return chain.at <= SECONDS


def run(given: tuple[int, Mapping[str, Value]]) -> Chain:
    """Simulate point robots, and return when a chain joined nest and goal, and how well.

    `given`: the seed, and the parameters of all robots. Robot 0 is the nest, and robot 1 is the
    goal, `FAR` m away. All further robots begin at random around the nest. The nest reports `leads`
    while a chain joins nest and goal. The run ends `HELD` samples after the first such report, or
    after `SECONDS`. Without such a report `Chain.at` is inf, and the other fields are NaN.
    """
    seed, params = given
    rng = np.random.default_rng(seed)
    goal_bearing = float(rng.uniform(-math.pi, math.pi))
    robots = np.column_stack([rng.uniform(-1.2, 1.2, (ROBOTS, 2)), rng.uniform(-3.0, 3.0, ROBOTS)])
    nest = [0.0, 0.0, 0.0]
    goal = [FAR * math.cos(goal_bearing), FAR * math.sin(goal_bearing), 0.0]
    roles: Mapping[int, Mapping[str, Value]] = {0: {"role": "nest"}, 1: {"role": "goal"}}
    free_scan = scan_of(load_platform("burger"))  # a scan without obstacles
    samples_since_joined = 0

    def see(_: int, __: Array) -> Scan:
        return free_scan

    def is_over(reports: Sequence[Mapping[str, Scalar]]) -> bool:
        nonlocal samples_since_joined
        has_joined = samples_since_joined > 0 or bool(reports[0].get("leads"))
        samples_since_joined += has_joined
        return samples_since_joined > HELD

    poses = np.vstack([[nest, goal], robots])
    swarm = PointSwarm(NAME, poses, seed=seed, params=params, own=roles, reach=REACH, see=see)
    track = swarm.run(SECONDS, EVERY, is_over)
    leads = track.reported("leads", 0.0)[:, 0] > 0.0  # (T,) of the nest
    if not leads.any():
        return Chain(math.inf, math.nan, math.nan)
    first = int(leads.argmax())  # the first sample at which a chain joins nest and goal
    return Chain(float(track.t[first]), _longest_gap(track, first), float(leads[first:].mean()))


def _longest_gap(track: Track, row: int) -> float:
    """The longest gap on the path from nest to goal over members, in multiples of DISTANCE.

    `row`: the sample. Of all paths over members the function takes the path whose longest gap is
    least (minimax path).
    """
    places = track.pose[row, :, :2]
    states = [report.get("state") for report in track.reports[row]]
    members = [robot for robot, state in enumerate(states) if state in ("nest", "goal", "chain")]
    x, y = places[members].T
    gaps = np.asarray(np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y)))
    for via in range(len(members)):  # minimax paths by the algorithm of Floyd and Warshall
        gaps = np.minimum(gaps, np.maximum(gaps[:, via : via + 1], gaps[via : via + 1, :]))
    return float(gaps[0, 1] / DISTANCE)  # robot 0 is the nest, robot 1 the goal

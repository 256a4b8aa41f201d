"""Leader following: gap errors do not grow along the chain, and a lost leader is replaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most
from studies.outcomes.rows import RowsOf
from studies.point_swarm import PointSwarm, Track
from swarmd.patterns.leader_following.metrics import HEADWAY, SPEED, STANDSTILL

NAME = "leader_following"
SHORT_FORM = {"has_bodies": False}
FILM = {"title": "the leader is removed after 60 s", "stop": 90.0}
ROBOTS, SECONDS, LOST_AT = 8, 60.0, 35.0
LAG = 0.3
"""The default in s."""
SHORT = 1.0
"""A headway and a lag in s: half of the headway that string stability needs."""
_PLOEG = "Ploeg et al. 2014: not above 1 where headway >= 2 lag"
_UNSTABLE = "Ploeg et al. 2014: headway < 2 lag amplifies"
_POLICY = "Ioannou and Chien 1993: standstill + headway x speed"
_LEASE = "ours: the lease of 2 s, and a message of 0.5 s for each robot"


@dataclass(frozen=True, slots=True)
class Chain:
    """How gap errors and speeds pass on along a chain.

    The gap error of a robot is the difference between its gap and the policy's gap.
    """

    growth: float  # largest RMS gap error of the later followers, over that of the first follower
    peak: float  # top speed of any robot, over the leader's speed
    off: float  # m, largest gap error at the end
    named: float  # s from the loss of the leader until all name it as lost and follow the next


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_bodies: bool = True) -> list[Outcome]:
    """Measure whether gap errors grow along the chain, and how fast a lost leader is replaced.

    For each seed a chain of point robots (no bodies) runs with the default headway, and a chain
    with a headway of one lag, for which string stability is lost. The gap error of a robot is the
    difference between its gap and the policy's gap. `has_bodies`: also Burgers on a circle. Each
    outcome has the measured values, their bound and the source of the bound.
    """
    stable = each(run, [(seed, HEADWAY, LAG) for seed in seeds], jobs)
    unstable = each(run, [(seed, SHORT, SHORT) for seed in seeds], jobs)
    growth_label, short = "largest gap error / the first follower's", "headway of one lag:"
    point_outcomes = [
        at_most(NAME, growth_label, 1.1, [chain.growth for chain in stable], _PLOEG),
        at_most(NAME, "top speed / the leader's", 1.01, [chain.peak for chain in stable], _PLOEG),
        at_most(NAME, "gaps at the end, off from the policy [m]", 0.01,
                [chain.off for chain in stable], _POLICY),
        at_least(NAME, f"{short} {growth_label}", 1.2,
                 [chain.growth for chain in unstable], _UNSTABLE),
        at_least(NAME, f"{short} top speed / the leader's", 1.1,
                 [chain.peak for chain in unstable], _UNSTABLE),
        at_most(NAME, "time until all name the lost leader [s]", 6.0,
                [chain.named for chain in stable], _LEASE),
    ]  # fmt: skip
    if not has_bodies:
        return point_outcomes
    return [*point_outcomes, *RowsOf(NAME).outcomes(seeds, jobs)]


def run(given: tuple[int, float, float]) -> Chain:
    """Simulate a chain of point robots, and measure the gap errors.

    `given`: seed, and headway and lag in s. The chain begins at rest. The leader starts after 2 s,
    and is absent from `LOST_AT` s on.
    """
    seed, headway, lag = given
    rng = np.random.default_rng(seed)
    x = -STANDSTILL * np.arange(ROBOTS)
    poses = np.column_stack([x, rng.uniform(-0.01, 0.01, (ROBOTS, 2))])
    params, ends = {"headway": headway, "lag": lag}, {0: LOST_AT}
    track = PointSwarm(NAME, poses, seed=seed, params=params, reach=2.0, ends=ends).run(SECONDS)
    has_leader = track.t < LOST_AT
    speed = track.reported("speed")[has_leader]  # (T, n) m/s
    offsets = np.diff(track.pose[has_leader, :, :2], axis=1)
    gap = np.hypot(offsets[..., 0], offsets[..., 1])  # (T, n - 1) m, in front of each follower
    gap_error = gap - STANDSTILL - headway * speed[:, 1:]
    rms = np.sqrt(np.nanmean(gap_error**2, axis=0))
    return Chain(
        growth=float(rms[1:].max() / rms[0]),
        peak=float(np.nanmax(speed) / SPEED),
        off=float(np.abs(gap[-1] - STANDSTILL - headway * SPEED).max()),
        named=_named(track),
    )


def _named(track: Track) -> float:
    """The time in s from the loss of the leader until all robots know.

    Each remaining robot then reports robot 0 as lost and robot 1 as leader. NaN: never.
    """
    lost, leader = "robot-000", "robot-001"
    for t, reports in zip(track.t.tolist(), track.reports, strict=True):
        if all(
            report.get("lost") == lost and report.get("leader") == leader for report in reports[1:]
        ):
            return float(t - LOST_AT)
    return float("nan")

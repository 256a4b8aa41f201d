"""Leader following: gap errors do not grow along the chain, and a lost leader is replaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, no_contacts
from studies.point_swarm import PointSwarm, Track, each
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate

NAME = "leader_following"
SHORT_FORM = {"has_bodies": False}
FILM = {"title": "the leader is removed after 60 s", "stop": 90.0}
ROBOTS, SECONDS, LOST_AT = 8, 60.0, 35.0
STANDSTILL, HEADWAY, LAG, SPEED = 0.5, 1.5, 0.3, 0.11
"""The defaults on a Burger, in m, s and m/s."""
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
    """All outcomes: for each seed a run of points, and one with too short a headway.

    `has_bodies`: also a run of Burgers.
    """
    runs = each(run, [(seed, HEADWAY, LAG) for seed in seeds], jobs)
    close = each(run, [(seed, SHORT, SHORT) for seed in seeds], jobs)
    what, named = "largest gap error / the first follower's", [one.named for one in runs]
    off, short = [one.off for one in runs], "headway of one lag:"
    points = [
        at_most(NAME, what, 1.1, [one.growth for one in runs], _PLOEG),
        at_most(NAME, "top speed / the leader's", 1.01, [one.peak for one in runs], _PLOEG),
        at_most(NAME, "gaps at the end, off from the policy [m]", 0.01, off, _POLICY),
        at_least(NAME, f"{short} {what}", 1.2, [one.growth for one in close], _UNSTABLE),
        at_least(
            NAME, f"{short} top speed / the leader's", 1.1, [o.peak for o in close], _UNSTABLE
        ),
        at_most(NAME, "time until all name the lost leader [s]", 6.0, named, _LEASE),
    ]
    if not has_bodies:
        return points
    found = simulate(NAME, seeds, jobs=jobs)
    gaps = [settled(trace.pose[:, :, :2]) for trace in found.traces]
    return [
        *points,
        at_most(NAME, "Burgers on a circle: gaps, off from the policy [m]", 0.1, gaps, _POLICY),
        no_contacts(NAME, found),
    ]


def run(given: tuple[int, float, float]) -> Chain:
    """A chain at rest whose leader starts after 2 s and is absent from `LOST_AT` on."""
    seed, headway, lag = given
    rng = np.random.default_rng(seed)
    x = -STANDSTILL * np.arange(ROBOTS)
    poses = np.column_stack([x, rng.uniform(-0.01, 0.01, (ROBOTS, 2))])
    params, ends = {"headway": headway, "lag": lag}, {0: LOST_AT}
    track = PointSwarm(NAME, poses, seed=seed, params=params, reach=2.0, ends=ends).run(SECONDS)
    led = track.t < LOST_AT
    speed = track.reported("speed")[led]
    apart = np.diff(track.pose[led, :, :2], axis=1)
    gap = np.hypot(apart[..., 0], apart[..., 1])
    error = gap - STANDSTILL - headway * speed[:, 1:]
    sizes = np.sqrt(np.nanmean(error**2, axis=0))
    return Chain(
        float(sizes[1:].max() / sizes[0]),
        float(np.nanmax(speed) / SPEED),
        float(np.abs(gap[-1] - STANDSTILL - headway * SPEED).max()),
        _named(track),
    )


def _named(track: Track) -> float:
    """s from the loss of the leader until all others report it as lost and the next as leader.

    NaN if that never happens.
    """
    lost, leads = "robot-000", "robot-001"
    for at, now in zip(track.t.tolist(), track.reports, strict=True):
        if all(one.get("lost") == lost and one.get("leader") == leads for one in now[1:]):
            return float(at - LOST_AT)
    return float("nan")


def settled(places: Array) -> float:
    """The largest |gap - policy| in m just before the leader is removed, of places (T, n, 2)."""
    apart = np.diff(places[int(len(places) * 55 / 90)], axis=0)
    return float(np.abs(np.hypot(*apart.T) - STANDSTILL - HEADWAY * SPEED).max())

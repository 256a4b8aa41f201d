"""Collective perception: the robots agree on the colour that covers more of the floor."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import (
    Joined,
    Outcome,
    at_least,
    ratio_of,
    share_of,
)
from studies.outcomes.rows import RowsOf
from studies.point_swarm import PointSwarm
from swarmd.core.values import Array, Pose, Scalar, Scan, Value
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.floor import FloorField, Patch
from swarmd.testing.scans import scan_of
from tests.support.voting_sim import Air

NAME = "collective_perception"
SHORT_FORM = {"shares": (0.66,), "has_bodies": False}
IS_LONG = True
FILM = {"title": "62 % is black", "stop": 160.0, "colour": "opinion"}
RULES = ("voter", "majority", "comparison")
SHARES = (0.52, 0.56, 0.60, 0.66)
"""Shares of black tiles."""
BLACK, NONE = 0, -1
"""The opinion that is right, and that of a robot that has not told any."""
ROBOTS, SIDE, REACH = 20, 4.0, 1.4
"""Robots, side of the room in m and range of the radio in m: those of the scenario."""
SPEED = 0.12
"""m/s; with the turns at walls a point drives 0.1 m/s on average, as a Burger among twenty does."""
SECONDS = 600.0
"""Of a run of points, in s."""
AGREED = 5
"""All robots hold one opinion for so many samples, one a second: longer than they listen."""
RIGHT = 0.9
"""The least share of runs that end in agreement on black."""
SURE = 0.60
"""From this share of black on; nearer to a half, chance decides more often."""
_AIR = Air(delay=0.02, jitter=0.01)


@dataclass(frozen=True, slots=True)
class Setting:
    seed: int
    rule: str
    share: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """The opinion on which all robots agree, and the time in s; None and inf without agreement."""

    opinion: int | None
    at: float


def outcomes(
    seeds: Sequence[int],
    jobs: int = 1,
    *,
    shares: Sequence[float] = (SHARES[0], *SHARES[2:]),
    has_bodies: bool = True,
) -> list[Outcome]:
    """Measure how often the robots agree that the floor is mostly black, and how fast.

    For each seed a swarm of point robots (no bodies) runs with each rule on floors with the
    `shares` of black tiles, by default those of SHARES except 0.56. `has_bodies`: simulated Burgers
    also run, with the majority rule. Each outcome has the measured values, their bound and the
    source of the bound.
    """
    runs = agreements(seeds, jobs, shares)  # by rule and share
    low, high = min(shares), max(shares)
    # Shares near a half are left out: there chance decides more often.
    clear_shares = sorted((share for share in shares if share >= SURE), reverse=True)
    point_outcomes = []
    for rule in RULES:
        for share in clear_shares:
            label = f"{rule}, {100.0 * share:.0f} % black: share of runs that agree on black"
            point_outcomes.append(at_least(NAME, label, RIGHT, won(runs[rule, share]), "ours"))
        if low < high:
            ratio = ratio_of(taken(runs[rule, low]), taken(runs[rule, high]))
            label = f"{rule}: mean time at {100.0 * low:.0f} % / at {100.0 * high:.0f} % black"
            point_outcomes.append(at_least(NAME, label, 1.0, ratio, "ours: the nearer, the later"))
    if not has_bodies:
        return point_outcomes
    return [*point_outcomes, *RowsOf(NAME).outcomes(seeds, jobs)]


def agreements(
    seeds: Sequence[int], jobs: int = 1, shares: Sequence[float] = SHARES
) -> dict[tuple[str, float], list[Agreement]]:
    """By rule and share of black, a run of points for each seed."""
    settings = settings_of(seeds, shares)
    found: dict[tuple[str, float], list[Agreement]] = {}
    for setting, agreement in zip(settings, each(run, settings, jobs), strict=True):
        found.setdefault((setting.rule, setting.share), []).append(agreement)
    return found


def settings_of(seeds: Sequence[int], shares: Sequence[float] = SHARES) -> list[Setting]:
    """The runs by share of black, rule and seed."""
    return [Setting(seed, rule, share) for share in shares for rule in RULES for seed in seeds]


def won(found: Sequence[Agreement]) -> Joined:
    """The share of runs that agree on black."""
    return share_of(one.opinion == BLACK for one in found)


def taken(found: Sequence[Agreement]) -> list[float]:
    """The time of each run in s; `SECONDS` where it has no agreement."""
    return [min(one.at, SECONDS) for one in found]


def run(setting: Setting) -> Agreement:
    """Simulate point robots on a tiled floor until they agree, and return the opinion and the time.

    Half of the points begin with each opinion, at random places of the room. The seed also draws
    the floor. The points agree if AGREED samples in a row, 1 s apart, hold one opinion; the time of
    the first of these samples is returned. Without agreement within SECONDS: (None, inf).
    """
    rng = np.random.default_rng(setting.seed)
    half_side = 0.5 * SIDE - 0.2
    places = rng.uniform(-half_side, half_side, (ROBOTS, 2))
    poses = np.column_stack([places, rng.uniform(-math.pi, math.pi, ROBOTS)])
    platform, scan_numbers = load_platform("burger"), count()
    ground = FloorField(name="ground", patches=(tiles(setting.share, setting.seed),))

    def see(row: int, present_poses: Array) -> Scan:
        pose = Pose(*present_poses[row].tolist())
        return scan_of(platform, room=SIDE, pose=pose, seq=next(scan_numbers))

    def sense(now: float, row: int, poses: Array) -> Mapping[str, float]:
        return {"ground": float(ground.at(poses[row : row + 1, :2])[0])}

    params: dict[str, Value] = {"rule": setting.rule, "explore": 20.0, "speed": SPEED}
    swarm = PointSwarm(
        NAME,
        poses,
        seed=setting.seed,
        params=params,
        own={row: {"initial": row % 2} for row in range(ROBOTS)},
        reach=REACH,
        air=_AIR,
        sense=sense,
        see=see,
    )
    recent_opinions: deque[set[Scalar]] = deque(maxlen=AGREED)  # a set for each sample

    def have_agreed(reports: Sequence[Mapping[str, Scalar]]) -> bool:
        recent_opinions.append({report.get("opinion", NONE) for report in reports})
        return len(recent_opinions) == AGREED and len(set().union(*recent_opinions)) == 1

    track = swarm.run(SECONDS, every=1.0, until=have_agreed)
    opinions = set[Scalar]().union(*recent_opinions)
    if len(opinions) > 1:  # no agreement within SECONDS
        return Agreement(None, math.inf)
    return Agreement(int(opinions.pop()), float(track.t[-AGREED]))  # the first of AGREED samples


def tiles(share: float, seed: int) -> Patch:
    """The floor: this share of black, drawn by the seed."""
    return Patch(rectangle=(0.0, 0.0, SIDE, SIDE), tiles=0.1, share=share, seed=seed)

"""Vicsek alignment: order at little noise, none at the most, and what remains by the number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, difference_of, mean_of
from studies.point_swarm import PointSwarm, each

NAME = "vicsek_alignment"
SHORT_FORM = {"has_sizes": False}
IS_LONG = True
FILM = {"title": "noise 0.5", "stop": 30.0}
DENSITY = 0.4
"""Robots a square metre, in a square whose opposite sides are joined (Vicsek et al. 1995)."""
ROBOTS, FEW = 40, 10
NOISES = (0.5, 2.0, 3.5, 5.0)
SECONDS, SETTLED = 160.0, 100.0
INDEPENDENT = {ROBOTS: 0.141, FEW: 0.282}
"""Mean order of so many independent headings: exact."""
_VICSEK = "Vicsek et al. 1995: order; critical noise 2.9 where the swarm is endless"
_RAYLEIGH = "exact: independent headings, about 0.89 / sqrt(n)"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    noise: float
    robots: int = ROBOTS


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_sizes: bool = True) -> list[Outcome]:
    """All outcomes: forty robots at five levels of noise and ten at two, for each seed.

    Without `has_sizes` forty robots at the least and the most noise.
    """

    def orders(noise: float, robots: int = ROBOTS) -> list[float]:
        return each(order, [_Setting(seed, noise, robots) for seed in seeds], jobs)

    noises = (*(NOISES if has_sizes else NOISES[:1]), 2.0 * math.pi)
    by_noise = [orders(noise) for noise in noises]
    means = [float(np.mean(found)) for found in by_noise]
    falls = [more - less for more, less in pairwise(means)]
    off = abs(means[-1] - INDEPENDENT[ROBOTS])
    forty = [
        at_least(NAME, "order, noise 0.5", 0.8, by_noise[0], _VICSEK),
        at_least(NAME, "mean order, noise 0.5", 0.9, mean_of(by_noise[0]), _VICSEK),
        at_least(NAME, "mean order falls by, to noise 2, 3.5, 5, 6.28", 0.0, falls, _VICSEK),
        at_most(NAME, "mean order at noise 6.28, off from 0.141", 0.02, [off], _RAYLEIGH),
    ]
    if not has_sizes:
        return forty
    off_few = abs(float(np.mean(orders(2.0 * math.pi, FEW))) - INDEPENDENT[FEW])
    rise = difference_of(orders(5.0, FEW), by_noise[3])
    return [
        *forty,
        at_most(NAME, "ten robots: off from 0.282", 0.04, [off_few], _RAYLEIGH),
        at_least(NAME, "noise 5: ten robots are more ordered by", 0.05, rise, "size effect"),
    ]


def order(setting: _Setting) -> float:
    """The mean length of the mean heading as a unit vector, from `SETTLED` on."""
    rng = np.random.default_rng(setting.seed)
    side = math.sqrt(setting.robots / DENSITY)
    x, y = rng.uniform(0.0, side, (2, setting.robots))
    poses = np.column_stack([x, y, rng.uniform(-math.pi, math.pi, setting.robots)])
    params = {"noise": setting.noise}
    swarm = PointSwarm(NAME, poses, seed=setting.seed, params=params, reach=1.0, torus=side)
    track = swarm.run(SECONDS, every=1.0)
    late = track.pose[track.t >= SETTLED][..., 2]
    return float(np.abs(np.exp(1j * late).mean(axis=1)).mean())

"""Vicsek alignment: order against the noise, and the size effect: few robots are more ordered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, difference_of, mean_of
from studies.point_swarm import PointSwarm

NAME = "vicsek_alignment"
SHORT_FORM = {"has_sizes": False}
IS_LONG = True
FILM = {"title": "noise 0.5", "stop": 30.0}
DENSITY = 0.4
"""Robots a square metre, in a square whose opposite sides are joined (Vicsek et al. 1995)."""
ROBOTS, FEW = 40, 10
LOW_NOISE, SIZE_NOISE = 0.5, 5.0
"""Noise in rad of the most ordered swarm, and of the comparison of forty with ten robots."""
FULL_NOISE = 2.0 * math.pi
"""Noise in rad at which headings are independent."""
NOISES = (LOW_NOISE, 2.0, 3.5, SIZE_NOISE, FULL_NOISE)
SECONDS, SETTLED = 160.0, 100.0
INDEPENDENT = {ROBOTS: 0.141, FEW: 0.282}
"""Mean order of independent headings, exact, by the number of robots."""
_VICSEK = "Vicsek et al. 1995: order; critical noise 2.9 where the swarm is endless"
_RAYLEIGH = "exact: independent headings, about 0.89 / sqrt(n)"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    noise: float
    robots: int = ROBOTS


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_sizes: bool = True) -> list[Outcome]:
    """Measure the polar order of the headings (0: random, 1: all equal) against the noise in rad.

    For each seed forty robots run at five levels of noise, and ten robots at two levels. Without
    `has_sizes` only forty robots run, at the least and the most noise. Each outcome has the
    measured values, their bound and the source of the bound.
    """

    def orders(noise: float, robots: int = ROBOTS) -> list[float]:
        return each(order, [_Setting(seed, noise, robots) for seed in seeds], jobs)

    noises = NOISES if has_sizes else (LOW_NOISE, FULL_NOISE)
    by_noise = {noise: orders(noise) for noise in noises}
    means = [float(np.mean(values)) for values in by_noise.values()]
    falls = [before - after for before, after in pairwise(means)]
    fall_label = f"mean order falls by, to noise {', '.join(f'{x:.3g}' for x in noises[1:])}"
    # At full noise the headings are independent, and their mean order is known.
    error = abs(means[-1] - INDEPENDENT[ROBOTS])
    forty = [
        at_least(NAME, "order, noise 0.5", 0.8, by_noise[LOW_NOISE], _VICSEK),
        at_least(NAME, "mean order, noise 0.5", 0.9, mean_of(by_noise[LOW_NOISE]), _VICSEK),
        at_least(NAME, fall_label, 0.0, falls, _VICSEK, len(seeds)),
        at_most(
            NAME, "mean order at noise 6.28, off from 0.141", 0.02, [error], _RAYLEIGH, len(seeds)
        ),
    ]
    if not has_sizes:
        return forty
    error_of_few = abs(float(np.mean(orders(FULL_NOISE, FEW))) - INDEPENDENT[FEW])
    rise = difference_of(orders(SIZE_NOISE, FEW), by_noise[SIZE_NOISE])
    return [
        *forty,
        at_most(NAME, "ten robots: off from 0.282", 0.04, [error_of_few], _RAYLEIGH, len(seeds)),
        at_least(NAME, "noise 5: ten robots are more ordered by", 0.05, rise, "size effect"),
    ]


def order(setting: _Setting) -> float:
    """The polar order 0..1 of a run: the length of the mean of all headings' unit vectors.

    The mean over time is from `SETTLED` s on.
    """
    rng = np.random.default_rng(setting.seed)
    side = math.sqrt(setting.robots / DENSITY)
    x, y = rng.uniform(0.0, side, (2, setting.robots))
    poses = np.column_stack([x, y, rng.uniform(-math.pi, math.pi, setting.robots)])
    params = {"noise": setting.noise}
    swarm = PointSwarm(NAME, poses, seed=setting.seed, params=params, reach=1.0, torus=side)
    track = swarm.run(SECONDS, every=1.0)
    late = track.pose[track.t >= SETTLED][..., 2]
    return float(np.abs(np.exp(1j * late).mean(axis=1)).mean())

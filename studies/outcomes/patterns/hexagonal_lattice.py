"""Hexagonal lattice: neighbours are at the distance, and their bonds are 60 degrees apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of
from studies.outcomes.rows import RowsOf
from studies.point_swarm import PointSwarm
from swarmd.patterns.hexagonal_lattice.metrics import DISTANCE, Lattice, lattice

NAME = "hexagonal_lattice"
SHORT_FORM = {"has_more": False}
IS_LONG = True
FILM = {"stop": 90.0}
ROBOTS, SECONDS = 30, 120.0
WEAK = {"strongest": 1.0}
"""The repulsion is no stronger than the attraction of the next neighbours."""
_LATTICE = "Spears et al. 2004: a hexagonal lattice; the bound: ours"
_SHARED = "Spears et al. 2004: a place of the lattice holds a cluster where F_max is small"
_CHANCE = "ours: the start must not have the order"


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_more: bool = True) -> list[Outcome]:
    """Measure the order of the lattice in which the robots settle.

    For each seed a swarm of point robots (no bodies) runs. A bond joins two robots that are near
    each other. `has_more`: also points with a weak repulsion, where two robots may share a place of
    the lattice, and Burgers with bodies. Each outcome has the measured values, their bound and the
    source of the bound.
    """
    runs = each(run, [(seed, {}) for seed in seeds], jobs)
    at_start, at_end, moved_m = zip(*runs, strict=True)
    label = "share of bonds within 10 % of the distance"
    near = [lattice.near for lattice in at_end]
    point_outcomes = [
        at_least(NAME, f"points: {label}, mean", 0.9, mean_of(near), _LATTICE),
        at_least(NAME, f"points: {label}", 0.6, near, _LATTICE),
        at_least(NAME, "points: order psi6", 0.5, [found.psi6 for found in at_end], _LATTICE),
        at_most(NAME, "points: spread of bonds / distance", 0.2,
                [found.spread for found in at_end], _LATTICE),
        at_most(NAME, f"points, at the start: {label}", 0.5,
                [found.near for found in at_start], _CHANCE),
        at_most(NAME, "points: pairs at one place", 0, [found.shared for found in at_end], _SHARED),
        at_most(NAME, "points: way in the last 20 s [m]", 0.05, moved_m, "ours: at rest"),
    ]  # fmt: skip
    if not has_more:
        return point_outcomes
    weak_runs = each(run, [(seed, WEAK) for seed in seeds], jobs)
    weak_shared = [at_end.shared for _, at_end, _ in weak_runs]
    return [
        *point_outcomes,
        at_least(NAME, "points, strongest 1: pairs at one place", 1, weak_shared, _SHARED),
        *RowsOf(NAME).outcomes(seeds, jobs),
    ]


def run(given: tuple[int, Mapping[str, float]]) -> tuple[Lattice, Lattice, float]:
    """Simulate point robots from random places of a square; `given`: seed and parameters.

    Returns the lattices at the start and the end, and the longest path of a robot in m in the last
    20 s.
    """
    seed, params = given
    rng = np.random.default_rng(seed)
    side = 0.8 * DISTANCE * math.sqrt(ROBOTS)
    places = rng.uniform(-0.5 * side, 0.5 * side, (ROBOTS, 2))
    poses = np.column_stack([places, rng.uniform(-math.pi, math.pi, ROBOTS)])
    swarm = PointSwarm(NAME, poses, seed=seed, params=params, reach=3.0 * DISTANCE)
    track = swarm.run(SECONDS, every=1.0)
    paths_m = np.hypot(*np.diff(track.pose[-21:, :, :2], axis=0).T).sum(axis=1)
    return lattice(places), lattice(track.pose[-1, :, :2]), float(paths_m.max())

"""Hexagonal lattice: neighbours are at the distance, and their bonds are 60 degrees apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, metric, no_contacts
from studies.point_swarm import PointSwarm, each
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate

NAME = "hexagonal_lattice"
SHORT_FORM = {"has_more": False}
IS_LONG = True
FILM = {"stop": 90.0, "camera": "top"}
ROBOTS, DISTANCE, SECONDS = 30, 0.7, 120.0
WEAK = {"strongest": 1.0}
"""The repulsion is no stronger than the attraction of the next neighbours."""
BOND = 1.3
"""Of the distance: a bond is between robots that are nearer."""
_LATTICE = "Spears et al. 2004: a hexagonal lattice; the bound: ours"
_SHARED = "Spears et al. 2004: a place of the lattice holds a cluster where F_max is small"
_CHANCE = "ours: the start must not have the order"


@dataclass(frozen=True, slots=True)
class Lattice:
    """The order of a lattice; a bond is between two robots nearer than BOND times the distance."""

    near: float  # share of bonds whose length is within a tenth of the distance
    psi6: float  # mean bond-orientational order of the robots
    spread: float  # standard deviation of the lengths of bonds, over the distance
    shared: int  # number of pairs of robots that share a place of the lattice


def outcomes(seeds: Sequence[int], jobs: int = 1, *, has_more: bool = True) -> list[Outcome]:
    """All outcomes: for each seed a run of points, and `has_more` a weak one and one of Burgers."""
    runs = each(run, [(seed, {}) for seed in seeds], jobs)
    first, last, moved = zip(*runs, strict=True)
    what = "share of bonds within 10 % of the distance"
    near = [one.near for one in last]
    points = [
        at_least(NAME, f"points: {what}, mean", 0.9, mean_of(near), _LATTICE),
        at_least(NAME, f"points: {what}", 0.6, near, _LATTICE),
        at_least(NAME, "points: order psi6", 0.5, [one.psi6 for one in last], _LATTICE),
        at_most(
            NAME, "points: spread of bonds / distance", 0.2, [o.spread for o in last], _LATTICE
        ),
        at_most(NAME, f"points, at the start: {what}", 0.5, [one.near for one in first], _CHANCE),
        at_most(NAME, "points: pairs at one place", 0, [one.shared for one in last], _SHARED),
        at_most(NAME, "points: way in the last 20 s [m]", 0.05, moved, "ours: at rest"),
    ]
    if not has_more:
        return points
    weak = [one[1] for one in each(run, [(seed, WEAK) for seed in seeds], jobs)]
    found = simulate(NAME, seeds, jobs=jobs, set={"duration": SECONDS})
    bodies = [lattice(trace.pose[-1, :, :2]) for trace in found.traces]
    speed = metric(found, "mean_speed_late_share")
    return [
        *points,
        at_least(
            NAME, "points, strongest 1: pairs at one place", 1, [o.shared for o in weak], _SHARED
        ),
        at_least(NAME, f"Burgers: {what}", 0.75, [one.near for one in bodies], _LATTICE),
        at_least(NAME, "Burgers: order psi6", 0.7, [one.psi6 for one in bodies], _LATTICE),
        at_most(NAME, "Burgers: late speed / limit", 0.5, speed, "ours"),
        no_contacts(NAME, found),
    ]


def run(given: tuple[int, Mapping[str, float]]) -> tuple[Lattice, Lattice, float]:
    """The lattices at the start and the end, and the farthest way in m in the last 20 s."""
    seed, params = given
    rng = np.random.default_rng(seed)
    side = 0.8 * DISTANCE * math.sqrt(ROBOTS)
    places = rng.uniform(-0.5 * side, 0.5 * side, (ROBOTS, 2))
    poses = np.column_stack([places, rng.uniform(-math.pi, math.pi, ROBOTS)])
    swarm = PointSwarm(NAME, poses, seed=seed, params=params, reach=3.0 * DISTANCE)
    track = swarm.run(SECONDS, every=1.0)
    way = np.hypot(*np.diff(track.pose[-21:, :, :2], axis=0).T).sum(axis=1)
    return lattice(places), lattice(track.pose[-1, :, :2]), float(way.max())


def lattice(places: Array) -> Lattice:
    """The order of robots at places (n, 2): of all bonds, psi6 of robots with two or more."""
    off = places[None] - places[:, None]
    apart = np.hypot(off[..., 0], off[..., 1]) / DISTANCE
    is_bond = (apart < BOND) & ~np.eye(len(places), dtype=bool)
    lengths = apart[is_bond]
    if not len(lengths):
        return Lattice(0.0, 0.0, math.inf, 0)
    sixth = np.exp(6j * np.arctan2(off[..., 1], off[..., 0])) * is_bond
    count = is_bond.sum(axis=1)
    order = np.abs(sixth.sum(axis=1)[count > 1]) / count[count > 1]
    near, shared = (np.abs(lengths - 1.0) <= 0.1).mean(), (lengths < 0.3).sum() // 2
    return Lattice(float(near), float(order.mean()), float(lengths.std()), int(shared))

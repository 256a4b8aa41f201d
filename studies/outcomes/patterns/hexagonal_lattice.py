"""Hexagonal lattice: neighbours are at the distance, and their bonds are 60 degrees apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, metric, no_contacts
from studies.point_swarm import PointSwarm
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate

NAME = "hexagonal_lattice"
SHORT_FORM = {"has_more": False}
IS_LONG = True
FILM = {"stop": 90.0}
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
    burgers = simulate(NAME, seeds, jobs=jobs, set={"duration": SECONDS})
    bodies = [lattice(trace.pose[-1, :, :2]) for trace in burgers.traces]
    return [
        *point_outcomes,
        at_least(NAME, "points, strongest 1: pairs at one place", 1, weak_shared, _SHARED),
        at_least(NAME, f"Burgers: {label}", 0.75, [body.near for body in bodies], _LATTICE),
        at_least(NAME, "Burgers: order psi6", 0.7, [body.psi6 for body in bodies], _LATTICE),
        at_most(NAME, "Burgers: late speed / limit", 0.5,
                metric(burgers, "mean_speed_late_share"), "ours"),
        no_contacts(NAME, burgers),
    ]  # fmt: skip


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


def lattice(places: Array) -> Lattice:
    """The order of robots at places (n, 2) in m.

    The order psi6 of a robot is the absolute mean of exp(6 i bearing) over its bonds: it is 1 if
    the angles between the bonds are multiples of 60 degrees. `Lattice.psi6` is the mean over the
    robots with two bonds or more. Without a bond `spread` is inf, and the other values are 0.
    """
    offsets = places[None] - places[:, None]  # (n, n, 2) m
    distances = np.hypot(offsets[..., 0], offsets[..., 1]) / DISTANCE
    is_bond = (distances < BOND) & ~np.eye(len(places), dtype=bool)
    lengths = distances[is_bond]
    if not len(lengths):
        return Lattice(0.0, 0.0, math.inf, 0)
    sixth = np.exp(6j * np.arctan2(offsets[..., 1], offsets[..., 0])) * is_bond
    bonds = is_bond.sum(axis=1)
    psi6 = np.abs(sixth.sum(axis=1)[bonds > 1]) / bonds[bonds > 1]
    near = (np.abs(lengths - 1.0) <= 0.1).mean()
    shared_pairs = (lengths < 0.3).sum() // 2  # each pair counts twice in `lengths`
    return Lattice(float(near), float(psi6.mean()), float(lengths.std()), int(shared_pairs))

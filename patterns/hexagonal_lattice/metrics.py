"""Metrics of the hexagonal lattice: lengths of bonds, and the angles between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

DISTANCE = 0.7
"""The distance of neighbours, in m."""
BOND = 1.3
"""Of the distance: a bond is between robots that are nearer."""


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def bonds_near_distance(trace: Trace) -> float:
    """The share of bonds at the end whose length is within a tenth of the distance."""
    return lattice(trace.pose[-1, :, :2]).near


@metric(better="more", bounds=(0.0, 1.0))
def psi6(trace: Trace) -> float:
    """The bond-orientational order at the end: 1 if bonds are multiples of 60 degrees apart."""
    return lattice(trace.pose[-1, :, :2]).psi6


@dataclass(frozen=True, slots=True)
class Lattice:
    """The order of a lattice; a bond is between two robots nearer than BOND times the distance."""

    near: float  # share of bonds whose length is within a tenth of the distance
    psi6: float  # mean bond-orientational order of the robots
    spread: float  # standard deviation of the lengths of bonds, over the distance
    shared: int  # number of pairs of robots that share a place of the lattice


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

"""Metrics of patrol: idleness, the time since a robot last visited a place of the scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

PLACES = ((0, 0), (2, 0), (4, 0), (4, 2), (2, 2), (0, 2), (0, 4), (2, 4), (4, 4))
"""A grid of three by three, in m."""
WAY = 16.0 + 2.0 * math.sqrt(2.0)
"""The shortest closed way in m past all places."""
SPEED = 0.22
"""The speed of a Burger in m/s."""
EVERY = 0.2
"""s between two samples."""
_SHIFT = 2.0  # m along both axes, from the places of the scenario to PLACES
_ARRIVAL = 0.2  # m, the parameter `arrival` of Burgers
_SETTLED = 100.0  # s


@metric(better="less")
def idleness_of_ideal(trace: Trace) -> float:
    """The mean idleness of three robots by that of robots evenly on the shortest closed way.

    The trace has five samples a second.
    """
    found = idleness(trace.pose[:, :, :2] + _SHIFT, _ARRIVAL, _SETTLED)
    return found.mean / ideal(3)


@dataclass(frozen=True, slots=True)
class Idleness:
    """The mean over places and time in s, and the longest of any place."""

    mean: float
    worst: float


def idleness(places: Array, arrival: float, settled: float) -> Idleness:
    """Of robots at places (T, n, 2) every `EVERY` s, from `settled` s on."""
    off = places[:, :, None] - np.array(PLACES, float)
    near = arrival + 0.5 * SPEED * EVERY
    is_visited = (np.hypot(off[..., 0], off[..., 1]) <= near).any(axis=1)
    times = np.arange(len(places)) * EVERY
    last = np.maximum.accumulate(np.where(is_visited, times[:, None], 0.0), axis=0)
    late = (times[:, None] - last)[times >= settled]
    return Idleness(float(late.mean()), float(late.max()))


def ideal(number: int) -> float:
    """The mean idleness in s of robots evenly on the shortest closed way, 2 m for each place."""
    return 0.5 * WAY / SPEED / number

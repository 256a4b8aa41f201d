"""Metrics of wall following: the distance that a robot keeps, and how far it goes around."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.kinematics import mean_speed
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

SIDE = 6.0
"""The room's side in m."""
DISTANCE = 0.5
"""The distance of a Burger, in m."""
_OFF = 0.1  # m, the error of it that counts as kept
_EARLY = 30.0  # s until a robot has found a wall
_BURGER = 0.22  # m/s, the speed limit


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def share_kept(trace: Trace) -> float:
    """The share of the time from 30 s on in which the nearest wall is within 0.1 m of 0.5 m."""
    distance = SIDE / 2.0 - np.abs(_late(trace)).max(axis=1)
    return float(np.mean(np.abs(distance - DISTANCE) <= _OFF))


@metric(better="more")
def rounds_clockwise(trace: Trace) -> float:
    """How often the first robot has gone around the middle clockwise, from 30 s on."""
    return -1 * _turned(trace) / (2.0 * math.pi)


@metric(better="more")
def rounds_counter_clockwise(trace: Trace) -> float:
    """How often the first robot has gone around the middle counter-clockwise, from 30 s on."""
    return _turned(trace) / (2.0 * math.pi)


@metric(unit="share", better="more")
def speed_share(trace: Trace) -> float | None:
    """The mean speed over the run as a share of a Burger's limit."""
    speed = mean_speed(trace)
    return None if speed is None else speed / _BURGER


def _late(trace: Trace) -> Array:
    """(T, 2) the places of the first robot from 30 s on."""
    places: Array = trace.pose[trace.t - trace.t[0] >= _EARLY, 0, :2]
    return places


def _turned(trace: Trace) -> float:
    """The angle in rad by which the first robot has gone around the middle."""
    angles = np.unwrap(np.arctan2(*_late(trace).T[::-1]))
    return float(angles[-1] - angles[0])

"""The speeds of a calibration, and the floor size at which protection limits none of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from swarmd.core.values import Platform

LEAST_FLOOR = 2.0
"""m, side of the smallest floor."""

_TRAVEL_TIME = 1.2  # s at the top speed: a drive, with 0.3 s for its stop
_TOLERANCE = (0.05, 0.06)  # of a return: m, and share of its distance

_TICK = 0.05  # s, until the next decision, and from a decision to the response of the base
_SHARE = 0.95  # share of the surface speed that protection permits near obstacles


def top_speeds(platform: Platform) -> dict[str, float]:
    """The fastest drives in m/s and turns in rad/s by axis: within limits and surface speed.

    `lateral` only for a base that moves sideways.
    """
    surface = _SHARE * _surface_speed(platform)
    limits = platform.limits
    speeds = {
        "linear": min(limits.linear, surface),
        "angular": min(limits.angular, surface / _outer(platform)),
    }
    if limits.lateral > 0.0:
        speeds["lateral"] = min(limits.lateral, surface)
    return speeds


def needed_floor(platform: Platform, late: float = 0.0) -> float:
    """The side in m of the free square floor that a calibration needs, rounded up to 0.1 m.

    The robot stands in the middle. From there the floor has room for the longest drive, and for the
    gap that mode `barrier` needs beyond the end of the drive at top speed (docs/safety.md). For a
    base that moves sideways, drives ahead and drives to the side must both have this room. `late`:
    s by which scans arrive later than declared; protection keeps a larger gap then.
    """
    front, left = platform.footprint.max(axis=0).tolist()
    speeds = top_speeds(platform)
    half = _needed_half(platform, speeds["linear"], front, late)
    if "lateral" in speeds:
        half = max(half, _needed_half(platform, speeds["lateral"], left, late))
    # The check of the floor takes returns that are nearer by _TOLERANCE than the walls.
    half = (half + _TOLERANCE[0]) / (1.0 - _TOLERANCE[1])
    return max(LEAST_FLOOR, math.ceil(20.0 * half - 1e-9) / 10.0)  # the side is 2 * half


def _needed_half(platform: Platform, speed: float, reach: float, late: float) -> float:
    """The free distance in m from the axle for drives at `speed` m/s.

    `reach`: distance in m from axle to outline in the direction of the drive.
    """
    barrier = _barrier(platform)
    spec = platform.scan
    drive_length = travel(speed)
    age = 1.0 / spec.rate + spec.latency + late + _TICK
    brake = float(barrier.get("braking_linear") or 1.0)
    others = float(barrier.get("others_speed") or 0.0)
    gap = speed * _TICK + 0.5 * speed * speed / brake
    gap += others * (age + _TICK + speed / brake)
    gap += float(barrier.get("margin") or 0.0) + float(barrier.get("unseen_extent") or 0.0)
    half = gap + max(reach + drive_length, _outer(platform))
    keep_out = barrier.get("keep_out")
    if keep_out is not None:  # two robots that meet share the room between them by halves
        room = 2.0 * (speed * (2.0 * _TICK + age) + 0.5 * speed * speed / brake)
        half = max(half, float(keep_out) + room + drive_length + float(np.hypot(*spec.offset)))
    return half


def travel(speed: float) -> float:
    """The distance in m that a drive of a calibration at `speed` m/s takes, with its stop.

    The part of the stop is 0.3 s times `speed`. The stops of a base with 1.0 m/s2 and a delay of
    0.1 s are longer from above 0.4 m/s. Such a stop ends in the gap that `needed_floor` adds.
    """
    return _TRAVEL_TIME * speed


def tolerance(half: float) -> float:
    """The m by which a return at `half` m may seem nearer, by noise and drift of odometry."""
    return _TOLERANCE[0] + _TOLERANCE[1] * half


def _barrier(platform: Platform) -> Mapping[str, Any]:
    return platform.protection.get("barrier") or {}


def _surface_speed(platform: Platform) -> float:
    barrier = _barrier(platform)
    return float(barrier.get("surface_speed") or barrier.get("others_speed") or math.inf)


def _outer(platform: Platform) -> float:
    """The distance in m from the axle to the farthest corner of the outline."""
    return float(np.hypot(*platform.footprint.T).max())

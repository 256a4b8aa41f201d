"""Chases the nearest robot that it detects, drives into it, backs off, and chases again.

It backs off because minutes of leaning against one robot prove little. No point of its own outline
moves faster than `surface_speed`, which is what protection assumes of others.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from swarmd.api import Context, Inputs, MovementPattern, Params, Twist, about, clusters

_WIDEST = 0.8  # m: wider objects are walls
_GAIN = 3.0  # 1/s, of the heading
_NEAR = 0.1  # m beyond the sensor's blind zone: a robot that near is rammed, detected or not
_AHEAD = 0.3  # rad
_LEANS = 1.0  # s for which it drives on in contact
_BACKS = 5.0  # s for which it then slows down and backs off
# m/s2: every base turns faster at less than this, so that no turn overlaps with the speed before.
_EASY = 0.3
_BELOW = 0.97  # of the given speed, because a base brakes a turn a little later than it accelerates


class RamParams(Params, frozen=True):
    """How fast."""

    surface_speed: Annotated[
        float,
        about("the fastest that any point of its outline moves", ge=0.01, le=5.0, unit="m/s"),
    ] = 0.3


class Ram(MovementPattern[RamParams]):
    """Towards the nearest thing that is no wall; where it sees none it wanders."""

    params_type = RamParams

    def __init__(self, params: RamParams, context: Context) -> None:
        super().__init__(params, context)
        self._radius = float(np.hypot(*context.platform.footprint.T).max())
        self._near = context.platform.scan.range_min + _NEAR
        self._blind_until = self._back_until = -math.inf
        self._bearing = 0.0
        self._twist = Twist()

    def drive(self, inputs: Inputs) -> Twist:
        """Straight at it, within the speed of the outline."""
        self._bearing -= self._twist.angular * inputs.dt
        if inputs.is_new_scan:
            self._look(inputs)
        limits, most = self.context.platform.limits, _BELOW * self.params.surface_speed
        turn = min(max(_GAIN * self._bearing, -limits.angular), limits.angular)
        # Turning has priority; driving gets the rest of the speed.
        ahead = max(math.cos(self._bearing), 0.0) * min(most, limits.linear)
        wanted = min(ahead, max(most - abs(turn) * self._radius, 0.0))
        if self._blind_until <= inputs.now < self._back_until:
            wanted = -0.5 * ahead
        change, now = _EASY * inputs.dt, self._twist.linear
        linear = min(max(wanted, now - change), now + change)
        room = (most - abs(linear)) / self._radius
        self._twist = Twist(linear=linear, angular=min(max(turn, -room), room))
        return self._twist

    def _look(self, inputs: Inputs) -> None:
        if inputs.now < self._back_until:
            return
        seen = clusters(inputs.scan, within=self.context.platform.scan.range_max)
        is_body = seen.is_free & (seen.widths < _WIDEST)
        ranges = np.where(is_body, seen.ranges, np.inf)
        nearest = float(ranges.min(initial=np.inf))
        if nearest == np.inf:
            self._bearing = float(self.context.rng.normal(0.0, 0.5))
            return
        self._bearing = float(seen.bearings[ranges.argmin()])
        if nearest < self._near and abs(self._bearing) < _AHEAD:
            self._blind_until = inputs.now + nearest / self.params.surface_speed + _LEANS
            self._back_until = self._blind_until + _BACKS

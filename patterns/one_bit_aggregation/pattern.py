"""One-bit aggregation: the robots gather, and each only asks whether a robot is straight ahead.

Source: Gauci, Chen, Li, Dodd and Gross, "Self-organized aggregation without computation", Int. J.
Robotics Research 33(8), 2014. A robot that sees no robot straight ahead drives backwards along a
circle: the wheels turn at -0.7 and -1.0 of their top speed. A robot that sees a robot turns on the
spot, at 1.0 and -1.0. On an e-puck (radius 0.037 m, wheels 0.051 m apart) the circle has a radius
of 0.1445 m. The controller needs no memory and no arithmetic.

Ours: the lidar's sector ahead is the sensor, and an object as narrow as a robot counts as a robot.
The radius of the circle is scaled to the footprint. The robot turns so slowly that the lidar misses
no robot between two scans.

Limits: protection keeps a gap that e-pucks, which push each other, do not keep. Recovery leads a
robot around a robot that blocks its way. Without recovery, blocked robots stand, and the swarm
stays in parts. For more than three robots and without noise the source's controller has deadlocks
(Daymude, Harasha, Richa and Yiu, "Deadlock and noise in self-organized aggregation without
computation", 2021), and no controller of this kind aggregates for sure (arXiv 2501.00390).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np

from swarmd.api import (
    Context,
    Inputs,
    MovementPattern,
    Params,
    Platform,
    Scalar,
    TopSpeed,
    Twist,
    about,
    robots_near,
)

# Radius of the circle of an e-puck by the radius of its body.
_CIRCLE = 0.1445 / 0.037
# The mean of both wheels' shares of their top speed on the circle.
_CIRCLE_SPEED = 0.85
# rad: half of the sector that is straight ahead.
_HALF_WIDTH = math.radians(5.0)


class OneBitAggregationParams(Params, frozen=True, kw_only=True):
    """The sensor, the circle and the turn."""

    speed: TopSpeed
    radius: Annotated[
        float,
        about(
            "radius of the circle along which it drives backwards without a robot ahead",
            ge=0.05,
            le=20.0,
            unit="m",
            source="Gauci et al. 2014: 3.9 times the radius of the body",
            derived=_circle,
        ),
    ]
    half_width: Annotated[
        float,
        about(
            "half of the sector ahead in which the middle of a robot is seen",
            ge=0.001,
            le=1.5,
            unit="rad",
            source="ours: 5 degrees; Gauci et al. 2014 use a line",
        ),
    ] = _HALF_WIDTH
    turn: Annotated[
        float,
        about(
            "turn rate with a robot ahead",
            ge=0.0,
            le=4.0,
            unit="rad/s",
            source="ours: the sector in one scan, as no robot is then missed; Gauci et al.: 5.02",
            derived=_slow_turn,
        ),
    ]
    sight: Annotated[
        float,
        about(
            "farther robots are not seen",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: the lidar's range; Gauci et al. 2014: unlimited",
            derived=lambda platform: platform.scan.range_max,
        ),
    ]


class OneBitAggregation(MovementPattern[OneBitAggregationParams]):
    """Backs along a circle while no robot is ahead, and turns on the spot while one is."""

    group = "gather"
    params_type = OneBitAggregationParams

    def __init__(self, params: OneBitAggregationParams, context: Context) -> None:
        super().__init__(params, context)
        self._seq: int | None = None  # of the scan that the bit is from
        self._sees = False

    def report(self) -> Mapping[str, Scalar]:
        """The bit: whether a robot is ahead."""
        return {"sees": self._sees}

    def drive(self, inputs: Inputs) -> Twist:
        """The command for the bit of the latest scan."""
        params = self.params
        scan = inputs.scan
        if scan is not None and scan.seq != self._seq:
            self._seq = scan.seq
            platform = self.context.platform
            half = params.half_width
            self._sees = bool(robots_near(scan, platform, within=params.sight, half_width=half))
        if self._sees:
            return Twist(angular=-params.turn)
        back = -_CIRCLE_SPEED * params.speed
        return Twist(linear=back, angular=back / params.radius)


def _circle(platform: Platform) -> float:
    """The radius of the circle in m for the half diagonal of the footprint."""
    return _CIRCLE * 0.5 * float(np.hypot(*np.ptp(platform.footprint, axis=0)))


def _slow_turn(platform: Platform) -> float:
    """The turn rate in rad/s that passes the sector in the time of one scan."""
    return min(2.0 * _HALF_WIDTH * platform.scan.rate, platform.limits.angular)

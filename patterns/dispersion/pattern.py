"""Dispersion: the robots spread until nothing is nearer than a distance.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "dispersion", and its code ROS2swarm: a
repulsive potential field, always at full speed.

Law "settling" is ours. The nearest point of each surface, robot or wall, pushes the robot; a nearer
point pushes more. The robot comes to rest where the pushes cancel. So the robots also come to rest
in a room that is too small for the distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from swarmd.api import (
    ZERO,
    ConfigError,
    Context,
    FieldParams,
    FieldPattern,
    Inputs,
    NearPoints,
    Platform,
    Scan,
    Twist,
    about,
    closest_points,
    of_threshold,
    polar_from_base,
    threshold,
)

# Push, as a share of full speed, below which a moving robot stops and above which it starts.
_STOP_PUSH = 0.12
_START_PUSH = 0.25


class DispersionParams(FieldParams, frozen=True, kw_only=True):
    """The distances, and those of every FieldPattern."""

    distance: Annotated[
        float,
        about(
            "distance to keep free all around, also to walls; more than the protection threshold",
            ge=0.05,
            le=100.0,
            unit="m",
            source="paper, experiment 2, opinion 1: twice the protection threshold",
            derived=of_threshold(2.0),
        ),
    ]
    ramp: Annotated[
        float,
        about(
            "how much nearer than the distance a surface must be to push at full speed",
            ge=0.02,
            le=20.0,
            unit="m",
            source="ours: 0.6 times the protection threshold",
            derived=of_threshold(0.6),
        ),
    ]
    spacing: Annotated[
        float,
        about(
            "distance to obstacles, from the axle, that no motion may go below",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 1.2 times the protection threshold plus the lidar's offset",
            derived=_spacing,
        ),
    ]


class Dispersion(FieldPattern[DispersionParams]):
    """Drives away from everything nearer than a distance, and rests where nothing is."""

    group = "spread"
    params_type = DispersionParams
    field_kind = "repulsion"
    is_symmetric = True

    def __init__(self, params: DispersionParams, context: Context) -> None:
        _check(params, context.platform)
        super().__init__(params, context)
        self.state = "settled"
        self._scan: Scan | None = None
        self._points = NearPoints(())
        self._vector = (0.0, 0.0)

    def update(self, params: DispersionParams) -> None:
        """Apply changed parameters; ConfigError if protection forbids the distance."""
        _check(params, self.context.platform)
        super().update(params)
        self._scan = None

    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """Follow the push of the surfaces; its state is spread or settled."""
        params = self.params
        if scan is not self._scan:
            self._scan = scan
            (self._points, self._vector) = self._look(scan)
        x, y = self._vector
        limit = _START_PUSH if self.state == "settled" else _STOP_PUSH
        self.state = "settled" if math.hypot(x, y) <= limit else "spread"
        if self.state == "settled":
            return ZERO
        return self._points.steer(
            x,
            y,
            params.speed,
            params.turn,
            spacing=params.spacing,
            brake=params.ramp,
            may_back=True,
        )

    def _look(self, scan: Scan) -> tuple[NearPoints, tuple[float, float]]:
        """The near points of a scan, and the vector along which they push."""
        params = self.params
        offset = self.context.platform.scan.offset
        # From the axle, so that a turn in place, which moves the lidar, changes nothing. A surface
        # whose push is too small to start must not be nearer than the distance.
        distance = params.distance + math.hypot(*offset) + _START_PUSH * params.ramp
        reach = max(distance, params.spacing + params.ramp) + math.hypot(*offset)
        polar = polar_from_base(closest_points(scan, within=reach).tolist(), offset)
        points = NearPoints(polar)
        push = self._push(polar, distance)
        return points, points.keep_clear(*push, spacing=params.spacing, brake=params.ramp)

    def _push(self, points: Sequence[tuple[float, float]], distance: float) -> tuple[float, float]:
        """The sum of the pushes of all surfaces nearer than `distance`: a vector, at most 1 long.

        In a confined space all surfaces push hard, and only the differences of the pushes count.
        """
        weights = [max((distance - near) / self.params.ramp, 0.0) for near, _ in points]
        most = max([1.0, *weights])
        x = 0.0
        y = 0.0
        for weight, (_, bearing) in zip(weights, points, strict=True):
            x -= weight / most * math.cos(bearing)
            y -= weight / most * math.sin(bearing)
        length = max(1.0, math.hypot(x, y))
        return x / length, y / length


def _spacing(platform: Platform) -> float:
    return 1.2 * threshold(platform) + math.hypot(*platform.scan.offset)


def _check(params: DispersionParams, platform: Platform) -> None:
    if params.distance <= threshold(platform):
        least = f"{threshold(platform):g} m"
        raise ConfigError(
            f"parameter distance is {params.distance:g} m; expected more than {least}, "
            f"the distance that the protection of {platform.name} keeps"
        )

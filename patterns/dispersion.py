"""Dispersion: the robots spread until nothing is nearer than a distance.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "dispersion", and its code ROS2swarm: a
repulsive potential field, always at full speed.

Law "settling" is ours. Each surface, robot or wall, pushes with its nearest point, the stronger the
nearer it is. The robot comes to rest where the pushes cancel, so it also comes to rest where there
is no room for the distance.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from swarmd.api import (
    ZERO,
    Array,
    ConfigError,
    Context,
    FieldParams,
    FieldPattern,
    Inputs,
    Platform,
    Scan,
    Twist,
    about,
    closest_points,
    from_base,
    keep_clear,
    of_threshold,
    steer,
    threshold,
)

# Push, as a share of full speed, below which a moving robot stops and above which it starts.
_STOP_PUSH, _START_PUSH = 0.12, 0.25


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
            ge=0.05,
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

    params_type = DispersionParams
    field_kind = "repulsion"
    is_symmetric = True

    def __init__(self, params: DispersionParams, context: Context) -> None:
        _check(params, context.platform)
        super().__init__(params, context)
        self.state = "settled"

    def update(self, params: DispersionParams) -> None:
        """Apply changed parameters; ConfigError if protection forbids the distance."""
        _check(params, self.context.platform)
        super().update(params)

    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """Follow the push of the surfaces; its state is spread or settled."""
        params = self.params
        offset = self.context.platform.scan.offset
        # From the axle, so that a turn in place, which moves the lidar, changes nothing. A surface
        # whose push is too small to start must not be nearer than the distance.
        distance = params.distance + math.hypot(*offset) + _START_PUSH * params.ramp
        reach = max(distance, params.spacing + params.ramp) + math.hypot(*offset)
        points = from_base(closest_points(scan, within=reach), offset)
        push = self._push(points, distance)
        vector = keep_clear(push, points, spacing=params.spacing, brake=params.ramp)
        limit = _START_PUSH if self.state == "settled" else _STOP_PUSH
        self.state = "settled" if math.hypot(*vector) <= limit else "spread"
        if self.state == "settled":
            return ZERO
        return steer(
            vector,
            params.speed,
            params.turn,
            points=points,
            spacing=params.spacing,
            brake=params.ramp,
            may_back=True,
        )

    def _push(self, points: Array, distance: float) -> Array:
        """The sum over the surfaces nearer than `distance`; at most 1 long.

        In a confined space, where all push hard, only their differences count.
        """
        weights = np.clip((distance - points[:, 0]) / self.params.ramp, 0.0, None)
        weights /= max(1.0, float(weights.max(initial=0.0)))
        x = -float(weights @ np.cos(points[:, 1]))
        y = -float(weights @ np.sin(points[:, 1]))
        return np.array([x, y]) / max(1.0, math.hypot(x, y))


def _spacing(platform: Platform) -> float:
    return 1.2 * threshold(platform) + math.hypot(*platform.scan.offset)


def _check(params: DispersionParams, platform: Platform) -> None:
    if params.distance <= threshold(platform):
        least = f"{threshold(platform):g} m"
        raise ConfigError(
            f"parameter distance is {params.distance:g} m; expected more than {least}, "
            f"the distance that the protection of {platform.name} keeps"
        )

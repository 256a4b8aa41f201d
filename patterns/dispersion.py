"""Dispersion: the robots spread until nothing is nearer than a distance.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "dispersion", and its code ROS2swarm: a
repulsive potential field, always at full speed.

Law "settling" is ours. Each surface, robot or wall, pushes with its nearest point, the stronger the
nearer it is. The robot stands where the pushes cancel, so that it also comes to rest where there is
no room for the distance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np

from swarmd.api import (
    ZERO,
    Array,
    ConfigError,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Platform,
    Recovery,
    Scalar,
    Scan,
    TopSpeed,
    TopTurn,
    Twist,
    Value,
    about,
    closest_points,
    field_twist,
    from_base,
    keep_clear,
    potential_field,
    steer,
)

# Push, as a share of full speed, below which a moving robot stops and above which it starts.
_STOP_PUSH, _START_PUSH = 0.12, 0.25


class DispersionParams(Params, frozen=True):
    """The law, speeds and distances; those of law "paper" come last."""

    law: Annotated[
        Literal["settling", "paper"],
        about(
            "settling: comes to rest; paper: the original equations",
            source="ours: the original drives at full speed forever",
        ),
    ] = "settling"
    speed: TopSpeed = 0.2
    turn: TopTurn = 1.82
    distance: Annotated[
        float,
        about(
            "distance to keep free all around, also to walls; more than the protection threshold",
            ge=0.05,
            le=100.0,
            unit="m",
            source="paper, experiment 2, opinion 1: twice the protection threshold",
        ),
    ] = 1.0
    ramp: Annotated[
        float,
        about(
            "how much nearer than the distance a surface must be to push at full speed",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 0.6 times the protection threshold",
        ),
    ] = 0.3
    spacing: Annotated[
        float,
        about(
            "distance to obstacles, from the axle, that no motion may go below",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 1.2 times the protection threshold plus the lidar's offset",
        ),
    ] = 0.6
    paper_range: Annotated[
        float,
        about(
            "law paper: reach of the field",
            ge=0.1,
            le=100.0,
            unit="m",
            source="ROS2swarm: the range of the lidar",
        ),
    ] = 3.5
    bias: Annotated[
        float, about("law paper: forward bias", ge=-100.0, le=100.0, source="ROS2swarm")
    ] = 1.0
    rays: Annotated[
        int,
        about(
            "law paper: alone if at most so many rays return", ge=0, le=10000, source="ROS2swarm"
        ),
    ] = 1
    linear_if_alone: Annotated[
        float,
        about(
            "law paper: speed if alone", ge=-2.0, le=2.0, unit="m/s", source="ROS2swarm 1.0: stop"
        ),
    ] = 0.0
    angular_if_alone: Annotated[
        float,
        about(
            "law paper: turn rate if alone",
            ge=-4.0,
            le=4.0,
            unit="rad/s",
            source="ROS2swarm 1.0: stop",
        ),
    ] = 0.0
    recovery: Recovery = False


class Dispersion(MovementPattern[DispersionParams]):
    """Drives away from everything nearer than a distance, and stands where nothing is."""

    params_type = DispersionParams
    is_symmetric = True

    def __init__(self, params: DispersionParams, context: Context) -> None:
        _check(params, context.platform)
        super().__init__(params, context)
        self._is_settled = True

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """Speeds from the limits, distances from the protection."""
        threshold = float(platform.protection["threshold"])
        return {
            "speed": min(platform.limits.linear, 0.5),
            "turn": min(platform.limits.angular, 4.0),
            "distance": 2.0 * threshold,
            "ramp": 0.6 * threshold,
            "spacing": 1.2 * threshold + math.hypot(*platform.scan.offset),
            "paper_range": platform.scan.range_max,
        }

    def update(self, params: DispersionParams) -> None:
        """Apply changed parameters; ConfigError if protection forbids the distance."""
        _check(params, self.context.platform)
        super().update(params)

    def report(self) -> Mapping[str, Scalar]:
        """Its state: spread or settled."""
        if self.params.law == "paper":
            return {"state": "paper"}
        return {"state": "settled" if self._is_settled else "spread"}

    def drive(self, inputs: Inputs) -> Twist:
        """The command from the latest scan."""
        if inputs.scan is None:
            return ZERO
        if self.params.law == "paper":
            return self._follow_field(inputs.scan)
        return self._settle(inputs.scan)

    def _follow_field(self, scan: Scan) -> Twist:
        params = self.params
        field = potential_field(
            scan.ranges,
            scan.bearings,
            range_max=params.paper_range,
            range_min=scan.range_min,
            bias=params.bias,
            ray_threshold=params.rays,
            kind="repulsion",
            ignore_near=True,
        )
        if field.is_alone:
            return Twist(linear=params.linear_if_alone, angular=params.angular_if_alone)
        return field_twist(field.vector, params.speed, params.turn)

    def _settle(self, scan: Scan) -> Twist:
        params = self.params
        offset = self.context.platform.scan.offset
        # From the axle, so that a turn in place, which moves the lidar, changes nothing. A surface
        # whose push is too small to start must not be nearer than the distance.
        distance = params.distance + math.hypot(*offset) + _START_PUSH * params.ramp
        reach = max(distance, params.spacing + params.ramp) + math.hypot(*offset)
        points = from_base(closest_points(scan, within=reach), offset)
        push = self._push(points, distance)
        vector = keep_clear(push, points, spacing=params.spacing, brake=params.ramp)
        self._is_settled = math.hypot(*vector) <= (_START_PUSH if self._is_settled else _STOP_PUSH)
        if self._is_settled:
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


def _check(params: DispersionParams, platform: Platform) -> None:
    threshold = float(platform.protection["threshold"])
    if params.distance <= threshold:
        raise ConfigError(
            f"parameter distance is {params.distance:g} m; wanted more than {threshold:g} m, "
            f"the distance that the protection of {platform.name} keeps"
        )

"""Wall following: the robot keeps a wall on one side at a distance, around corners of both kinds.

Source: Mataric, "Integration of representation into goal-driven behavior-based robots", IEEE
Transactions on Robotics and Automation 8, 1992: boundary following from a few rules on ranges.
Ours: one law for straight walls, inner and outer corners. The robot steers along the tangent of the
nearest surface on its side, turned towards or away from it by the error of the distance.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from swarmd.api import (
    Context,
    Inputs,
    NearPoints,
    Params,
    TimedPattern,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    closest_points,
    nearest,
    of_threshold,
    polar_from_base,
    turn_time,
)

# The sector in which the wall is looked for, from the side of the wall: 65 degrees ahead of the
# side, for inner corners, and 65 degrees behind it, for outer ones.
_HALF_WIDTH = math.radians(65.0)
# The largest angle between heading and tangent, on the way to a wall or away from it.
_MAX_APPROACH = math.radians(50.0)
_BRAKE = 0.3  # m before `spacing` over which the speed towards an obstacle falls to zero
_LEAST = 0.1  # m: a smaller `distance` counts as that where it divides
_MEMORY = 0.3  # s for which the wall counts as seen, longer than between two scans
_SPACING_SHARE = 0.7  # of `distance`: obstacles ahead that are nearer slow the robot down


class FollowWallParams(Params, frozen=True, kw_only=True):
    """The side, the distances and the motion."""

    side: Annotated[
        Literal["left", "right"],
        about("on which side of the robot the wall is", source="Mataric 1992: either"),
    ] = "left"
    distance: Annotated[
        float,
        about(
            "keeps this distance between axle and wall",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: the protection threshold",
            derived=of_threshold(1.0),
        ),
    ]
    reach: Annotated[
        float,
        about(
            "drives straight ahead where no surface on that side is nearer",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: twice the protection threshold",
            derived=of_threshold(2.0),
        ),
    ]
    speed: TopSpeed
    turn: TopTurn


class FollowWall(TimedPattern[FollowWallParams]):
    """Drives along the nearest surface on its side, around its end, and else straight ahead."""

    group = "search"
    params_type = FollowWallParams
    needs = frozenset({"scan"})
    default_state = "search"

    def __init__(self, params: FollowWallParams, context: Context) -> None:
        super().__init__(params, context)
        self._side = 1.0 if params.side == "left" else -1.0
        # Around the end of a wall: a circle of radius `distance`, for three quarters of a turn.
        self._around = min(params.turn, params.speed / max(params.distance, _LEAST))

    def drive(self, inputs: Inputs) -> Twist:
        """The command along the wall; around its end where it is lost, then straight ahead."""
        params = self.params
        side = self._side
        scan = inputs.scan
        offset = self.context.platform.scan.offset
        ray = nearest(scan, bearing=side * math.pi / 2.0, half_width=_HALF_WIDTH)
        if ray is not None and ray.range <= params.reach:
            ((distance, bearing),) = polar_from_base([[ray.range, ray.bearing]], offset)
            error = (distance - params.distance) / max(params.distance, _LEAST)
            tangent = bearing - side * math.pi / 2.0
            heading = tangent + side * max(-1.0, min(1.0, error)) * _MAX_APPROACH
            around = turn_time(1.5 * math.pi, self._around)
            self.begin(inputs.now, follow=_MEMORY, around=around)
        elif self.state(inputs.now) != "search":
            return Twist(self._around * params.distance, side * self._around)
        else:
            heading = 0.0
        ahead = closest_points(scan, within=params.distance + 1.0).tolist()
        near = NearPoints(polar_from_base(ahead, offset))
        return near.steer(
            math.cos(heading),
            math.sin(heading),
            params.speed,
            params.turn,
            spacing=_SPACING_SHARE * params.distance,
            brake=_BRAKE,
        )

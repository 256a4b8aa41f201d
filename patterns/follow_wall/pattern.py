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
    Params,
    Scan,
    TimedPattern,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    near_points,
    nearest,
    of_threshold,
    polar_from_base,
    turn_time,
)

# The sector in which the wall is looked for, off the heading: from straight ahead, for inner
# corners, to 65 degrees behind the side, for outer ones.
_MIDDLE = _HALF_WIDTH = math.radians(77.5)
# The largest angle between heading and tangent, on the way to a wall or away from it.
_MAX_APPROACH = math.radians(50.0)
_BRAKE = 0.3  # m before `spacing` over which the speed towards an obstacle falls to zero
_MIN_DISTANCE = 0.1  # m: divisor in place of a smaller `distance`
_MEMORY = 0.3  # s for which the wall counts as seen, longer than between two scans
_SPACING_SHARE = 0.7  # of `distance`: obstacles ahead that are nearer slow the robot down
# Of the distance from the wall, where that is less: a robot that was pushed to its wall drives on
# until the wall ahead is the nearest surface. With 0.9 it takes longer, with 1.0 it stands there.
_NEAR_SHARE = 0.85


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
        # 1: the wall is on the left, -1: on the right.
        self._side = 1.0 if params.side == "left" else -1.0
        # Around the end of a wall: a circle of radius `distance`, for three quarters of a turn.
        self._end_turn_rate = min(params.turn, params.speed / max(params.distance, _MIN_DISTANCE))

    def drive(self, inputs: Inputs) -> Twist:
        """The command along the wall at `distance`, slower where an obstacle is near ahead.

        Where the wall ends the robot drives an arc around its end, for three quarters of a turn at
        most. Without a wall after the arc the robot drives straight ahead.
        """
        scan = inputs.scan
        ray = nearest(scan, bearing=self._side * _MIDDLE, half_width=_HALF_WIDTH)
        if ray is not None and ray.range <= self.params.reach:
            # The states `follow`, `around` and the default `search` begin anew with each step that
            # sees the wall. So `around` begins _MEMORY s after the wall has ended.
            around = turn_time(1.5 * math.pi, self._end_turn_rate)
            self.begin(inputs.now, follow=_MEMORY, around=around)
            offset = self.context.platform.scan.offset
            ((distance, bearing),) = polar_from_base([[ray.range, ray.bearing]], offset)
            return self._steer(scan, self._heading(distance, bearing), _NEAR_SHARE * distance)
        if self.state(inputs.now) == "search":
            return self._steer(scan, 0.0, math.inf)
        # No wall: an arc of radius `distance` around its end.
        speed = self._end_turn_rate * self.params.distance
        return Twist(speed, self._side * self._end_turn_rate)

    def _heading(self, distance: float, bearing: float) -> float:
        """The heading in rad in the base frame, along the tangent of the surface at that place.

        The heading is turned to the surface or away from it by the error of the distance.
        """
        wanted = self.params.distance
        error = (distance - wanted) / max(wanted, _MIN_DISTANCE)
        tangent = bearing - self._side * math.pi / 2.0
        return tangent + self._side * max(-1.0, min(1.0, error)) * _MAX_APPROACH

    def _steer(self, scan: Scan | None, heading: float, spacing_max: float) -> Twist:
        """The command along a heading in rad, slower where an obstacle is near ahead.

        `spacing_max`: the robot stands no farther than this before an obstacle, in m.
        """
        params = self.params
        return near_points(
            scan, within=params.distance + 1.0, offset=self.context.platform.scan.offset
        ).steer(
            math.cos(heading),
            math.sin(heading),
            params.speed,
            params.turn,
            spacing=min(_SPACING_SHARE * params.distance, spacing_max),
            brake=_BRAKE,
        )

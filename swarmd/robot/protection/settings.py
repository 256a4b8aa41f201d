"""The settings of the protection modes: the schema of `protection` in a platform file."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.robot.protection.walls.walls_settings import STILL, WallsStand

Length = Annotated[float, Meta(ge=0.0, le=10.0)]
Speed = Annotated[float, Meta(gt=0.0, le=20.0)]
Reserve = Annotated[float, Meta(ge=0.0, le=20.0)]
Braking = Annotated[float, Meta(gt=0.0, le=100.0)]
Mode = Literal["barrier", "potential_field", "stop_zone", "off"]
Avoidance = Literal["orca", "none"]

ODOMETRY_SHARE = 0.05
"""The assumed error of odometry between two poses, as a share of the way and of the turn."""


class PotentialFieldSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `potential_field`."""

    # m from the sensor within which a return repels. Higher: evades earlier, gets less done.
    threshold: Annotated[float, Meta(gt=0.0, le=1000.0)]
    # Number of returns that does not trigger the evasion yet. Higher: ignores thin obstacles.
    # Lower: reacts to noise.
    rays: Annotated[int, Meta(ge=0, le=10_000)]
    # Added along x to the repulsion (no unit). Higher: keeps moving forward, also towards walls.
    forward_bias: Annotated[float, Meta(ge=0.0, le=100.0)]


class BarrierSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `barrier`: assumptions about other objects and about this base."""

    # m/s, fastest surface of any other object. Higher: keeps larger gaps, is slower in a crowd.
    # Lower than the truth: a faster object hits the robot while it still brakes.
    others_speed: Speed
    # m by which objects extend beyond their part in the scan plane. Higher: keeps larger gaps.
    # Lower than the truth: the robot hits the part that the lidar does not see.
    unseen_extent: Length
    # m kept free for range noise. Higher: narrow passages close. Lower: noise leads to contact.
    margin: Length = 0.03
    # m/s2, least deceleration of the base in any direction, sideways included. Higher than the
    # truth: the robot stops too late. Lower: it drives more slowly near every obstacle.
    braking_linear: Braking = 1.0
    # rad/s2, least angular deceleration of the base. As `braking_linear`, for turns.
    braking_angular: Braking = 3.0
    # m/s, fastest corner of this robot near an obstacle; None: `others_speed`. Higher than the
    # `others_speed` of another robot: breaks that robot's assumption. Lower: slower turns.
    surface_speed: Speed | None = None
    # m/s by which a corner passes an obstacle more slowly, since the obstacle may move to where the
    # corner goes; None: 0.3 of `others_speed`. Higher: passes walls more slowly. Lower: an object
    # that steers for the corner can hit it. 0: the robot does not brake before an object at its
    # side is near. While an object approaches by `margin`, the brakes must be able to take off half
    # of `others_speed` less this reserve.
    side_reserve: Reserve | None = None
    # m, radius around the sensor that stays free, for a sensor with a blind zone; None: no circle.
    # Higher: passes fewer gaps. Lower than the blind zone: obstacles enter it unseen.
    keep_out: Length | None = None
    # The assumption that walls which have stood do not begin to move; None: everything may move.
    # Given: passes walls and doors faster. If such a wall moves, it may hit the robot, and the
    # robot may drive into it until its next scan.
    walls_stand: WallsStand | None = None

    @property
    def layers(self) -> dict[str, WallsStand]:
        """The settings of the layers in use, by key."""
        return {} if self.walls_stand is None else {"walls_stand": self.walls_stand}

    @property
    def standing_speed(self) -> float:
        """The m/s at which the place of a standing return may be wrong, for each s of its age.

        Odometry is wrong by ODOMETRY_SHARE of the way of the outline, whose places move at
        `surface_speed` m/s at most. A wall that moves by less than STILL in `seconds` is not
        noticed. The speed is `others_speed` at most. Without `walls_stand` it is `others_speed`.
        """
        if self.walls_stand is None:
            return self.others_speed
        error = ODOMETRY_SHARE * (self.surface_speed or self.others_speed)
        return min(error + STILL / self.walls_stand.seconds, self.others_speed)


SLOW_SHARE = 0.3
"""The share of the requested command that mode `stop_zone` lets through within `slow`."""


class StopZoneSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `stop_zone`."""

    # m from the outline within which the robot stops. Higher: stops farther away, and stays there.
    stop: Length = 0.10
    # m from the outline within which the robot slows down. Higher: slower near walls.
    slow: Length = 0.25

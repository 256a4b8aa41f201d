"""Drive: straight ahead, along a circle, or sideways.

Source: pattern "drive" of Kaiser et al., ICRA 2022 (ROS2swarm).
"""

from __future__ import annotations

from typing import Annotated

from swarmd.api import Inputs, MovementPattern, Params, Twist, about


class DriveParams(Params, frozen=True, kw_only=True):
    """Speeds and turn rate."""

    speed: Annotated[
        float,
        about(
            "speed; negative drives backwards",
            ge=-2.0,
            le=2.0,
            unit="m/s",
            source="ROS2swarm: the platform's limit, 0.5 m/s at most",
            derived=lambda platform: min(platform.limits.linear, 0.5),
        ),
    ]
    turn: Annotated[
        float,
        about(
            "turn rate, counter-clockwise positive",
            ge=-4.0,
            le=4.0,
            unit="rad/s",
            source="ROS2swarm",
        ),
    ] = 0.0
    lateral: Annotated[
        float,
        about(
            "speed to the left, of a base that moves sideways; negative drives to the right",
            ge=-2.0,
            le=2.0,
            unit="m/s",
            source="ours",
        ),
    ] = 0.0


class Drive(MovementPattern[DriveParams]):
    """Drives straight ahead, along a circle or sideways until the run ends.

    The pattern uses no sensor: only protection stops the robot before obstacles.
    """

    group = "move together"
    params_type = DriveParams
    needs = frozenset[str]()
    is_symmetric = True

    def drive(self, inputs: Inputs) -> Twist:
        """The same command at every step."""
        return Twist(self.params.speed, self.params.turn, self.params.lateral)

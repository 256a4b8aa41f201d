"""When a decision is taken, and what the pattern in force may do."""

from __future__ import annotations

from msgspec import Struct

from swarmd.values import Odometry, TouchZone


class Moment(Struct, frozen=True):
    """The time of a decision in s on the robot's clock, and how old what it rests on is then.

    `scan_age` and `odometry_age` in s since they arrived; None: never.
    """

    now: float
    scan_age: float | None = None
    odometry: Odometry | None = None
    odometry_age: float | None = None


class Permit(Struct, frozen=True):
    """What the running pattern may: be helped when it is stuck, and touch things, where granted."""

    may_unstick: bool = False
    touch: TouchZone | None = None


NO_PERMIT = Permit()

"""The inputs and the result of one decision of protection."""

from __future__ import annotations

import math
from enum import Enum

import numpy as np
from msgspec import Struct

from swarmd.core.messages import LimitingObstacle, Reason
from swarmd.core.values import Array, Odometry, TouchZone, Twist


class ToldObstacle(Struct, frozen=True, array_like=True, gc=False):
    """A disc beside those of the lidar scan: a told place of a peer, or a return of the range ring.

    Its centre `x`, `y` in m in the base frame `age` s before the decision, when its place was
    measured; `radius` in m, the error of the place included.
    """

    x: float
    y: float
    radius: float
    age: float


class DecisionContext(Struct, frozen=True, gc=False):
    """The time of a decision in s on the robot's clock, and the age of its inputs at that time.

    `scan_age` and `odometry_age` in s since arrival; None: none has arrived. `scan_delay` in s: how
    much later than the platform's `latency` scans arrive, as measured. `told`: obstacles that
    others tell of. `near`: returns of the platform's ring of range sensors.
    """

    now: float
    scan_age: float | None = None
    odometry: Odometry | None = None
    odometry_age: float | None = None
    scan_delay: float = 0.0
    told: tuple[ToldObstacle, ...] = ()
    near: tuple[ToldObstacle, ...] = ()

    @property
    def near_points(self) -> Array:
        """(k, 2) the returns of the ring, in the base frame in m."""
        return np.array([(disc.x, disc.y) for disc in self.near], np.float64).reshape(-1, 2)


class Permit(Struct, frozen=True):
    """What the running pattern permits: recovery when it is blocked, and contact in `touch`.

    `scan_delay`: s beyond the platform's latency up to which late scans are no hold. Protection
    counts the delay, as it does below the platform's own bound. `avoids`: whether avoidance leads
    the robot; None: as the platform says.
    """

    may_recover: bool = False
    touch: TouchZone | None = None
    scan_delay: float = 0.0
    avoids: bool | None = None


NO_PERMIT = Permit()


class ModeDecision(Struct, frozen=True, gc=False):
    """The command of a mode; `is_active` if it differs from the requested command."""

    twist: Twist
    is_active: bool
    rows: tuple[LimitingObstacle, ...] = ()


class WayState(Enum):
    """The state of right of way before an opening; right_of_way.py has the transitions."""

    NONE = ""  # no opening on the way
    GO = "go"  # drives to the place at which it lines up
    APPROACH = "approach"  # lined up before that place
    LINE = "line"  # lined up, drives into the opening
    WAIT = "wait"  # stands for others
    ASIDE = "aside"  # clears the way of others
    IN = "in"  # in the opening
    BACK = "back"  # backs out


_AT_OPENING = {
    WayState.GO: "drives to an opening",
    WayState.APPROACH: "drives to an opening",
    WayState.LINE: "drives to an opening",
    WayState.WAIT: "gives way at an opening",
    WayState.ASIDE: "gives way at an opening",
    WayState.IN: "passes an opening",
    WayState.BACK: "backs out of an opening",
}


class Avoided(Struct, frozen=True):
    """The object that avoidance leads the robot past, or the opening that the robot is to pass."""

    bearing: float
    """rad, of the middle"""
    distance: float
    """m, from the axle to the middle"""
    way: WayState = WayState.NONE
    """The state before an opening; NONE for an object."""

    @property
    def text(self) -> str:
        """Such as `avoiding an object at -30 deg` or `gives way at an opening, 0.8 m`."""
        if self.way is WayState.NONE:
            return f"avoiding an object at {round(math.degrees(self.bearing))} deg"
        text = _AT_OPENING[self.way]
        is_inside = self.way in (WayState.IN, WayState.BACK)
        return text if is_inside else f"{text}, {self.distance:.1f} m"


class Decision(Struct, frozen=True, gc=False):
    """The safe command with its reasons.

    `requested` is clipped to the platform's limits; the driver gets `safe`. `reason` is the hold
    that zeroed the command, or why a running robot does not move; None while it moves and outside
    `running`. `rows` are the constraints that bind the command, the tightest first. `min_gap` in m
    from the footprint to the nearest return (None: no return), `scan_age` in s (None: no scan yet),
    `scan_seq` -1 without a scan. `is_recovering`: recovery replaced the requested command before
    the mode judged it. `speed_share`: of the command that the mode allows, after a violated
    assumption. `avoided`: avoidance or right of way changed the command to get past it; None if
    neither did.
    """

    mode: str
    requested: Twist
    safe: Twist
    reason: Reason | None
    is_active: bool
    rows: tuple[LimitingObstacle, ...]
    min_gap: float | None
    scan_age: float | None
    scan_seq: int
    is_recovering: bool = False
    speed_share: float = 1.0
    avoided: Avoided | None = None

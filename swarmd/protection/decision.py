"""The inputs and the result of one decision of protection."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct

from swarmd.core.avoided import Avoided
from swarmd.core.messages import LimitingObstacle, Reason
from swarmd.core.values import Array, Odometry, Pose, TouchZone, Twist


class ToldObstacle(Struct, frozen=True, array_like=True, gc=False):
    """A disc in which an obstacle is, known from another source than the lidar scan.

    The source is a peer that shared its place, or a return of the ring of range sensors.
    """

    x: float
    """m, the centre in the base frame at the time at which the place was measured"""
    y: float
    """m, as `x`"""
    radius: float
    """m, the error of the place included"""
    age: float
    """s from the measurement to the decision"""


class Anchor(Struct, frozen=True, array_like=True, gc=False):
    """The pose of the robot in the frame of its fence, at the time of a measured pose."""

    pose: Pose
    """in the shared frame"""
    odometry: Pose
    """by odometry at the same time"""
    error: float
    """m, bound of the error of the place"""
    yaw_error: float
    """rad, bound of the error of the yaw"""
    way: float
    """m driven since then by odometry"""
    turned: float
    """rad turned since then, in both directions"""


class DecisionContext(Struct, frozen=True, gc=False):
    """The time of a decision, and the inputs of protection with their ages at that time."""

    now: float
    """s on the robot's clock"""
    scan_age: float | None = None
    """s since the newest scan arrived; None: no scan has arrived"""
    odometry: Odometry | None = None
    """the newest reading"""
    odometry_age: float | None = None
    """s since this reading arrived; None: no reading has arrived"""
    scan_delay: float = 0.0
    """s by which scans arrive later than the platform's `latency`, as measured"""
    told: tuple[ToldObstacle, ...] = ()
    """places that peers shared"""
    near: tuple[ToldObstacle, ...] = ()
    """returns of the platform's ring of range sensors"""
    anchor: Anchor | None = None
    """the pose in the frame of the fence; None without a fence or without a usable pose"""

    @property
    def near_points(self) -> Array:
        """(k, 2) the returns of the ring, in the base frame in m."""
        return np.array([(disc.x, disc.y) for disc in self.near], np.float64).reshape(-1, 2)


class Clearance(NamedTuple):
    """Free room in m from the axle that a corridor needs."""

    ahead: float
    beside: float  # to each side
    body: float = 0.0  # the part of `beside` that the outline takes


class Permit(Struct, frozen=True):
    """What the running pattern permits steering to do, and protection to allow."""

    may_recover: bool = False
    """recovery may move a blocked robot"""
    touch: TouchZone | None = None
    """directions in which the robot may touch obstacles"""
    scan_delay: float = 0.0
    """s beyond the platform's latency by which scans may be late before the robot is held.
    Protection adds the measured delay to the age of scans."""
    avoids: bool | None = None
    """avoidance may change the command; None: as the platform says"""


NO_PERMIT = Permit()


MOVING_WALL = "moving_wall"
"""How events and the finding about walls that moved begin."""


class MovedWall(Struct, frozen=True, gc=False):
    """A wall that had stood and that the last scans show elsewhere, against `walls_stand`."""

    stood: float
    """s for which the wall had stood"""
    distance: float
    """m that its end which moved farther has moved since the wall was last seen in place"""
    speed: float
    """m/s, the mean since then"""


class ModeDecision(Struct, frozen=True, gc=False):
    """The command of a mode; `is_active` if it differs from the requested command."""

    twist: Twist
    is_active: bool
    rows: tuple[LimitingObstacle, ...] = ()


class Steered(Struct, frozen=True, gc=False):
    """What steering asks in place of a request, and why."""

    twist: Twist
    """the candidate that the mode judges like any request; the request itself: not replaced"""
    is_recovering: bool = False
    """the candidate leads a blocked robot"""
    avoided: Avoided | None = None
    """what the candidate leads past; None: nothing"""


class Decision(Struct, frozen=True, gc=False):
    """The safe command with its reasons."""

    mode: str
    """the protection mode"""
    requested: Twist
    """the command of the pattern, clipped to the platform's limits"""
    safe: Twist
    """the command that the driver gets"""
    reason: Reason | None
    """the hold that zeroed the command, or why a running robot does not move; None while the robot
    moves, and outside `running`"""
    is_active: bool
    """the mode changed the command"""
    rows: tuple[LimitingObstacle, ...]
    """the obstacles whose constraints limit the command, the tightest first"""
    min_gap: float | None
    """m from the footprint to the nearest return; None without a return"""
    scan_age: float | None
    """s; None without a scan"""
    scan_seq: int
    """number of the scan; -1 without a scan"""
    is_recovering: bool = False
    """steering led a blocked robot before the mode judged the command"""
    speed_share: float = 1.0
    """the share of the mode's command that the driver gets; below 1 after a violated assumption"""
    avoided: Avoided | None = None
    """what steering led the robot past; None: nothing"""
    is_fenced: bool = False
    """the fence changed the command"""

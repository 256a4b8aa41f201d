"""The inputs and the result of one decision of protection, and the interface of its layers.

A layer is a folder here, which the settings of a robot add to its mode. All layers are off by
default. A layer acts in one of two ways:

1. It tells the kind of each return of a scan, and so the speed at which the obstacle may approach:
   `ReturnLayer` (obstacles.py), of the mode `barrier`. Its settings are a section of `barrier`.
2. It bounds the command, before and after the mode: `CommandLayer`, which `Protection` calls. Its
   settings are a section of swarm.yaml (`RobotSettings.layers`).

The settings of a layer are what all others know of it (`LayerSettings`): status, `swarmd --check`
and the checks of files ask them by their key.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from msgspec import Struct

from swarmd.core.avoided import Avoided
from swarmd.core.messages import LimitingObstacle, Reason
from swarmd.core.values import Array, Odometry, Pose, SharedPose, TouchZone, Twist


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
    """The pose of the robot in a shared frame, at the time of a measured pose."""

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
    """for layers that bound commands; None without such a layer or without a usable pose"""

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
    speed: float | None = None
    """m/s, the greatest speed of the run, whatever its pattern or steering asks; None: no bound"""


NO_PERMIT = Permit()


class MovedWall(Struct, frozen=True, gc=False):
    """A wall that had stood and that the last scans show elsewhere."""

    stood: float
    """s for which the wall had stood"""
    distance: float
    """m that its end which moved farther has moved since the wall was last seen in place"""
    speed: float
    """m/s, the mean since then"""


class LayerView(Struct, frozen=True):
    """The place of a robot against a layer that bounds commands (`CommandLayer`).

    `clearance`: m from the circle around the outline to the bound; negative if the circle is not
    inside. `error`: m, bound of the error of the clearance.
    """

    clearance: float
    error: float


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
    is_bounded: bool = False
    """a layer changed the command (`CommandLayer`)"""


class LayerSettings(Protocol):
    """The settings of a layer."""

    @property
    def text(self) -> str:
        """The settings in one line of `swarmd --check`."""

    def summary(
        self, findings: tuple[str, ...], view: LayerView | None, is_bounded: bool, pose_text: str
    ) -> Struct:
        """The value of the layer's field of the status.

        Args:
            findings: the assumptions that were found violated.
            view: None without a usable pose, and for a layer that bounds no command.
            is_bounded: a layer changed the last command.
            pose_text: why there is no usable pose; empty with one.
        """


class CommandLayer(Protocol):
    """A bound on commands. Zero is always permitted."""

    def limit(
        self, requested: Twist, context: DecisionContext, command: Twist, *, is_even: bool = False
    ) -> Twist:
        """The permitted command near the request; the request itself if it is permitted."""

    def view(self, context: DecisionContext) -> LayerView | None:
        """The place of the robot against the bound; None without a usable pose."""

    def points(self, context: DecisionContext, within: float) -> Array:
        """(k, 2) points of the bound within `within` m of the axle, in m in the base frame."""


class PoseAnchors(Protocol):
    """What decides which poses in a shared frame a `CommandLayer` may use."""

    @property
    def until(self) -> float:
        """The time until which the robot may drive; -inf without a usable pose; inf if always."""

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading."""

    def on_pose(
        self, pose: SharedPose, at: float, errors: tuple[float, float], odometry_at: float
    ) -> None:
        """Take in the own pose at the time `at`."""

    def anchor(self, now: float) -> Anchor | None:
        """The pose in use with its odometry; None without a fresh pose."""

    def text(self, now: float) -> str:
        """Why there is no anchor; empty with one."""

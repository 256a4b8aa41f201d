"""The assumptions of mode `barrier` about others and about this base, as numbers of the kernel.

Part of the unit of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

import math

from swarmd.core import cython_shadow as cython
from swarmd.core.clock import TICK
from swarmd.core.values import Platform
from swarmd.robot.protection.binding_range import REACTION_TIME, BindingRange
from swarmd.robot.protection.closing_speed import DECISION_PERIOD
from swarmd.robot.protection.settings import BarrierSettings

SIDE_RESERVE = 0.3
"""Default of `side_reserve`, as a share of `others_speed`.

`side_reserve` in m/s lowers the speed at which a corner passes an obstacle. With a share of 0.25 an
attacking robot touched a corner of a Waffle Pi that slid past at 2.6 cm/s, with 0.29 at 1.1 cm/s.
"""
REACTION = REACTION_TIME
"""s from a decision to the first response of the base."""
OTHER = 0
WALL = 1
BARE_WALL = 2
"""The kinds of obstacles: one of which nothing is known, a wall that stands, and a wall that stands
and from which nothing extends farther than `foot` beyond its return."""


@cython.cclass
class Assumptions:
    """The settings of mode `barrier` for one platform, and what follows from them."""

    others_speed: float  # m/s, fastest surface of any other object
    standing_speed: float  # m/s, the same for an obstacle of the kind WALL
    unseen_extent: float  # m by which objects extend beyond their part in the scan plane
    foot: float  # m, the same for an obstacle of the kind BARE_WALL
    margin: float  # m kept free for range noise
    braking_linear: float  # m/s2, least deceleration of the base
    braking_angular: float  # rad/s2
    linear_limit: float  # m/s ahead
    angular_limit: float  # rad/s
    surface_speed: float  # m/s, fastest corner of this robot near an obstacle
    top_surface_speed: float  # m/s, fastest place of this robot's surface anywhere
    has_kinds: bool  # a layer tells kinds of obstacles that are slower than `others_speed`
    side_reserve: float  # m/s by which a corner passes an obstacle more slowly
    keep_out: float  # m around the lidar that stay free; NaN: no circle
    blind_radius: float  # m around the lidar within which an obstacle may hide; 0: nowhere
    fresh_binding_range: float  # m, the binding range of an obstacle of age 0
    envelope_range: float  # m from an obstacle within which `surface_speed` holds
    longest_scan_age: float  # s after the middle of a scan at which a command may act
    may_creep: bool

    def __init__(self, platform: Platform, settings: BarrierSettings) -> None:
        self.others_speed = settings.others_speed
        self.unseen_extent = settings.unseen_extent
        self.margin = settings.margin
        self.braking_linear = settings.braking_linear
        self.braking_angular = settings.braking_angular
        self.linear_limit = platform.limits.linear
        self.angular_limit = platform.limits.angular
        binding = BindingRange(platform, settings, TICK)
        self.surface_speed = binding.surface
        self.top_surface_speed = binding.fastest
        self.standing_speed = settings.standing_speed
        walls = settings.walls_stand
        self.foot = settings.unseen_extent
        if walls is not None and walls.foot is not None:
            self.foot = walls.foot
        self.has_kinds = self.standing_speed < self.others_speed
        self.fresh_binding_range = binding.fresh
        self.longest_scan_age = binding.stale
        self.envelope_range = binding.for_envelope()
        self.keep_out = math.nan if settings.keep_out is None else settings.keep_out
        can_hide = platform.scan.near != "reported" and settings.keep_out is None
        self.blind_radius = platform.scan.range_min if can_hide else 0.0
        reserve = settings.side_reserve
        self.side_reserve = SIDE_RESERVE * settings.others_speed if reserve is None else reserve
        # A range ring gives discs: where a disc may touch the robot is too uncertain to creep past.
        self.may_creep = platform.ranges is None and settings.keep_out is None

    def speed_of(self, kind: int) -> float:
        """The m/s at which an obstacle of a kind may approach."""
        return self.others_speed if kind == OTHER else self.standing_speed

    def extent_of(self, kind: int) -> float:
        """The m by which an obstacle of a kind may extend beyond its return."""
        return self.foot if kind == BARE_WALL else self.unseen_extent

    def has_keep_out(self) -> bool:
        """True if a circle around the lidar stays free."""
        return self.keep_out == self.keep_out

    def binding_range(self, age: float) -> float:
        """The gap in m beyond which a return constrains no command of the robot.

        If the platform keeps a circle around the lidar free, a return constrains the robot for two
        reasons: the outline, and the circle. The gap is the greater of the gaps of both.
        BindingRange.for_scan_age computes the same in Python.

        `age`: s, the age of the return when the command takes effect.
        """
        outline_gap = self.fresh_binding_range + (self.others_speed + self.top_surface_speed) * age
        if not self.has_keep_out():
            return outline_gap
        # The room in which two robots can stop by `reciprocal_cap`, each in one half of the room,
        # and the m that this robot moves within `age`.
        speed = self.top_surface_speed
        half_of_approach = speed * (2.0 * DECISION_PERIOD + age + 0.5 * speed / self.braking_linear)
        circle_gap = self.keep_out + 2.0 * half_of_approach + speed * age
        return circle_gap if circle_gap > outline_gap else outline_gap

"""Avoidance: passes moving robots before protection must stop for them.

Avoidance replaces the requested command by a command near it. Recovery and the protection mode then
judge the replacement like any request, so avoidance cannot weaken protection.

The method is optimal reciprocal collision avoidance (ORCA: van den Berg, Guy, Lin and Manocha,
"Reciprocal n-body collision avoidance", ISRR 2009). Each track (a moving object) forbids the
velocities that lead into the object within `_HORIZON` s. The chosen velocity is the permitted one
nearest to the request. A linear programme in two variables finds it (de Berg et al., "Computational
geometry", chapter 4).

A differential base cannot move sideways, but a point ahead of its axle can. The velocity of this
point is linear in the command (feedback linearisation; Snape et al., "Smooth and collision-free
navigation for multiple robots under differential-drive constraints", IROS 2010, call such a point
the effective centre). The distance of the point is chosen so that the angular limit moves the point
as fast as the linear limit moves the base. Then the possible velocities of the point fill a square,
and a request that turns towards a goal points towards the goal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Limits, Twist
from swarmd.protection.recovery import Clearance
from swarmd.protection.tracks import Surroundings, Track

if TYPE_CHECKING:
    from swarmd.protection.velocity_obstacles import (
        most_violated,
        nearest,
        track_lines,
        wall_lines,
        width_between,
    )
else:
    _kernel = load_kernel("swarmd.protection.velocity_obstacles")
    most_violated, nearest = _kernel.most_violated, _kernel.nearest
    track_lines, wall_lines = _kernel.track_lines, _kernel.wall_lines
    width_between = _kernel.width_between

_HORIZON = 1.8  # s within which a track is met
_WALL_HORIZON = 0.8  # s, for walls: protection slows the robot beside them anyway
_WALL_SLACK = 0.06  # m less than the clearance of a corridor, so that a robot drives along a wall
_SHARE = 0.5  # of the change of velocity that the robot makes, if the object avoids, too
_STANDS = 0.04  # m/s: a slower object does not avoid, so the robot makes the whole change
_SIDE = 0.35  # rad to the right by which the request is turned if a track is in its way
_WAIT = 1.0  # s for which a robot that is held up waits for others to pass
_PATIENCE = 0.25  # rad/s by which the angle to the right then grows
_MOST_SIDE = 1.4  # rad, the greatest angle to the right
_LONGEST_PERIOD, _MOST_HELD = 0.2, 10.0  # s between two calls, and s of being held up, that count
_RECOVERS = 2.0  # s of free motion make up for twice as many s of being held up
_HELD_UP = 0.3  # of the requested speed: with less the robot is held up
_LEAST_SHARE = 0.1  # of the limit: a slower request is no request to drive
_COMFORT = 0.1  # m beyond the clearance of a corridor: a moving object needs more room than a wall
_PASSAGE_REACH = (-0.2, 0.35)  # m ahead of the axle: walls there on both sides are a passage
_PASSAGE_WIDTHS = 1.4  # times the clearance to each side: a wider passage is no passage
_LEAD = (0.05, 0.3)  # m, the bounds of the distance of the point ahead of the axle
_NEAR = 1.0  # m: farther tracks do not explain that the robot is blocked


class Avoidance:
    """Chooses a command that leads past the tracks. Times are in s and come with each call.

    Attributes:
        avoiding: the track that forbids the last request most; None if no track forbids it.
        are_near: True if a track is within `_NEAR` m, and the robot is not in a passage.
    """

    def __init__(self, clearance: Clearance, limits: Limits) -> None:
        self._radius, self._limits = clearance.beside, limits
        self._body = 2.0 * clearance.body  # m, its width
        self._is_holonomic = limits.lateral > 0.0
        lead = limits.linear / limits.angular if limits.angular > 0.0 else _LEAD[1]
        self._lead = 0.0 if self._is_holonomic else min(max(lead, _LEAD[0]), _LEAD[1])
        self._least = _LEAST_SHARE * limits.linear
        self._side, self._at, self._held = _SIDE, -math.inf, 0.0
        self.avoiding: Track | None = None
        self.are_near = False

    def reset(self) -> None:
        """Forget how long the robot has been held up."""
        self._side, self._held, self.avoiding = _SIDE, 0.0, None

    def command(self, requested: Twist, safe: Twist, now: float, around: Surroundings) -> Twist:
        """The command that replaces `requested`; `requested` itself if no object is in its way.

        `safe` is the safe command in force, `around` has the tracks and walls.
        """
        self.avoiding = None
        self.are_near = any(math.hypot(track.x, track.y) < _NEAR for track in around.tracks)
        speed = math.hypot(requested.linear, requested.lateral)
        if speed < self._least:
            return requested
        if not around.tracks or self._is_in_passage(around.walls):
            self.are_near = False
            return requested
        x, y = self._velocity(requested)
        # Without the turn: other robots track the axle, which a turn does not move.
        own = safe.linear, safe.lateral
        # A wall beyond `reach` forbids no velocity within the limits.
        beside = self._radius - _WALL_SLACK
        reach = beside + _WALL_HORIZON * self._limits.linear
        lines = wall_lines(around.walls, self._lead, *own, beside, reach, _WALL_HORIZON)
        walls = len(lines)
        wide = self._radius + _COMFORT
        lines += track_lines(around.tracks, self._lead, *own, wide, _SHARE, _STANDS, _HORIZON)
        most = math.hypot(x, y)
        if most_violated(lines, 0, x, y) < 0:
            self._held_up(now, 1.0)
            return requested
        # Some line forbids the request: turn the request to the right if it is that of a track.
        met = most_violated(lines, walls, x, y)
        self.avoiding = around.tracks[met - walls] if met >= 0 else None
        side = self._side if self.avoiding is not None else self._side - _SIDE
        cos, sin = math.cos(side), -math.sin(side)
        chosen = nearest(lines, walls, cos * x - sin * y, sin * x + cos * y, most)
        self._held_up(now, (chosen[0] * x + chosen[1] * y) / (most * most))
        return self._twist(chosen, requested)

    def _is_in_passage(self, walls: Array) -> bool:
        """True between walls that leave no room to go aside, where recovery keeps the middle."""
        widest = _PASSAGE_WIDTHS * self._radius
        width: float = width_between(walls, *_PASSAGE_REACH, widest)
        return self._body < width < 2.0 * widest

    def _held_up(self, now: float, share: float) -> None:
        """Update `_held`, the s for which the robot has been held up, and the angle `_side`.

        `share` is the share of the requested speed at which the robot may move.
        """
        seconds = min(max(now - self._at, 0.0), _LONGEST_PERIOD)
        self._at = now
        change = seconds if share < _HELD_UP else -_RECOVERS * seconds
        self._held = min(max(self._held + change, 0.0), _MOST_HELD)
        self._side = min(_SIDE + _PATIENCE * max(self._held - _WAIT, 0.0), _MOST_SIDE)

    def _velocity(self, twist: Twist) -> tuple[float, float]:
        """The velocity in m/s of the point ahead of the axle."""
        return twist.linear, twist.lateral + self._lead * twist.angular

    def _twist(self, velocity: tuple[float, float], requested: Twist) -> Twist:
        x, y = velocity
        if self._is_holonomic:
            return Twist(x, requested.angular, y)
        return Twist(x, y / self._lead)

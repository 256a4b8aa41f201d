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
from swarmd.protection.decision import Clearance
from swarmd.steering.tracks import Surroundings, Track

if TYPE_CHECKING:
    from swarmd.steering.velocity_obstacles import (
        most_violated,
        nearest,
        track_lines,
        wall_lines,
        width_between,
    )
else:
    _kernel = load_kernel("swarmd.steering.velocity_obstacles")
    most_violated, nearest = _kernel.most_violated, _kernel.nearest
    track_lines, wall_lines = _kernel.track_lines, _kernel.wall_lines
    width_between = _kernel.width_between

_HORIZON = 1.8  # s within which a track is met
_WALL_HORIZON = 0.8  # s, for walls: protection slows the robot beside them anyway
_WALL_SLACK = 0.06  # m less than the clearance of a corridor, so that a robot drives along a wall
_SHARE = 0.5  # of the change of velocity that the robot makes, if the object avoids, too
_STANDING = 0.04  # m/s: a slower object does not avoid, so the robot makes the whole change
_RIGHT_RAD = 0.35  # rad to the right by which the request is turned if a track is in its way
_WAIT_TIME = 1.0  # s for which a robot that is held up waits for others to pass
_RIGHT_TURN_RATE = 0.25  # rad/s by which the angle to the right then grows
_MAX_RIGHT_RAD = 1.4  # rad, the greatest angle to the right
_LONGEST_PERIOD, _MAX_HELD_TIME = 0.2, 10.0  # s between two calls, and s held up, that count
_RECOVERS = 2.0  # s of free motion make up for twice as many s of being held up
_HELD_UP_SHARE = 0.3  # of the requested speed: with less the robot is held up
_MIN_REQUEST_SHARE = 0.1  # of the limit: a slower request is no request to drive
_COMFORT = 0.1  # m beyond the clearance of a corridor: a moving object needs more room than a wall
_PASSAGE_REACH = (-0.2, 0.35)  # m ahead of the axle: walls there on both sides are a passage
_PASSAGE_WIDTHS = 1.4  # times the clearance to each side: a wider passage is no passage
_LEAD = (0.05, 0.3)  # m, the bounds of the distance of the point ahead of the axle
_NEAR_DISTANCE = 1.0  # m: farther tracks do not explain that the robot is blocked


class Avoidance:
    """Chooses a command that leads past the tracks. Times are in s and come with each call.

    Attributes:
        avoiding: the track that forbids the last request most; None if no track forbids it.
        are_near: True if a track is within `_NEAR_DISTANCE` m, and the robot is not in a passage.
    """

    def __init__(self, clearance: Clearance, limits: Limits) -> None:
        self._radius, self._limits = clearance.beside, limits
        self._width = 2.0 * clearance.body  # m
        self._is_holonomic = limits.lateral > 0.0
        lead = limits.linear / limits.angular if limits.angular > 0.0 else _LEAD[1]
        self._lead = 0.0 if self._is_holonomic else min(max(lead, _LEAD[0]), _LEAD[1])
        self._min_request = _MIN_REQUEST_SHARE * limits.linear
        self._right_rad, self._last_call_at, self._held_s = _RIGHT_RAD, -math.inf, 0.0
        self.avoiding: Track | None = None
        self.are_near = False

    def reset(self) -> None:
        """Forget how long the robot has been held up."""
        self._right_rad, self._held_s, self.avoiding = _RIGHT_RAD, 0.0, None

    def command(
        self, requested: Twist, safe: Twist, now: float, surroundings: Surroundings
    ) -> Twist:
        """The command that replaces `requested`; `requested` itself if no object is in its way.

        A line forbids a half-plane of velocities (see the module). The lines of walls come first,
        then one line for each track. Sets `avoiding` and `are_near`.

        `requested`: the command of the pattern. `safe`: the safe command in force. `now`: s.
        `surroundings`: the tracks and the points of walls, in m in the base frame.
        """
        self.avoiding = None
        self.are_near = any(
            math.hypot(track.x, track.y) < _NEAR_DISTANCE for track in surroundings.tracks
        )

        # 1. A request that hardly drives, or a passage: avoidance has nothing to do.
        speed = math.hypot(requested.linear, requested.lateral)
        if speed < self._min_request:
            return requested
        if not surroundings.tracks or self._is_in_passage(surroundings.walls):
            self.are_near = False
            return requested

        # 2. The lines of walls and tracks, for the velocity of the point ahead of the axle.
        x, y = self._velocity(requested)
        # Without the turn: other robots track the axle, which a turn does not move.
        velocity = safe.linear, safe.lateral
        # A wall beyond `reach` forbids no velocity within the limits.
        distance = self._radius - _WALL_SLACK
        reach = distance + _WALL_HORIZON * self._limits.linear
        lines = wall_lines(
            surroundings.walls, self._lead, *velocity, distance, reach, _WALL_HORIZON
        )
        wall_count = len(lines)
        radius = self._radius + _COMFORT
        lines += track_lines(
            surroundings.tracks, self._lead, *velocity, radius, _SHARE, _STANDING, _HORIZON
        )

        # 3. The request, if no line forbids it.
        request_speed = math.hypot(x, y)
        if most_violated(lines, 0, x, y) < 0:
            self._update_held_up(now, 1.0)  # all of the request is permitted
            return requested

        # 4. Else the permitted velocity nearest to the request, which is first turned to the right:
        # by `_right_rad`, that is _RIGHT_RAD and more for a robot that has been held up for long.
        # If walls alone forbid the request, _RIGHT_RAD does not count.
        worst_line = most_violated(lines, wall_count, x, y)
        self.avoiding = surroundings.tracks[worst_line - wall_count] if worst_line >= 0 else None
        right_rad = self._right_rad
        if self.avoiding is None:
            right_rad -= _RIGHT_RAD
        cos, sin = math.cos(right_rad), -math.sin(right_rad)
        chosen = nearest(lines, wall_count, cos * x - sin * y, sin * x + cos * y, request_speed)
        self._update_held_up(now, (chosen[0] * x + chosen[1] * y) / (request_speed * request_speed))
        return self._twist(chosen, requested)

    def _is_in_passage(self, walls: Array) -> bool:
        """True between walls that leave no room to go aside, where recovery keeps the middle."""
        widest = _PASSAGE_WIDTHS * self._radius
        width: float = width_between(walls, *_PASSAGE_REACH, widest)
        return self._width < width < 2.0 * widest

    def _update_held_up(self, now: float, share: float) -> None:
        """Update `_held_s`, how long the robot has been held up, and the angle `_right_rad`.

        `share` is the share of the requested speed at which the robot may move.
        """
        seconds = min(max(now - self._last_call_at, 0.0), _LONGEST_PERIOD)
        self._last_call_at = now
        change = seconds if share < _HELD_UP_SHARE else -_RECOVERS * seconds
        self._held_s = min(max(self._held_s + change, 0.0), _MAX_HELD_TIME)
        self._right_rad = min(
            _RIGHT_RAD + _RIGHT_TURN_RATE * max(self._held_s - _WAIT_TIME, 0.0), _MAX_RIGHT_RAD
        )

    def _velocity(self, twist: Twist) -> tuple[float, float]:
        """The velocity in m/s of the point ahead of the axle."""
        return twist.linear, twist.lateral + self._lead * twist.angular

    def _twist(self, velocity: tuple[float, float], requested: Twist) -> Twist:
        x, y = velocity
        if self._is_holonomic:
            return Twist(x, requested.angular, y)
        return Twist(x, y / self._lead)

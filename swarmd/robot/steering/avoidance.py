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

A kernel (see `core/kernels.py`), since each decision passes it.
"""

from __future__ import annotations

import math

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY, cos, hypot, sin
from swarmd.core.values import Array, Limits, Twist
from swarmd.robot.protection.decision import Clearance
from swarmd.robot.steering.tracks import Surroundings, Track
from swarmd.robot.steering.velocity_obstacles import (
    Line,
    most_violated,
    nearest,
    passage_between,
    track_lines,
    wall_lines,
)

# s within which a track is met
_HORIZON = 1.8
# s, for walls: protection slows the robot beside them anyway
_WALL_HORIZON = 0.8
# m less than the clearance of a corridor, so that a robot drives along a wall
_WALL_SLACK = 0.06
# Share of the change of velocity that the robot makes, if the object avoids, too.
_SHARE = 0.5
# m/s: a slower object does not avoid, so the robot makes the whole change
_STANDING = 0.04
# rad to the right by which the request is turned if a track is in its way
_RIGHT_RAD = 0.35
# s for which a robot that is held up waits for others to pass
_WAIT_TIME = 1.0
# rad/s by which the angle to the right then grows
_RIGHT_TURN_RATE = 0.25
_MAX_RIGHT_RAD = 1.4  # rad, the greatest angle to the right
# s between two calls, and s held up, that count
_LONGEST_PERIOD = 0.2
_MAX_HELD_TIME = 10.0
# s of free motion make up for twice as many s of being held up
_RECOVERS = 2.0
# Share of the requested speed: with less the robot is held up.
_HELD_UP_SHARE = 0.3
_MIN_REQUEST_SHARE = 0.1  # of the limit: a slower request is no request to drive
# m beyond the clearance of a corridor: a moving object needs more room than a wall
_COMFORT = 0.1
# m ahead of the axle: walls there on both sides are a passage
_PASSAGE_FROM = -0.2
_PASSAGE_TO = 0.35
PASSAGE_WIDTHS = 1.4
"""Times the clearance to each side: a wider passage is no passage."""
_LEAD = (0.05, 0.3)  # m, the bounds of the distance of the point ahead of the axle
# m; farther tracks do not explain that the robot is blocked
_NEAR_DISTANCE = 1.0


@cython.cclass
class Avoidance:
    """Chooses a command that leads past the tracks. Times are in s and come with each call.

    Attributes:
        avoiding: the track that forbids the last request most; None if no track forbids it.
        are_near: True if a track is within `_NEAR_DISTANCE` m, and the robot is not in a passage.
    """

    avoiding: Track | None
    are_near: bool
    _radius: float  # m, the clearance of a corridor to each side
    _width: float  # m
    _reach: float  # m: a wall beyond forbids no velocity within the limits
    _is_holonomic: bool
    _lead: float  # m from the axle to the point ahead
    _min_request: float  # m/s
    _right_rad: float
    _last_call_at: float  # s
    _held_s: float

    def __init__(self, clearance: Clearance, limits: Limits) -> None:
        self._radius = clearance.beside
        self._width = 2.0 * clearance.body
        self._reach = self._radius - _WALL_SLACK + _WALL_HORIZON * limits.linear
        self._is_holonomic = limits.lateral > 0.0
        lead = limits.linear / limits.angular if limits.angular > 0.0 else _LEAD[1]
        self._lead = 0.0 if self._is_holonomic else min(max(lead, _LEAD[0]), _LEAD[1])
        self._min_request = _MIN_REQUEST_SHARE * limits.linear
        self._right_rad = _RIGHT_RAD
        self._last_call_at = -INFINITY

    def reset(self) -> None:
        """Forget how long the robot has been held up."""
        self._right_rad = _RIGHT_RAD
        self._held_s = 0.0
        self.avoiding = None

    def command(
        self, requested: Twist, safe: Twist, now: float, surroundings: Surroundings
    ) -> Twist:
        """The command that replaces `requested`; `requested` itself if no object is in its way.

        A line forbids a half-plane of velocities (see the module). The lines of walls come first,
        then one line for each track. Sets `avoiding` and `are_near`.

        `requested`: the command of the pattern. `safe`: the safe command in force. `now`: s.
        `surroundings`: the tracks and the points of walls, in m in the base frame.
        """
        tracks: tuple[Track, ...] = surroundings.tracks
        self.avoiding = None
        track: Track
        self.are_near = False
        for track in tracks:
            self.are_near |= hypot(track.x, track.y) < _NEAR_DISTANCE

        # 1. A request that hardly drives, or a passage: avoidance has nothing to do.
        if hypot(requested.linear, requested.lateral) < self._min_request:
            return requested
        if not tracks or self._is_in_passage(surroundings.walls):
            self.are_near = False
            return requested

        # 2. The lines of walls and tracks, for the velocity (x, y) of the point ahead of the axle.
        x = requested.linear
        y = requested.lateral + self._lead * requested.angular
        # Without the turn: other robots track the axle, which a turn does not move.
        vx = safe.linear
        vy = safe.lateral
        lines: list[Line] = wall_lines(
            surroundings.walls,
            self._lead,
            vx,
            vy,
            self._radius - _WALL_SLACK,
            self._reach,
            _WALL_HORIZON,
        )
        wall_count = len(lines)
        lines += track_lines(
            tracks, self._lead, vx, vy, self._radius + _COMFORT, _SHARE, _STANDING, _HORIZON
        )

        # 3. The request, if no line forbids it.
        if most_violated(lines, 0, x, y) < 0:
            self._update_held_up(now, 1.0)  # all of the request is permitted
            return requested

        # 4. Else the permitted velocity nearest to the request, which is first turned to the right:
        # by `_right_rad`, that is _RIGHT_RAD and more for a robot that has been held up for long.
        # If walls alone forbid the request, _RIGHT_RAD does not count.
        worst_line = most_violated(lines, wall_count, x, y)
        right_rad = self._right_rad
        if worst_line >= 0:
            self.avoiding = tracks[worst_line - wall_count]
        else:
            right_rad -= _RIGHT_RAD
        c = cos(right_rad)
        s = -sin(right_rad)
        speed = math.hypot(x, y)
        chosen_x, chosen_y = nearest(lines, wall_count, c * x - s * y, s * x + c * y, speed)
        self._update_held_up(now, (chosen_x * x + chosen_y * y) / (speed * speed))
        if self._is_holonomic:
            return Twist(chosen_x, requested.angular, chosen_y)
        return Twist(chosen_x, chosen_y / self._lead)

    def _is_in_passage(self, walls: Array) -> bool:
        """True between walls that leave no room to go aside, where recovery keeps the middle."""
        widest = PASSAGE_WIDTHS * self._radius
        width: float = passage_between(walls, _PASSAGE_FROM, _PASSAGE_TO, widest)[0]
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

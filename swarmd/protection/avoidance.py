"""Avoidance: passes moving robots before protection must stop for them.

Avoidance chooses a command near the requested one before recovery and the mode judge it, so that it
cannot weaken protection. Each track forbids the velocities that lead into it within a time (optimal
reciprocal collision avoidance: van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision
avoidance", ISRR 2009); the velocity is the nearest one outside of all, by a linear programme in two
variables (de Berg et al., "Computational geometry", chapter 4).

A differential base has no sideways velocity. A point ahead of its axle has one, which is linear in
the command (feedback linearisation; Snape et al., "Smooth and collision-free navigation for
multiple robots under differential-drive constraints", IROS 2010, have such an effective centre). At
the distance at which the limit of turns moves the point at the limit of the base, its velocities
fill a square, and a pattern's request that turns towards a goal points there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from swarmd.core.values import Array, Limits, Twist
from swarmd.protection.recovery import Clearance
from swarmd.protection.tracks import Surroundings, Track

_HORIZON = 1.8  # s within which a track is met
_WALL_HORIZON = 0.8  # s, for walls: protection slows the robot beside them anyway
_WALL_SLACK = 0.06  # m less than the clearance of a corridor, so that a robot drives along a wall
_SHARE = 0.5  # of the change, for an object that avoids, too
_STANDS = 0.04  # m/s: a slower object changes nothing, so that the robot takes the whole change
_SIDE = 0.35  # rad to the right by which the request is turned where something is in its way
_WAIT = 1.0  # s for which a robot that is held up waits for others to pass
_PATIENCE = 0.25  # rad/s by which the angle then grows
_MOST_SIDE = 1.4  # rad
_HELD_UP = 0.3  # of the requested speed: with less it is held up
_LEAST_SHARE = 0.1  # of the limit: a slower request is no request to drive
_COMFORT = 0.1  # m beyond the clearance of a corridor, as an object that moves needs more room
_PASSAGE_REACH = (-0.2, 0.35)  # m before the axle at which walls on both sides are a passage
_PASSAGE_WIDTHS = 1.4  # times the clearance to each side, at most
_LEAD = (0.05, 0.3)  # m, of the point ahead of the axle
_NEAR = 1.0  # m: others beyond that do not explain that the robot is blocked
_EPSILON = 1e-9


class Line(NamedTuple):
    """Velocities to the left of the direction `dx`, `dy` through the point `x`, `y` are allowed."""

    x: float
    y: float
    dx: float
    dy: float


class Avoidance:
    """Chooses a command that leads past the tracks.

    `avoiding`: the track that the last request would have met first; None if it passed. `are_near`:
    whether there are tracks near the robot. Times are in s and come with each call.
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
        """The command to ask for; `requested` itself if nothing is in its way.

        `safe` is the present command.
        """
        self.avoiding = None
        self.are_near = any(math.hypot(one.x, one.y) < _NEAR for one in around.tracks)
        speed = math.hypot(requested.linear, requested.lateral)
        if speed < self._least:
            return requested
        if not around.tracks or self._is_in_passage(around.walls):
            self.are_near = False
            return requested
        x, y = self._velocity(requested)
        # Without its turn: others see the axle, and a turn that ends goes nowhere.
        own = safe.linear, safe.lateral
        # A farther wall allows any speed of the base.
        beside = self._radius - _WALL_SLACK
        reach = beside + _WALL_HORIZON * self._limits.linear
        lines = [
            _line_of((px, py), own, own, beside, 1.0, _WALL_HORIZON)
            for px, py in (around.walls - (self._lead, 0.0)).tolist()
            if px * px + py * py < reach * reach
        ]
        walls = len(lines)
        lines += [self._line(one, own) for one in around.tracks]
        most = math.hypot(x, y)
        if all(excess(line, x, y) <= 0.0 for line in lines):
            self._held_up(now, 1.0)
            return requested
        meets = [
            (excess(line, x, y), track)
            for line, track in zip(lines[walls:], around.tracks, strict=True)
        ]
        met = max(meets, default=(0.0, None), key=itemgetter(0))
        self.avoiding = met[1] if met[0] > 0.0 else None
        side = self._side if self.avoiding is not None else self._side - _SIDE
        cos, sin = math.cos(side), -math.sin(side)
        chosen = nearest(lines, walls, cos * x - sin * y, sin * x + cos * y, most)
        self._held_up(now, (chosen[0] * x + chosen[1] * y) / (most * most))
        return self._twist(chosen, requested)

    def _is_in_passage(self, walls: Array) -> bool:
        """True between walls that leave no room to go aside, where recovery keeps the middle."""
        (first, last), widest = _PASSAGE_REACH, _PASSAGE_WIDTHS * self._radius
        x, y = walls[:, 0], walls[:, 1]
        near = walls[(x > first) & (x < last) & (np.abs(y) < widest)]
        across = near[near[:, 1] > 0.0][:, None] - near[near[:, 1] <= 0.0]
        width = float(np.hypot(across[..., 0], across[..., 1]).min(initial=math.inf))
        return self._body < width < 2.0 * widest

    def _held_up(self, now: float, share: float) -> None:
        """Note that the robot may move at this share of the requested speed."""
        passed = min(max(now - self._at, 0.0), 0.2)
        self._at = now
        self._held = min(
            max(self._held + (passed if share < _HELD_UP else -2.0 * passed), 0.0), 10.0
        )
        self._side = min(_SIDE + _PATIENCE * max(self._held - _WAIT, 0.0), _MOST_SIDE)

    def _velocity(self, twist: Twist) -> tuple[float, float]:
        """The velocity in m/s of the point ahead of the axle."""
        return twist.linear, twist.lateral + self._lead * twist.angular

    def _twist(self, velocity: tuple[float, float], requested: Twist) -> Twist:
        x, y = velocity
        if self._is_holonomic:
            return Twist(x, requested.angular, y)
        return Twist(x, y / self._lead)

    def _line(self, track: Track, own: tuple[float, float]) -> Line:
        """The velocities that do not lead into a track within the horizon."""
        share = 1.0 if math.hypot(track.vx, track.vy) < _STANDS else _SHARE
        relative = own[0] - track.vx, own[1] - track.vy
        radius = self._radius + _COMFORT + track.radius
        place = track.x - self._lead, track.y
        return _line_of(place, relative, own, radius, share, _HORIZON)


def _line_of(
    place: tuple[float, float],
    relative: tuple[float, float],
    own: tuple[float, float],
    radius: float,
    share: float,
    horizon: float,
) -> Line:
    """The velocities that do not lead nearer to a place than `radius` within `horizon` s.

    `relative` is the present velocity relative to the place, of which `own` changes by a share.
    """
    (px, py), (vx, vy) = place, relative
    square = max(px * px + py * py, _EPSILON)
    # Within that distance the robot may go aside, and need not go away.
    radius = min(radius, max(math.sqrt(square) - 1e-3, 1e-3))
    wx, wy = vx - px / horizon, vy - py / horizon
    length = math.hypot(wx, wy)
    along = wx * px + wy * py
    if along < 0.0 and along * along > radius * radius * length * length:
        nx, ny = wx / max(length, _EPSILON), wy / max(length, _EPSILON)
        off = radius / horizon - length
        dx, dy, ux, uy = ny, -nx, off * nx, off * ny
    else:
        leg = math.sqrt(max(square - radius * radius, 0.0))
        if px * wy - py * wx > 0.0:
            dx, dy = (px * leg - py * radius) / square, (px * radius + py * leg) / square
        else:
            dx, dy = -(px * leg + py * radius) / square, -(py * leg - px * radius) / square
        way = vx * dx + vy * dy
        ux, uy = way * dx - vx, way * dy - vy
    return Line(own[0] + share * ux, own[1] + share * uy, dx, dy)


def excess(line: Line, x: float, y: float) -> float:
    """By how much the velocity violates a line, in m/s; at most 0 if it does not."""
    return line.dx * (line.y - y) - line.dy * (line.x - x)


def nearest(lines: list[Line], fixed: int, x: float, y: float, most: float) -> tuple[float, float]:
    """The velocity nearest to `x`, `y` within all lines and a circle of radius `most`.

    If no velocity keeps all lines: the velocity with the least worst violation of the lines after
    the first `fixed`.
    """
    failed, found = _program(lines, x, y, most, is_direction=False)
    if failed < len(lines):
        found = _least_violation(lines, fixed, failed, found, most)
    return found


def _program(
    lines: list[Line], x: float, y: float, most: float, *, is_direction: bool
) -> tuple[int, tuple[float, float]]:
    """The number of lines that could be kept, and the velocity."""
    if is_direction:
        found = (x * most, y * most)
    else:
        length = math.hypot(x, y)
        found = (x * most / length, y * most / length) if length > most else (x, y)
    for index, line in enumerate(lines):
        if excess(line, *found) > 0.0:
            placed = _on_line(lines[:index], line, x, y, most, is_direction=is_direction)
            if placed is None:
                return index, found
            found = placed
    return len(lines), found


def _on_line(
    before: Iterable[Line], line: Line, x: float, y: float, most: float, *, is_direction: bool
) -> tuple[float, float] | None:
    """The best velocity on a line that keeps the lines before it; None without one."""
    along = line.x * line.dx + line.y * line.dy
    inside = along * along + most * most - line.x * line.x - line.y * line.y
    if inside < 0.0:
        return None
    half = math.sqrt(inside)
    low, high = -along - half, -along + half
    for other in before:
        cross = line.dx * other.dy - line.dy * other.dx
        above = other.dx * (line.y - other.y) - other.dy * (line.x - other.x)
        if abs(cross) <= _EPSILON:
            if above < 0.0:
                return None
            continue
        at = above / cross
        if cross >= 0.0:
            high = min(high, at)
        else:
            low = max(low, at)
        if low > high:
            return None
    if is_direction:
        best = high if x * line.dx + y * line.dy > 0.0 else low
    else:
        best = min(max(line.dx * (x - line.x) + line.dy * (y - line.y), low), high)
    return line.x + best * line.dx, line.y + best * line.dy


def _least_violation(
    lines: list[Line], fixed: int, begin: int, found: tuple[float, float], most: float
) -> tuple[float, float]:
    """The velocity whose worst violation of the lines after `fixed` is least."""
    worst = 0.0
    for index in range(begin, len(lines)):
        line = lines[index]
        if excess(line, *found) <= worst:
            continue
        projected = list(lines[:fixed])
        for other in lines[fixed:index]:
            cross = line.dx * other.dy - line.dy * other.dx
            if abs(cross) <= _EPSILON:
                if line.dx * other.dx + line.dy * other.dy > 0.0:
                    continue
                x, y = 0.5 * (line.x + other.x), 0.5 * (line.y + other.y)
            else:
                at = (other.dx * (line.y - other.y) - other.dy * (line.x - other.x)) / cross
                x, y = line.x + at * line.dx, line.y + at * line.dy
            dx, dy = other.dx - line.dx, other.dy - line.dy
            length = max(math.hypot(dx, dy), _EPSILON)
            projected.append(Line(x, y, dx / length, dy / length))
        failed, placed = _program(projected, -line.dy, line.dx, most, is_direction=True)
        if failed == len(projected):
            found = placed
        worst = excess(line, *found)
    return found

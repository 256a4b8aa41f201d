"""Half-planes of velocities without collision (ORCA), and the nearest velocity within all. Pure.

A track (moving object) or a wall forbids a half-plane of velocities (optimal reciprocal collision
avoidance, ORCA: van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance", ISRR
2009). A linear programme in two variables finds the permitted velocity nearest to a requested one
(de Berg et al., "Computational geometry", chapter 4).

A kernel (see `core/kernels.py`), since each decision passes it. avoidance.py calls it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import INFINITY, Table, fabs, hypot, sqrt
from swarmd.robot.steering.tracks import Track

if TYPE_CHECKING:
    from swarmd.core.values import Array

_EPSILON = 1e-9
_ROUNDED_UP = 1.0 + 1e-9  # times a square: more than rounding


@cython.cclass
class Line:
    """Velocities to the left of the direction `dx`, `dy` through the point `x`, `y` are allowed."""

    x: float
    y: float
    dx: float
    dy: float

    def __init__(self, *numbers: float) -> None:
        """Set all numbers, in the order of the attributes."""
        self.x, self.y, self.dx, self.dy = numbers


def _line(x: float, y: float, dx: float, dy: float) -> Line:
    """A line, made without objects of Python for its numbers."""
    line: Line = Line.__new__(Line)
    line.x = x
    line.y = y
    line.dx = dx
    line.dy = dy
    return line


def excess(line: Line, x: float, y: float) -> float:
    """By how much the velocity violates a line, in m/s; at most 0 if it does not."""
    return line.dx * (line.y - y) - line.dy * (line.x - x)


def line_of(
    px: float,
    py: float,
    vx: float,
    vy: float,
    robot_vx: float,
    robot_vy: float,
    radius: float,
    share: float,
    horizon: float,
) -> Line:
    """The border of the velocities that keep `radius` m away from a place for `horizon` s.

    ORCA (see the module). The velocities relative to the place that lead nearer than `radius` m
    within `horizon` s are the velocity obstacle: a cone from the origin around the direction of the
    place. A round cap replaces the tip of the cone. The cap has the radius `radius` / `horizon`;
    its centre is the place divided by `horizon`. The line is the tangent of the velocity obstacle
    at the point nearest to the present velocity.

    Args:
        px, py: the place of an object in m, relative to the robot.
        vx, vy: the velocity of the robot less that of the object, in m/s.
        robot_vx, robot_vy: the velocity of the robot in m/s.
        radius: m, the distance to keep.
        share: the part of the necessary change of velocity that this robot makes, 0 to 1.
        horizon: s.
    """
    square = max(px * px + py * py, _EPSILON)
    # A robot nearer than `radius` need not move away, and may pass aside: the circle of `radius`
    # around the place then ends 1 mm before the robot.
    radius = min(radius, max(sqrt(square) - 1e-3, 1e-3))
    # The velocity from the centre of the cap, and its scalar product with the place.
    from_cap_x = vx - px / horizon
    from_cap_y = vy - py / horizon
    length = hypot(from_cap_x, from_cap_y)
    along = from_cap_x * px + from_cap_y * py
    # Below: the direction of the line, and the change of velocity in m/s up to the line.
    is_cap_nearest = along < 0.0 and along * along > radius * radius * length * length
    if is_cap_nearest:
        # 1. Projects the velocity on the cap: along the ray from the centre of the cap.
        nx = from_cap_x / max(length, _EPSILON)
        ny = from_cap_y / max(length, _EPSILON)
        off = radius / horizon - length
        dx = ny
        dy = -nx
        change_x = off * nx
        change_y = off * ny
    else:
        # 2. Projects the velocity on the nearer leg of the cone. A leg has the direction of a
        # tangent from the robot to the circle of `radius` around the place. Left of the line lies
        # what is permitted, so the line along the left leg leads away from the origin of the
        # velocities, and the line along the right leg leads towards the origin.
        leg = sqrt(max(square - radius * radius, 0.0))  # m, of the tangent
        is_left = px * from_cap_y - py * from_cap_x > 0.0
        if is_left:
            dx = (px * leg - py * radius) / square
            dy = (px * radius + py * leg) / square
        else:
            dx = -(px * leg + py * radius) / square
            dy = -(py * leg - px * radius) / square
        speed = vx * dx + vy * dy
        change_x = speed * dx - vx
        change_y = speed * dy - vy
    return _line(robot_vx + share * change_x, robot_vy + share * change_y, dx, dy)


def wall_lines(
    walls: Array,
    lead: float,
    robot_vx: float,
    robot_vy: float,
    radius: float,
    reach: float,
    horizon: float,
) -> list[Line]:
    """A line for each place of `walls` (k, 2) within `reach` m of a point `lead` m ahead."""
    places: Table = view(walls)
    lines: list[Line] = []
    for i in range(len(places)):
        x = places[i, 0] - lead
        y = places[i, 1]
        if x * x + y * y < reach * reach:
            lines.append(
                line_of(x, y, robot_vx, robot_vy, robot_vx, robot_vy, radius, 1.0, horizon)
            )
    return lines


def track_lines(
    tracks: tuple[Track, ...],
    lead: float,
    robot_vx: float,
    robot_vy: float,
    radius: float,
    share: float,
    standing_speed: float,
    horizon: float,
) -> list[Line]:
    """A line for each track, for a point `lead` m ahead of the axle.

    The robot makes the whole change of velocity for an object that stands, since such an object
    does not avoid the robot.

    Args:
        tracks: Track values in the base frame.
        lead: m.
        robot_vx, robot_vy: m/s, the velocity of the robot.
        radius: m, of the robot alone.
        share: the part of the necessary change of velocity that this robot makes for an object that
            moves; the object is expected to make the rest.
        standing_speed: m/s; a slower object counts as standing.
        horizon: s.
    """
    track: Track
    lines: list[Line] = []
    for track in tracks:
        vx = track.vx
        vy = track.vy
        lines.append(
            line_of(
                track.x - lead,
                track.y,
                robot_vx - vx,
                robot_vy - vy,
                robot_vx,
                robot_vy,
                radius + track.radius,
                1.0 if hypot(vx, vy) < standing_speed else share,
                horizon,
            )
        )
    return lines


def most_violated(lines: list[Line], first: int, x: float, y: float) -> int:
    """The index of the line, from `first` on, that a velocity violates most; -1 without one."""
    worst = -1
    worst_excess = 0.0
    for i in range(first, len(lines)):
        line_excess = excess(lines[i], x, y)
        if line_excess > worst_excess:
            worst = i
            worst_excess = line_excess
    return worst


def passage_between(
    walls: Array, nearest_ahead: float, farthest_ahead: float, farthest_aside: float
) -> tuple[Any, ...]:
    """The least distance in m between a place of a wall to the left and a place to the right.

    With the rows of both places; (inf, 0, 0) without places on both sides.

    `walls` (k, 2) in m in the base frame. Only places from `nearest_ahead` to `farthest_ahead` m
    ahead, and within `farthest_aside` m to the side, count.
    """
    places: Table = view(walls)
    best = INFINITY, 0, 0
    least_width = INFINITY
    for i in range(len(places)):
        if not (
            nearest_ahead < places[i, 0] < farthest_ahead and 0.0 < places[i, 1] < farthest_aside
        ):
            continue
        for k in range(len(places)):
            if (
                nearest_ahead < places[k, 0] < farthest_ahead
                and -farthest_aside < places[k, 1] <= 0.0
            ):
                dx = places[i, 0] - places[k, 0]
                dy = places[i, 1] - places[k, 1]
                if dx * dx + dy * dy > _ROUNDED_UP * least_width * least_width:
                    continue  # certainly wider: saves most calls of hypot
                width = hypot(dx, dy)
                if width < least_width:
                    least_width = width
                    best = (width, i, k)
    return best


def nearest(
    lines: list[Line], wall_count: int, x: float, y: float, max_speed: float
) -> tuple[cython.double, cython.double]:
    """The velocity nearest to `x`, `y` that satisfies all lines, of at most `max_speed` m/s.

    If no velocity satisfies all lines: the velocity that satisfies the first `wall_count` lines and
    minimises the greatest violation of the other lines.
    """
    programme: _Programme = _Programme()
    programme.max_speed = max_speed
    solved_count = programme.solve(lines, x, y, False)
    if solved_count < len(lines):
        programme.relax(lines, wall_count, solved_count)
    return programme.x, programme.y


@cython.cclass
class _Programme:
    """A linear programme: the velocity `x`, `y` within lines and a circle of radius `max_speed`."""

    max_speed: float
    x: float
    y: float

    def solve(self, lines: list[Line], x: float, y: float, is_direction: bool) -> int:
        """Set the best velocity that satisfies the lines, and return how many lines it satisfies.

        The best velocity is the nearest to `x`, `y`; or, if `is_direction`, the farthest in the
        direction of the unit vector `x`, `y`. The lines are satisfied in their order. A result
        below the number of lines is the index of the first line that no velocity satisfies together
        with the lines before.
        """
        line: Line
        max_speed = self.max_speed
        length = hypot(x, y)
        if is_direction:
            self.x = x * max_speed
            self.y = y * max_speed
        elif length > max_speed:
            self.x = x * max_speed / length
            self.y = y * max_speed / length
        else:
            self.x = x
            self.y = y
        for i in range(len(lines)):
            line = lines[i]
            if excess(line, self.x, self.y) > 0.0 and not self._place(lines, i, x, y, is_direction):
                return i
        return len(lines)

    def _place(
        self, lines: list[Line], line_count: int, x: float, y: float, is_direction: bool
    ) -> bool:
        """Set the best velocity on a line that satisfies all lines before; False if none does.

        The line has the index `line_count`, and `lines` before are satisfied so far. The best
        velocity is the nearest to `x`, `y`. If `is_direction`, it is the farthest in the direction
        of the unit vector `x`, `y`. Positions on the line are in m/s from its point.
        """
        line: Line = lines[line_count]
        other: Line

        # 1. The part of the line, from `low` to `high`, within the circle of the greatest speed.
        along_line = line.x * line.dx + line.y * line.dy
        half_chord_square = along_line * along_line + self.max_speed * self.max_speed
        half_chord_square = half_chord_square - line.x * line.x - line.y * line.y
        if half_chord_square < 0.0:
            return False
        half_chord = sqrt(half_chord_square)
        low = -along_line - half_chord
        high = -along_line + half_chord

        # 2. Each line before cuts this part off on one side.
        for i in range(line_count):
            other = lines[i]
            cross = line.dx * other.dy - line.dy * other.dx
            offset = other.dx * (line.y - other.y) - other.dy * (line.x - other.x)
            if fabs(cross) <= _EPSILON:  # parallel: the line before permits all positions or none
                if offset < -_EPSILON:
                    return False
                continue
            if cross >= 0.0:
                high = min(high, offset / cross)
            else:
                low = max(low, offset / cross)
            # An empty part within _EPSILON is rounding of lines that meet in one velocity. `relax`
            # would lead as far as possible to the permitted side of such lines.
            if low > high + _EPSILON:
                return False

        # 3. The best position in this part.
        if is_direction:
            position = high if x * line.dx + y * line.dy > 0.0 else low
        else:
            position = min(max(line.dx * (x - line.x) + line.dy * (y - line.y), low), high)
        self.x = line.x + position * line.dx
        self.y = line.y + position * line.dy
        return True

    def relax(self, lines: list[Line], wall_count: int, begin: int) -> None:
        """Set the velocity that minimises the greatest violation of the lines from `wall_count` on.

        The velocity satisfies the first `wall_count` lines. `begin` is the index of the first line
        that `solve` could not satisfy. This is the third linear programme of ORCA.

        Each line that is violated more than all lines before is treated so: the velocity moves to
        the permitted side of this line until a line before would be violated as much. The border
        of the velocities that violate two lines equally is a line, too.
        """
        line: Line
        other: Line
        worst_excess = 0.0
        for i in range(begin, len(lines)):
            line = lines[i]
            if excess(line, self.x, self.y) <= worst_excess:
                continue

            # 1. For each line before: the border of equal violation.
            projected: list[Line] = lines[:wall_count]
            for k in range(wall_count, i):
                other = lines[k]
                cross = line.dx * other.dy - line.dy * other.dx
                if fabs(cross) <= _EPSILON:
                    # Parallel lines. With the same permitted side the violations differ by a
                    # constant, so there is no border. With opposite sides the border is midway.
                    have_same_side = line.dx * other.dx + line.dy * other.dy > 0.0
                    if have_same_side:
                        continue
                    x = 0.5 * (line.x + other.x)
                    y = 0.5 * (line.y + other.y)
                else:  # the border leads through the crossing, at `position` m/s along `line`
                    position = other.dx * (line.y - other.y)
                    position = (position - other.dy * (line.x - other.x)) / cross
                    x = line.x + position * line.dx
                    y = line.y + position * line.dy
                # To the left of this direction `other` is violated less than `line`.
                dx = other.dx - line.dx
                dy = other.dy - line.dy
                length = max(hypot(dx, dy), _EPSILON)
                projected.append(_line(x, y, dx / length, dy / length))

            # 2. The velocity farthest to the permitted side, in the direction of the left normal of
            # the line. By rounding, `solve` may fail: the previous velocity then stays.
            previous_x = self.x
            previous_y = self.y
            if self.solve(projected, -line.dy, line.dx, True) < len(projected):
                self.x = previous_x
                self.y = previous_y
            worst_excess = excess(line, self.x, self.y)

"""The distance to the fence, and stops inside the fence: the arithmetic of fence.py.

Part of the unit of barrier.py, whose `StopMotion` simulates a stop. An edge of the fence is a
row of five numbers: x and y of its start, x and y of its end, and the number of its polygon.
Polygon 0 is the outer polygon. Robots keep out of the polygons from 1 on. The edges of a polygon
follow each other. Units: m, s, rad, in the shared frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import INFINITY, Table, fabs, hypot, sqrt
from swarmd.core.values import Array
from swarmd.robot.protection.closing_speed import DECISION_PERIOD
from swarmd.robot.protection.stopping import IDEAL_BRAKING, StopMotion

_FENCE_STEPS = 8  # of a simulated stop
_PLACE_ROUNDING = 1e-9  # m


def _squared_distance(edges: Table, i: int, x: float, y: float) -> float:
    """The squared distance of a place to edge `i`."""
    along_x = edges[i, 2] - edges[i, 0]
    along_y = edges[i, 3] - edges[i, 1]
    dx = x - edges[i, 0]
    dy = y - edges[i, 1]
    part = (dx * along_x + dy * along_y) / (along_x * along_x + along_y * along_y)
    part = 0.0 if part < 0.0 else (1.0 if part > 1.0 else part)
    dx -= part * along_x
    dy -= part * along_y
    return dx * dx + dy * dy


def _permits(edges: Table, x: float, y: float) -> bool:
    """True within the outer polygon and outside all others: even-odd rule."""
    polygon = 0.0
    is_within = False
    for i in range(len(edges)):
        if edges[i, 4] != polygon:
            if is_within != (polygon == 0.0):
                return False
            polygon = edges[i, 4]
            is_within = False
        if (edges[i, 1] > y) != (edges[i, 3] > y):
            at = edges[i, 0] + (y - edges[i, 1]) * (edges[i, 2] - edges[i, 0]) / (
                edges[i, 3] - edges[i, 1]
            )
            if x < at:
                is_within = not is_within
    return is_within == (polygon == 0.0)


def _clearance(edges: Table, near: Table, count: int, x: float, y: float, radius: float) -> float:
    """The clearance in m of a circle of `radius` m around the place (x, y).

    Within the fence: the distance from the place to the nearest edge, less `radius`. For a place
    outside: minus the distance, less `radius`. `edges`: all edges of the fence. `near`: its first
    `count` rows are the edges that may be the nearest.
    """
    least = INFINITY
    for i in range(count):
        squared = _squared_distance(near, i, x, y)
        if squared < least:
            least = squared
    away = sqrt(least)
    return (away if _permits(edges, x, y) else -away) - radius


def clearances(edges: Array, places: Array, radius: float) -> Array:
    """(n,) m from the circles of `radius` around `places` (n, 2) to the fence; negative outside."""
    table: Table = view(edges)
    given: Table = view(places)
    found = np.empty(len(places))
    for i in range(len(given)):
        found[i] = _clearance(table, table, len(table), given[i, 0], given[i, 1], radius)
    return found


def clearance(edges: Array, x: float, y: float, radius: float) -> float:
    """The clearance of one place."""
    table: Table = view(edges)
    return _clearance(table, table, len(table), x, y, radius)


def _nearby(edges: Table, x: float, y: float, way: float) -> tuple[Any, cython.Py_ssize_t]:
    """The edges that may be the nearest of a place within `way` of (x, y), and their number."""
    count = 0
    least = INFINITY
    found = np.empty((len(edges), 5))
    near: Table = view(found)
    for i in range(len(edges)):
        least = min(least, _squared_distance(edges, i, x, y))
    most = sqrt(least) + 2.0 * way + _PLACE_ROUNDING
    for i in range(len(edges)):
        if _squared_distance(edges, i, x, y) <= most * most:
            for j in range(5):
                near[count, j] = edges[i, j]
            count += 1
    return near, count


@cython.cclass
class _Stops:
    """Simulated stops of one robot, from one pose or from several places with one yaw."""

    edges: Table
    near: Table  # the edges that a stop can come near, `count` of them
    count: int
    places: Table  # x, y, and the clearance in m: the places at which the robot may be
    radius: float  # m, of the circle around the axle
    x: float  # of the place that `is_inside` judges
    y: float
    yaw: float
    present: float  # m, the clearance at this place
    need: float  # m, the clearance that errors and margin need
    turn_error: float  # rad by which the direction of the motion may be wrong
    speed_ahead: float  # of the base
    speed_left: float
    speed_turn: float
    braking: float
    turning: float
    motion: StopMotion

    def permits(self, ahead: float, left: float, turn: float) -> bool:
        """True if all stops from a command are inside, at each of the places."""
        for i in range(len(self.places)):
            self.x = self.places[i, 0]
            self.y = self.places[i, 1]
            self.present = self.places[i, 2]
            if not self.permits_here(ahead, left, turn):
                return False
        return True

    def permits_here(self, ahead: float, left: float, turn: float) -> bool:
        """True if all stops from a command are inside, at the present place.

        There are four stops. Three stops begin at the command: with both brakes as weak as assumed,
        with an ideal linear brake, and with an ideal angular brake. A stronger linear or angular
        brake changes the path. The fourth stop begins at the speeds of the base, which need not
        have reached the command.
        """
        return (
            self.is_inside(ahead, left, turn, ahead, left, turn, self.braking, self.turning)
            and self.is_inside(ahead, left, turn, ahead, left, turn, IDEAL_BRAKING, self.turning)
            and self.is_inside(ahead, left, turn, ahead, left, turn, self.braking, IDEAL_BRAKING)
            and self.is_inside(
                self.speed_ahead,
                self.speed_left,
                self.speed_turn,
                ahead,
                left,
                turn,
                self.braking,
                self.turning,
            )
        )

    def is_inside(
        self,
        ahead: float,
        left: float,
        turn: float,
        to_ahead: float,
        to_left: float,
        to_turn: float,
        braking: float,
        turning: float,
    ) -> bool:
        """True if the circle stays clear, or comes inwards, in a stop.

        The base begins at the speeds `ahead`, `left` and `turn`, which change towards `to_ahead`,
        `to_left` and `to_turn`, then towards zero (`StopMotion.advance`). At each step of the stop
        the circle must be clear, or come inwards.

        An error of the direction moves the place by `turn_error` times the way. So the clearance of
        a step may be wrong by this distance (`off`):

        - Clear: the clearance is at least the sum of `need`, `off` and half of the way in the step.
          Between two steps the axle is up to half of a step away from the nearer step.
        - Inwards: the clearance has not fallen since the step before, and has risen since the begin
          by `off` at least.
        """
        top_speed = max(hypot(ahead, left), hypot(to_ahead, to_left))
        top_turn = max(fabs(turn), fabs(to_turn))
        step = (DECISION_PERIOD + max(top_speed / braking, top_turn / turning)) / _FENCE_STEPS
        way = 0.0
        last_room = self.present  # m, the clearance at the step before
        motion: StopMotion = self.motion
        motion.begin(1.0, 0.0, self.yaw)
        for i in range(_FENCE_STEPS):
            # 1. Moves the axle.
            motion.advance(
                step * (i + 0.5),
                step,
                ahead,
                left,
                turn,
                to_ahead,
                to_left,
                to_turn,
                braking,
                turning,
            )
            moved = hypot(motion.moved, motion.aside)
            way += moved
            # 2. The circle must be clear, or come inwards.
            room = _clearance(
                self.edges,
                self.near,
                self.count,
                self.x + motion.x,
                self.y + motion.y,
                self.radius,
            )
            off = self.turn_error * way
            is_clear = room >= self.need + off + 0.5 * moved
            has_fallen = room < last_room - _PLACE_ROUNDING
            has_risen = not room < self.present + off - _PLACE_ROUNDING
            comes_inwards = has_risen and not has_fallen
            if not (is_clear or comes_inwards):
                return False
            last_room = room
        return True


def nearest_permitted(
    edges: Array,
    shares: Array,
    request: tuple[float, float, float],
    sizes: tuple[float, float],
    places: Array,
    yaw: float,
    speeds: tuple[float, float, float],
    brakings: tuple[float, float],
    room: tuple[float, float, float, float],
) -> int:
    """The index of the permitted share of the request that is nearest to the request.

    len(shares) if the request itself is permitted; -1 if no share is permitted. Of equally near
    shares the first counts.

    Args:
        edges: (k, 5) of the fence.
        shares: (n, 2) shares of the linear speeds, and of the angular speed.
        request: m/s ahead, m/s to the left, rad/s.
        sizes: the linear and the angular speed of the request, each over its limit. Distances from
            the request are measured in these numbers.
        places: (m, 3) x and y in m, and the clearance in m, of the places at which the robot may be
            when the command takes effect. A command must be permitted at each place.
        yaw: rad, at this time.
        speeds: of the base at this time, as in `request`.
        brakings: m/s2 and rad/s2.
        room: `radius`, `need` and `turn_error` of `_Stops`, and the greatest distance in m of a
            place from the first place.
    """
    table: Table = view(edges)
    given: Table = view(shares)
    ahead = request[0]
    left = request[1]
    turn = request[2]
    linear_size = sizes[0]
    turn_size = sizes[1]
    stops: _Stops = _Stops()
    stops.motion = StopMotion()
    stops.speed_ahead, stops.speed_left, stops.speed_turn = speeds
    stops.braking, stops.turning = brakings
    stops.edges = table
    stops.places = view(places)
    stops.yaw = yaw
    stops.radius, stops.need, stops.turn_error, spread = room
    # 1. The edges within the way of the longest stop from each place.
    top_speed = max(hypot(ahead, left), hypot(stops.speed_ahead, stops.speed_left))
    top_turn = max(fabs(turn), fabs(stops.speed_turn))
    longest_s = max(top_speed / stops.braking, top_turn / stops.turning)
    stops.near, stops.count = _nearby(
        table,
        stops.places[0, 0],
        stops.places[0, 1],
        spread + top_speed * (DECISION_PERIOD + longest_s),
    )
    if stops.permits(ahead, left, turn):
        return len(given)
    # 2. The nearest permitted share.
    best = -1
    least = INFINITY
    for i in range(len(given)):
        share = given[i, 0]
        turn_share = given[i, 1]
        off = hypot((1.0 - share) * linear_size, (1.0 - turn_share) * turn_size)
        if off < least and stops.permits(ahead * share, left * share, turn * turn_share):
            best = i
            least = off
    return best

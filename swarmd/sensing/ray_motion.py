"""Moves rays: computes the ranges and bearings as the sensor sees them from a later pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.sensing.angles import PI, mod_turn, wrap

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, NAN, asin, atan2, cos, fabs, isfinite, sin, sqrt
else:
    from swarmd.core.cython_shadow import INFINITY, NAN, asin, atan2, cos, fabs, isfinite, sin, sqrt


# The tangent of an angle up to which its series is exact to 3e-15, and faster than atan2.
_SMALL_TANGENT = cython.declare(cython.double, 0.03)
# Share of range_min up to which the motion of the sensor bounds the change of all directions.
_LEAST_SHARE = cython.declare(cython.double, 0.9)
_ROUNDING = cython.declare(cython.double, 1e-9)  # rad


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _moved_range(
    along: cython.double, across: cython.double, least: cython.double, most: cython.double
) -> cython.double:
    """The range of a return at `along` and `across` m from the sensor; -inf below `least`."""
    distance: cython.double = min(sqrt(along * along + across * across), most)
    return -INFINITY if distance < least else distance


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _moved_bearing(
    bearing: cython.double, turn: cython.double, along: cython.double, across: cython.double
) -> cython.double:
    """The bearing in [-pi, pi) of a return at `along`, `across` m in the frame of its old ray.

    The ray had `bearing` at the old pose; `turn` is the yaw of the old pose relative to the new.
    """
    if fabs(across) < _SMALL_TANGENT * along:
        tangent = across / along
        square = tangent * tangent
        turn += tangent * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square / 7.0)))
    else:
        turn += atan2(across, along)
    return wrap(bearing + turn)


@cython.ccall
def move_rays(
    ranges: cython.const[cython.double][::1],
    bearings: cython.const[cython.double][::1],
    cosines: cython.const[cython.double][::1],
    sines: cython.const[cython.double][::1],
    ages: cython.const[cython.double][::1],
    path: cython.double[:, ::1],
    rows: cython.Py_ssize_t,
    limits: cython.double[::1],
    distances: cython.double[::1],
    angles: cython.double[::1],
) -> cython.int:
    """Move rays to the end of a path: sets `distances` and `angles` (n,).

    A ray without a finite range only turns. A return nearer than range_min at the end of the path
    becomes -inf, too close to measure. The new bearings are within [-pi, pi).

    Args:
        ranges: (n,) m.
        bearings: (n,) rad.
        cosines, sines: (n,) of the bearings.
        ages: (n,) s before the end of the path at which each ray was measured.
        path: 2 or more `rows` of: s before the end, x and y in m and yaw in rad relative to the
            pose at the end. Between two rows the pose changes linearly.
        limits: x and y of the sensor in the base frame, range_min and range_max; m.
    """
    n: cython.Py_ssize_t = ranges.shape[0]
    last: cython.Py_ssize_t = rows - 1
    k: cython.Py_ssize_t = 1  # the row at the end of the ray's stretch of the path
    i: cython.Py_ssize_t
    # The stretch: its begin and how long it is, in time, x, y and turn.
    begin: cython.double = INFINITY
    end: cython.double = -INFINITY
    x_begin: cython.double = 0.0
    y_begin: cython.double = 0.0
    turn_begin: cython.double = 0.0
    x_way: cython.double = 0.0
    y_way: cython.double = 0.0
    turn_way: cython.double = 0.0
    # The pose at which rays of one age were measured; many sensors give one age to a whole sector.
    age: cython.double = NAN
    has_place: cython.bint = False
    share: cython.double = 0.0
    turn: cython.double = 0.0
    x: cython.double = 0.0
    y: cython.double = 0.0
    c: cython.double = 1.0
    s: cython.double = 0.0
    for i in range(n):
        distance = ranges[i]
        if age != ages[i]:
            age, has_place = ages[i], False
            if not begin <= age <= end:
                while k < last and age > path[k, 0]:
                    k += 1
                while k > 1 and age < path[k - 1, 0]:
                    k -= 1
                begin, end = path[k - 1, 0], path[k, 0]
                x_begin, y_begin = path[k - 1, 1], path[k - 1, 2]
                turn_begin = path[k - 1, 3]
                x_way, y_way = path[k, 1] - x_begin, path[k, 2] - y_begin
                turn_way = path[k, 3] - turn_begin
            share = min(max((age - begin) / (end - begin), 0.0), 1.0)
            turn = turn_begin + share * turn_way
        if not isfinite(distance):
            distances[i], angles[i] = distance, wrap(bearings[i] + turn)
            continue
        if not has_place:
            has_place = True
            c, s = cos(turn), sin(turn)
            x, y = x_begin + share * x_way, y_begin + share * y_way
            x += (c - 1.0) * limits[0] - s * limits[1]
            y += s * limits[0] + (c - 1.0) * limits[1]
        ahead = c * cosines[i] - s * sines[i]
        left = s * cosines[i] + c * sines[i]
        along, across = distance + (ahead * x + left * y), ahead * y - left * x
        distances[i] = _moved_range(along, across, limits[2], limits[3])
        angles[i] = _moved_bearing(bearings[i], turn, along, across)
    return 0


@cython.ccall
def rays_in_sector(
    ranges: cython.const[cython.double][::1],
    bearings: cython.const[cython.double][::1],
    ages: cython.const[cython.double][::1],
    first: cython.Py_ssize_t,
    way: cython.double[::1],
    sector: cython.double[::1],
    limits: cython.double[::1],
    distances: cython.double[::1],
    angles: cython.double[::1],
    kept_ages: cython.double[::1],
) -> cython.Py_ssize_t:
    """Move the rays in a sector to another pose; the number of these rays.

    Sets `distances`, `angles` and `kept_ages`. A ray counts if it lies in the sector as seen from
    the old or from the new pose.

    Args:
        ranges, bearings, ages: (n,) of rays that were all measured at the old pose.
        first: the first ray that may count.
        way: the old pose relative to the new one: x and y in m, yaw in rad.
        sector: the bearing of its start in rad, 1.0 (counter-clockwise) or -1.0, its width in rad.
        limits: as in `move_rays`.
    """
    x: cython.double = way[0]
    y: cython.double = way[1]
    turn: cython.double = way[2]
    start: cython.double = sector[0]
    direction: cython.double = sector[1]
    width: cython.double = sector[2]
    c: cython.double = cos(turn)
    s: cython.double = sin(turn)
    x += (c - 1.0) * limits[0] - s * limits[1]
    y += s * limits[0] + (c - 1.0) * limits[1]
    # Nothing changes its direction by more than this: rays farther from the sector are skipped.
    most: cython.double = PI
    away: cython.double = sqrt(x * x + y * y)
    if away < _LEAST_SHARE * limits[2]:
        most = asin(away / limits[2]) + _ROUNDING
    n: cython.Py_ssize_t = ranges.shape[0]
    count: cython.Py_ssize_t = 0
    i: cython.Py_ssize_t
    for i in range(first, n):
        before = direction * (bearings[i] + turn - start)
        if mod_turn(before + most) > width + 2.0 * most:
            continue
        if isfinite(ranges[i]):
            ahead, left = cos(bearings[i] + turn), sin(bearings[i] + turn)
            along, across = ranges[i] + (ahead * x + left * y), ahead * y - left * x
            distances[count] = _moved_range(along, across, limits[2], limits[3])
            angles[count] = _moved_bearing(bearings[i], turn, along, across)
        else:
            distances[count], angles[count] = ranges[i], wrap(bearings[i] + turn)
        if mod_turn(before) < width or mod_turn(direction * (angles[count] - start)) < width:
            kept_ages[count] = ages[i]
            count += 1
    return count

"""Moves rays: computes the ranges and bearings as the sensor sees them from a later pose."""

from __future__ import annotations

from swarmd.core.angles import PI, mod_turn, wrap
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Doubles,
    Table,
    asin,
    atan2,
    cos,
    fabs,
    isfinite,
    sin,
    sqrt,
)

# The tangent of an angle up to which its series is exact to 3e-15, and faster than atan2.
_SMALL_TANGENT = 0.03
# Share of range_min up to which the motion of the sensor bounds the change of all directions.
_LEAST_SHARE = 0.9
_ROUNDING = 1e-9  # rad


def _moved_range(along: float, across: float, least: float, most: float) -> float:
    """The range of a return at `along` and `across` m from the sensor; -inf below `least`."""
    distance = min(sqrt(along * along + across * across), most)
    return -INFINITY if distance < least else distance


def _moved_bearing(bearing: float, turn: float, along: float, across: float) -> float:
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


def move_rays(
    ranges: Doubles,
    bearings: Doubles,
    cosines: Doubles,
    sines: Doubles,
    ages: Doubles,
    path: Table,
    row_count: int,
    limits: Doubles,
    distances: Doubles,
    angles: Doubles,
) -> None:
    """Move rays to the end of a path of the base: sets `distances` and `angles` (n,).

    Each ray was measured somewhere on the path. The result is how the sensor would see its return
    from the end of the path. A ray without a finite range only turns. A return nearer than
    range_min there becomes -inf, too close to measure. The new bearings are within [-pi, pi).

    Args:
        ranges: (n,) m.
        bearings: (n,) rad.
        cosines, sines: (n,) of the bearings.
        ages: (n,) s before the end of the path at which each ray was measured.
        path: (`row_count`, 4), 2 rows or more: s before the end, x and y in m and yaw in rad
            relative to the pose at the end. Row 0 is the end; each further row is older than the
            row before. Between two rows the pose changes linearly.
        limits: x and y of the sensor in the base frame, range_min and range_max; m.
        distances, angles: (n,) m and rad, the arrays to fill.
    """
    offset_x = limits[0]
    offset_y = limits[1]
    range_min = limits[2]
    range_max = limits[3]
    count = len(ranges)
    last_row = row_count - 1
    row = 1
    # The segment of the path in which the ray was measured, from row `row - 1`, the newer end, to
    # row `row`, the older end: the ages of both ends (s before the end of the path), x, y and turn
    # at the newer end, and their change to the older end.
    newer_age = INFINITY
    older_age = -INFINITY
    newer_x = 0.0
    newer_y = 0.0
    newer_turn = 0.0
    x_change = 0.0
    y_change = 0.0
    turn_change = 0.0
    # The pose at the present age, used again for rays of the same age: many sensors give a whole
    # sector the same age. `fraction`: place within the segment.
    age = NAN
    has_pose = False
    fraction = 0.0
    turn = 0.0
    x = 0.0
    y = 0.0
    cos_turn = 1.0
    sin_turn = 0.0
    for i in range(count):
        distance = ranges[i]
        # 1. The turn of the pose at the age of the ray.
        if age != ages[i]:
            age = ages[i]
            has_pose = False
            if not newer_age <= age <= older_age:  # else the segment of the ray before holds
                # The search begins at the last segment, since ages change little from ray to ray.
                while row < last_row and age > path[row, 0]:
                    row += 1
                while row > 1 and age < path[row - 1, 0]:
                    row -= 1
                newer_age = path[row - 1, 0]
                older_age = path[row, 0]
                newer_x = path[row - 1, 1]
                newer_y = path[row - 1, 2]
                newer_turn = path[row - 1, 3]
                x_change = path[row, 1] - newer_x
                y_change = path[row, 2] - newer_y
                turn_change = path[row, 3] - newer_turn
            fraction = min(max((age - newer_age) / (older_age - newer_age), 0.0), 1.0)
            turn = newer_turn + fraction * turn_change
        # 2. A ray without a finite range only turns.
        if not isfinite(distance):
            distances[i] = distance
            angles[i] = wrap(bearings[i] + turn)
            continue
        # 3. The place of the sensor at the age of the ray, relative to its place at the end: the
        # motion of the base, plus the turn of the sensor's offset.
        if not has_pose:
            has_pose = True
            cos_turn = cos(turn)
            sin_turn = sin(turn)
            x = newer_x + fraction * x_change
            y = newer_y + fraction * y_change
            x += (cos_turn - 1.0) * offset_x - sin_turn * offset_y
            y += sin_turn * offset_x + (cos_turn - 1.0) * offset_y
        # 4. The return relative to the sensor at the end: along and across the direction of its
        # old ray, whose unit vector is (ahead, left), then as range and bearing.
        ahead = cos_turn * cosines[i] - sin_turn * sines[i]
        left = sin_turn * cosines[i] + cos_turn * sines[i]
        along = distance + (ahead * x + left * y)
        across = ahead * y - left * x
        distances[i] = _moved_range(along, across, range_min, range_max)
        angles[i] = _moved_bearing(bearings[i], turn, along, across)


def rays_in_sector(
    ranges: Doubles,
    bearings: Doubles,
    ages: Doubles,
    first: int,
    motion: Doubles,
    sector: Doubles,
    limits: Doubles,
    distances: Doubles,
    angles: Doubles,
    kept_ages: Doubles,
) -> int:
    """Move the rays that lie in a sector to another pose; the number of these rays.

    Sets `distances`, `angles` and `kept_ages` of these rays, from index 0 on. A ray counts if it
    lies in the sector as seen from the old or from the new pose of the sensor.

    Args:
        ranges, bearings, ages: (n,) m, rad, s of rays that were all measured at the old pose.
        first: the index of the first ray that may count.
        motion: the old pose relative to the new pose: x and y in m, yaw in rad.
        sector: the bearing of its start in rad, 1.0 (counter-clockwise) or -1.0, its width in rad.
        limits: x and y of the sensor in the base frame, range_min and range_max; m.
        distances, angles, kept_ages: (n,) m, rad, s; the arrays to fill.
    """
    x = motion[0]
    y = motion[1]
    turn = motion[2]
    start = sector[0]
    direction = sector[1]
    width = sector[2]
    offset_x = limits[0]
    offset_y = limits[1]
    range_min = limits[2]
    range_max = limits[3]
    # 1. The motion of the sensor: of the base, plus the turn of the sensor's offset.
    cos_turn = cos(turn)
    sin_turn = sin(turn)
    x += (cos_turn - 1.0) * offset_x - sin_turn * offset_y
    y += sin_turn * offset_x + (cos_turn - 1.0) * offset_y
    # 2. The motion changes the direction of a return by at most `max_change` rad, since a return is
    # at least range_min away.
    max_change = PI
    sensor_motion = sqrt(x * x + y * y)
    if sensor_motion < _LEAST_SHARE * range_min:
        max_change = asin(sensor_motion / range_min) + _ROUNDING
    n = len(ranges)
    # 3. Moves the rays.
    count = 0
    for i in range(first, n):
        from_start = direction * (bearings[i] + turn - start)
        # A ray that is more than `max_change` outside of the sector is outside from both poses.
        if mod_turn(from_start + max_change) > width + 2.0 * max_change:
            continue
        if isfinite(ranges[i]):
            ahead = cos(bearings[i] + turn)
            left = sin(bearings[i] + turn)
            along = ranges[i] + (ahead * x + left * y)
            across = ahead * y - left * x
            distances[count] = _moved_range(along, across, range_min, range_max)
            angles[count] = _moved_bearing(bearings[i], turn, along, across)
        else:
            distances[count] = ranges[i]
            angles[count] = wrap(bearings[i] + turn)
        if mod_turn(from_start) < width or mod_turn(direction * (angles[count] - start)) < width:
            kept_ages[count] = ages[i]
            count += 1  # otherwise the next ray overwrites this ray
    return count

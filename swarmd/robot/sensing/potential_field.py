"""The potential fields of the ROS2swarm paper over the rays of a scan, vectorised.

Source: Kaiser et al., "ROS2swarm - A ROS 2 Package for Swarm Robot Behaviors", ICRA 2022,
doi 10.1109/ICRA46639.2022.9812417. A deviation from this source: a ray nearer than `range_min`
counts as a ray at `range_min`. With `ignore_near=True` it counts as no return, as in the original.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from swarmd.core.values import ZERO, Array, Twist

# repulsion: away from near rays; attraction: towards rays, far rays weigh more; attraction2:
# towards rays, near rays weigh more.
FieldKind: TypeAlias = Literal["repulsion", "attraction", "attraction2"]

# A shorter sum is rounding noise of rays that cancel out; its direction is meaningless.
_NO_DIRECTION = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class FieldResult:
    """The sum of a potential field over all rays."""

    vector: Array  # (2,) x forward, y left, no unit, bias included
    count: int  # number of returns within range
    is_alone: bool  # `count` does not exceed the ray threshold


def potential_field(
    ranges: Array,
    bearings: Array,
    *,
    range_max: float,
    range_min: float,
    bias: float,
    ray_threshold: int,
    kind: FieldKind = "repulsion",
    ignore_near: bool = False,
) -> FieldResult:
    """The vector of the field, the number of returns within range, and whether they are too few.

    Each ray within range contributes the unit vector of its bearing times a weight; see FieldKind.
    The weight of a ray with range r is 1 - r / range_max, or r / range_max for "attraction".

    Args:
        ranges: (n,) m. NaN and +inf do not count, -inf (too close to measure) counts as near.
        bearings: (n,) rad.
        range_max: m, the reach of the field, greater than `range_min`; with 0 no return is in
            range.
        range_min: m; a nearer ray counts as a ray at `range_min`.
        bias: added to the vector's x (forward) for "repulsion" and "attraction", and subtracted for
            "attraction2". In the paper the bias of both attractions leads backward: it is negative
            for "attraction", and positive for "attraction2".
        ray_threshold: up to this number of returns within range, `is_alone` is True.
        kind: see FieldKind.
        ignore_near: rays nearer than `range_min` do not count, as in the original.
    """
    is_seen = (ranges < range_max) & (range_max > 0.0)
    if ignore_near:
        is_seen &= (ranges >= range_min) & (ranges > 0.0)
    count = int(np.count_nonzero(is_seen))
    x = 0.0
    y = 0.0
    if count:
        range_share = np.minimum(np.maximum(ranges[is_seen], range_min) / range_max, 1.0)
        weights = range_share if kind == "attraction" else 1.0 - range_share
        seen_bearings = bearings[is_seen]
        x = float(weights @ np.cos(seen_bearings))
        y = float(weights @ np.sin(seen_bearings))
    if kind == "repulsion":
        vector = np.array([bias - x, -y])
    elif kind == "attraction":
        vector = np.array([x + bias, y])
    else:
        vector = np.array([x - bias, y])
    return FieldResult(vector, count, count <= ray_threshold)


def field_twist(vector: Array, linear_max: float, angular_max: float) -> Twist:
    """The command of the paper for a field: full speed, only the direction varies.

    With the unit vector u: linear = linear_max * u_x, angular = angular_max * asin(u_y); so
    `|angular|` reaches 1.57 * angular_max (protection clips it), and for a vector that points
    backwards the robot drives backwards. A zero or non-finite vector gives a zero twist.
    """
    x = float(vector[0])
    y = float(vector[1])
    length = math.hypot(x, y)
    if not _NO_DIRECTION < length < math.inf:
        return ZERO
    turn = math.asin(min(max(y / length, -1.0), 1.0))
    return Twist(linear=linear_max * x / length, angular=angular_max * turn)

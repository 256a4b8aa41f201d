"""Robots among the objects of a scan."""

from __future__ import annotations

import math
from operator import itemgetter

from swarmd.core.angles import difference
from swarmd.core.values import Platform, Scan
from swarmd.kit.params import object_width
from swarmd.robot.sensing.rays import Ray, clusters


def robots_near(
    scan: Scan | None,
    platform: Platform,
    *,
    within: float,
    bearing: float = 0.0,
    half_width: float = math.pi,
) -> list[Ray]:
    """The objects of a scan that may be robots, up to `within` m away, nearest first.

    An object may be a robot if its width is at most twice the diagonal of the platform's footprint,
    and no nearer object hides a side. So a pillar counts as a robot, and a robot that stands at a
    wall does not. Only objects whose middle is at most `half_width` rad from the direction
    `bearing` (rad) count. A `Ray` has range in m and bearing in rad. Empty without a scan.
    """
    max_width = object_width(platform)
    # If the scan were cut off at `within`, the near part of a wall would seem as narrow as a robot.
    objects = clusters(scan, within=within + max_width).objects
    robots = [
        Ray(distance, direction)
        for distance, direction, width, _, is_free in objects
        if is_free and width <= max_width and distance <= within
        if abs(difference(direction, bearing)) <= half_width
    ]
    return sorted(robots, key=itemgetter(0))

"""Robots among the objects of a scan."""

from __future__ import annotations

import math
from operator import itemgetter

from swarmd.core.angles import difference
from swarmd.core.values import Platform, Scan
from swarmd.kit.params import object_width
from swarmd.sensing.rays import Ray, clusters


def robots_near(
    scan: Scan | None,
    platform: Platform,
    *,
    within: float,
    bearing: float = 0.0,
    half_width: float = math.pi,
) -> list[Ray]:
    """The objects up to `within` m that may be robots, nearest first; see `Ray`.

    An object may be a robot if its width is at most twice the diagonal of the platform's footprint,
    and no nearer object hides a side. So a pillar counts as a robot, and a robot that stands at a
    wall does not. `bearing` and `half_width` in rad: only the objects whose middle is in this
    sector.
    """
    width = object_width(platform)
    # If the scan were cut off at `within`, the near part of a wall would seem as narrow as a robot.
    seen = clusters(scan, within=within + width)
    objects = (seen.ranges, seen.bearings, seen.widths, seen.is_free)
    rays = [
        Ray(distance, direction)
        for distance, direction, across, is_free in zip(*(o.tolist() for o in objects), strict=True)
        if distance <= within
        and across <= width
        and is_free
        and abs(difference(direction, bearing)) <= half_width
    ]
    return sorted(rays, key=itemgetter(0))

"""A potential field over 360 rays in plain Python: what drivers and plain nodes answer a scan with.

The same lines wherever they are measured, so that rows differ by what carries the messages.
"""

from __future__ import annotations

import math

from swarmd.core.values import Scan, Twist

RAYS = 360
RANGE_MAX = 3.5
COSINES = [math.cos(2.0 * math.pi * i / RAYS) for i in range(RAYS)]
SINES = [math.sin(2.0 * math.pi * i / RAYS) for i in range(RAYS)]


def plain_field(scan: Scan) -> Twist:
    """The command away from near rays, with a bias ahead."""
    weights = [r / RANGE_MAX - 1.0 if r < RANGE_MAX else 0.0 for r in scan.ranges.tolist()]
    x = sum(map(float.__mul__, weights, COSINES)) + 2.0
    y = sum(map(float.__mul__, weights, SINES))
    heading = math.atan2(y, x)
    return Twist(0.1 * max(math.cos(heading), 0.0), heading)

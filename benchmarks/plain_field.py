"""A potential field over 360 rays in plain Python: what every node answers a scan with.

The standard library alone, since the system's Python runs it too; the same lines wherever they are
measured, so that rows differ by what carries the messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

RAYS = 360
RANGE_MAX = 3.5
COSINES = [math.cos(2.0 * math.pi * i / RAYS) for i in range(RAYS)]
SINES = [math.sin(2.0 * math.pi * i / RAYS) for i in range(RAYS)]


def plain_field(ranges: Iterable[float]) -> tuple[float, float]:
    """The velocity forward in m/s and the turn in rad/s away from near rays, with a bias ahead."""
    weights = [r / RANGE_MAX - 1.0 if r < RANGE_MAX else 0.0 for r in ranges]
    x = sum(map(float.__mul__, weights, COSINES)) + 2.0
    y = sum(map(float.__mul__, weights, SINES))
    heading = math.atan2(y, x)
    return 0.1 * max(math.cos(heading), 0.0), heading

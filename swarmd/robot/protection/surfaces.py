"""Wide surfaces among the near returns of a scan, and the gap to them without the noise of one ray.

Part of the unit of barrier.py. A robot that creeps passes a wide surface more closely than other
obstacles (envelope.py). Units: m, in the base frame.
"""

from __future__ import annotations

import math

from swarmd.core.cython_shadow import NAN, Doubles, fabs, hypot
from swarmd.robot.protection.outline import Outline

SURFACE_SPACING = 0.05
"""m: two neighbouring returns within this distance are of one surface."""
WIDE_SURFACE = 0.3
"""m: a surface of at least this width is wide. A lidar above the bodies of robots sees parts of
them that are 6 to 11 cm wide."""
PEER_RESERVE = 0.03
"""m that the gap to a wide surface is taken to be less if the surface may be a peer that was heard.
Walls are flat, but the corners of a peer point at the robot: the mean place of returns is up to
1.3 cm too far there, noise not included."""
BOX_FACTOR = math.sqrt(2.0)
"""The width of a surface over the diagonal of the body that it shows, at most: the box around a
body that is turned by 45 degrees is wider than the body is long. The returns of a TurtleBot 4 of
0.488 m have a width of up to 0.55 m, those of two that stand corner to corner of 0.5 to 0.6 m."""
MEAN_RAYS = 5
"""Returns to either side that give the mean place of a return, at most: the noise of one ray (sd
1 cm) becomes 0.3 cm. Before an edge that points at the robot the mean is too far: a TurtleBot 4 by
1.3 cm before an edge of 90 degrees, and by 2.5 cm before one of 60 degrees."""
EDGE_RAYS = 2
"""Returns to either side of a second mean, which counts where it is nearer: less than half as much
too far before an edge."""
MEAN_BELOW = 0.1
"""m: a return with a greater gap keeps its own place."""

_SURELY_NEAR = 0.999 * SURFACE_SPACING
"""m: the sum of both legs of a triangle whose long side is below SURFACE_SPACING, also rounded."""


def find_surface_gaps(
    x: Doubles,
    y: Doubles,
    gap: Doubles,
    count: int,
    outline: Outline,
    longest_peer: float,
    surface_gap: Doubles,
) -> None:
    """Set the gap in m of each return to the wide surface that it is on; NaN: it is on none.

    A surface is a run of returns, of which each two neighbours are at most SURFACE_SPACING apart.
    The first and the last run are one surface if their ends are neighbours. The width of a surface
    is the diagonal of the box along the axes of the base around its returns. The gap is that of the
    mean place of the return and its neighbours, as many to the left as to the right; less by
    PEER_RESERVE on a surface that is no wider than the longest peer can make it.

    Args:
        x, y, gap: of the first `count` near returns of a scan, in the order of their rays.
        count: of these returns.
        outline: of the robot.
        longest_peer: m, the longest diagonal of a peer that was heard; 0: none.
        surface_gap: the result.
    """
    widest_peer = BOX_FACTOR * longest_peer
    begin = 0
    start = 0
    # 1. The first return behind a step from one surface to the next, so that no run is cut.
    for i in range(count):
        if _is_step(x, y, i - 1 if i > 0 else count - 1, i):
            start = i
            break
    # 2. Each run, with the box around its returns.
    while begin < count:
        at = (start + begin) % count
        low_x = x[at]
        high_x = x[at]
        low_y = y[at]
        high_y = y[at]
        end = begin + 1
        while end < count:
            at = (start + end) % count
            if _is_step(x, y, (start + end - 1) % count, at):
                break
            low_x = min(low_x, x[at])
            high_x = max(high_x, x[at])
            low_y = min(low_y, y[at])
            high_y = max(high_y, y[at])
            end += 1
        width = hypot(high_x - low_x, high_y - low_y)
        is_wide = width >= WIDE_SURFACE
        reserve = 0.0 if width > widest_peer else PEER_RESERVE
        for i in range(begin, end):
            at = (start + i) % count
            surface_gap[at] = gap[at] - reserve if is_wide else NAN
            if is_wide and gap[at] < MEAN_BELOW:
                neighbours = min(i - begin, end - 1 - i)
                near_ends = min(neighbours, EDGE_RAYS)
                surface_gap[at] = (
                    min(
                        _gap_of_mean(x, y, at, neighbours, count, outline),
                        _gap_of_mean(x, y, at, near_ends, count, outline),
                    )
                    - reserve
                )
        begin = end


def _is_step(x: Doubles, y: Doubles, i: int, j: int) -> bool:
    """True if returns `i` and `j` are farther apart than those of one surface, or one is NaN."""
    across = fabs(x[i] - x[j])
    along = fabs(y[i] - y[j])
    if across + along <= _SURELY_NEAR:  # most are: a hypot takes ten times as long
        return False
    return not hypot(across, along) <= SURFACE_SPACING


def _gap_of_mean(x: Doubles, y: Doubles, at: int, most: int, count: int, outline: Outline) -> float:
    """The gap in m of the mean place of return `at` and of up to `most` returns to either side.

    The mean of gaps would be too great where a corner of the outline points at the surface.
    """
    reach = min(most, MEAN_RAYS)
    total = 2 * reach + 1
    first = at - reach + count
    sum_x = 0.0
    sum_y = 0.0
    for i in range(total):
        sum_x += x[(first + i) % count]
        sum_y += y[(first + i) % count]
    return outline.gap_of(sum_x / total, sum_y / total)

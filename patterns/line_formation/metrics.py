"""Metrics of line formation: the error of the line before and after a robot is removed.

An error is a share of the spacing, the larger of two: the distance from the best line, and the
unevenness of the spacing. Fredslund and Mataric 2002 ask both of a formation. A robot is removed
after 30 of 60 s.
"""

from __future__ import annotations

from swarmd.sim.metrics.formation import largest_error, line_errors, share_moving
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

SPACING = 1.1
"""Spacing of TurtleBots in m, 2.2 times their protection threshold."""
BROKEN = 0.1
"""A tenth of the spacing."""
_BEFORE = (20.0, 29.9)
_REMOVED = (30.0, 31.0)
_AFTER = (50.0, 60.0)
_MOVING = 0.05  # m, the path that a robot at rest does not have


@metric(better="less")
def error_before(trace: Trace) -> float:
    """The largest error in the 10 s before the removal."""
    return largest_error(trace, line_errors, _BEFORE, SPACING)


@metric(unit="0 or 1")
def breaks(trace: Trace) -> bool:
    """Whether the removal breaks the line: in its first second the error exceeds a tenth."""
    return largest_error(trace, line_errors, _REMOVED, SPACING) > BROKEN


@metric(better="less")
def error_after(trace: Trace) -> float:
    """The largest error from 20 to 30 s after the removal."""
    return largest_error(trace, line_errors, _AFTER, SPACING)


@metric(unit="share", better="less", bounds=(0.0, 1.0))
def moving_after(trace: Trace) -> float:
    """The share of robots that move 5 cm from 20 to 30 s after the removal."""
    return share_moving(trace, _AFTER, _MOVING)

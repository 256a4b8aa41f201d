"""Sectors of a range sensor that contradict an earlier scan: lost surfaces, ranges that stay.

A sector is given by the mean of its ranges in m, NaN without a return. The functions run rarely:
blind_sector.py calls them if many sectors have lost their returns, or after some way of the robot.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Pose

SECTORS = 90
"""Sectors of 4 degrees around a sensor."""
LEAST_SECTORS = 11
"""Sectors that must contradict an earlier scan: 44 degrees."""
EQUAL = 0.03
"""m by which noise changes the mean of a sector."""

_WIDTH = math.tau / SECTORS  # rad
# m of surface that must contradict an earlier scan: more than anything has that moves among robots.
_LEAST_LENGTH = 1.0
_CHANGED = 0.1  # m, a change that noise does not explain
_MIDDLES = (np.arange(SECTORS) + 0.5) * _WIDTH


def lost_sectors(
    means: Array, before: Array, turned: float, motion: float, nearest: float
) -> NDArray[np.bool_]:
    """(90,) sectors that must return what the scan before showed, and return nothing.

    A sector must return a surface that the scan before showed in its direction, and as far to both
    sides as the edges of the surface may have moved. Neighbouring sectors without a return have
    lost the sum of the lengths of their surfaces, which must be at least 1 m.

    Args:
        means: (90,) m, of this scan.
        before: (90,) m, of the scan before; NaN also for a range at which a return is not certain.
        turned: rad, by which the robot has turned meanwhile.
        motion: m, by which robot and surfaces may have moved against each other meanwhile.
        nearest: m, `range_min` of the sensor. What comes nearer is not measured.
    """
    shown = np.roll(before, -round(turned / _WIDTH))
    places = np.arange(SECTORS)
    apart = np.abs(places[:, None] - places[np.isnan(shown)])
    apart = np.minimum(apart, SECTORS - apart).min(axis=1, initial=SECTORS)
    edge_motion = 1.0 + (abs(turned) + motion / shown) / _WIDTH  # in sectors
    is_sure = (apart > edge_motion) & (shown > nearest + 2.0 * motion)
    is_empty = np.isnan(means)
    return _long_runs(np.where(is_sure & is_empty, shown, np.nan), is_empty)


def frozen_sectors(means: Array, look: Array, pose: Pose, look_pose: Pose) -> NDArray[np.bool_]:
    """(90,) sectors whose ranges equal those of an earlier look, and should not.

    The returns of the look, as static points, give the range that each sector should have now. At
    least LEAST_SECTORS other sectors must have changed to this range: else odometry is wrong. The
    frozen surface must have a length of at least 1 m.

    Args:
        means: (90,) m, of this scan.
        look: (90,) m, of the look.
        pose, look_pose: of the robot at both, in the frame of odometry.
    """
    change = np.abs(means - look)
    # Mostly too few for a result, whatever the static points are: 9 us in place of 113.
    if min(np.count_nonzero(one) for one in (change > _CHANGED, change <= EQUAL)) < LEAST_SECTORS:
        return np.zeros(SECTORS, np.bool_)
    angles = _MIDDLES + look_pose.yaw
    x = look_pose.x - pose.x + look * np.cos(angles)
    y = look_pose.y - pose.y + look * np.sin(angles)
    is_seen = ~np.isnan(look)
    sectors = ((np.arctan2(y, x) - pose.yaw) // _WIDTH)[is_seen].astype(np.int64) % SECTORS
    static = np.full(SECTORS, np.inf)
    np.minimum.at(static, sectors, np.hypot(x, y)[is_seen])
    # By how much a range differs from the static points in the sector or beside it; inf: no point.
    off = np.min([np.abs(np.roll(static, k) - means) for k in (-1, 0, 1)], axis=0)
    is_moved = (change > _CHANGED) & (off <= 0.5 * _CHANGED)
    is_equal = (change <= EQUAL) & (off > _CHANGED) & (off < np.inf)
    is_equal &= np.count_nonzero(is_moved) >= LEAST_SECTORS
    return _long_runs(np.where(is_equal, means, np.nan), is_equal)


def _long_runs(surfaces: Array, is_open: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(90,) sectors with a surface, in runs of neighbours with enough of it.

    `surfaces`: (90,) m, the range of each; NaN: none. `is_open`: (90,) the sectors of the runs.
    """
    start = int(is_open.argmin())  # ends a run, so that no run goes on over the end of the array
    run = np.cumsum(~np.roll(is_open, -start))
    ranges = np.roll(surfaces, -start)
    is_surface = ~np.isnan(ranges)
    lengths = np.bincount(run, np.where(is_surface, ranges, 0.0)) * _WIDTH
    is_long = (lengths >= _LEAST_LENGTH) & (np.bincount(run, is_surface) >= LEAST_SECTORS)
    return np.roll(is_surface & is_long[run], start)

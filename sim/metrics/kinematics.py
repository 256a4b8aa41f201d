"""Path lengths and speeds.

A step between two instants counts if the robot is present at both: an absent robot moves only when
others push it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.window import LATE, by_platform, late, presence, row_means
from swarmd.sim.trace import Trace


def path_lengths(trace: Trace) -> Array:
    """(n,) the path length in m of each robot's axle centre."""
    length: Array = _steps(trace).sum(axis=0)
    return length


def path_length(trace: Trace) -> float | None:
    """The mean path length in m of the robots that were ever present; None without one."""
    is_counted = presence(trace).any(axis=0)
    return float(path_lengths(trace)[is_counted].mean()) if is_counted.any() else None


def path_lengths_over_time(trace: Trace) -> Array:
    """(T,) the mean path length in m until each instant, of robots that were ever present."""
    is_counted = presence(trace).any(axis=0)
    if not is_counted.any():
        return np.full(len(trace.t), np.nan)
    steps = _steps(trace)[:, is_counted].mean(axis=1)
    return np.concatenate((np.zeros(1), np.cumsum(steps)))


def mean_speed(trace: Trace, since: float = 0.0) -> float | None:
    """The robots' mean speed in m/s over the instants from `since` s after the start on.

    None without time between instants.
    """
    is_late = trace.t >= trace.t[:1] + since - 1e-9
    total = float(_seconds(trace)[is_late[:-1]].sum())
    return float(_steps(trace)[is_late[:-1]].sum()) / total if total > 0.0 else None


def mean_speeds(trace: Trace) -> Array:
    """(T,) the mean speed in m/s of present robots since the instant before; NaN at the first."""
    return _mean_speeds(trace, np.ones(len(trace.ids)))


def speed_share(trace: Trace, seconds: float = LATE) -> float | None:
    """The mean speed in the last `seconds` (`window.late`) as a share of each platform's v_max.

    None without `meta["v_max"]` or without a robot.
    """
    limits = by_platform(trace, "v_max")
    if limits is None:
        return None
    settled = late(trace, seconds)
    total = float(_seconds(settled).sum())
    return float((_steps(settled) / limits).sum()) / total if total > 0.0 else None


def speed_shares(trace: Trace) -> Array | None:
    """(T,) the mean speed since the instant before as a share of v_max; NaN at the first."""
    limits = by_platform(trace, "v_max")
    return None if limits is None else _mean_speeds(trace, limits)


def _mean_speeds(trace: Trace, limits: Array) -> Array:
    """(T,) the mean of speed / limit over present robots; `limits` (n,) in m/s."""
    if len(trace.t) == 0:
        return np.zeros(0)
    seconds = _seconds(trace)
    speed = _steps(trace) / np.where(seconds > 0.0, seconds, 1.0) / limits
    return np.concatenate((np.full(1, np.nan), row_means(speed, seconds > 0.0)))


def _both(trace: Trace) -> NDArray[np.bool_]:
    is_present = presence(trace)
    return is_present[1:] & is_present[:-1]


def _steps(trace: Trace) -> Array:
    """(T - 1, n) the distance in m between consecutive instants, 0 for absent robots."""
    step = np.diff(trace.pose[..., :2], axis=0)
    return np.where(_both(trace), np.hypot(step[..., 0], step[..., 1]), 0.0)


def _seconds(trace: Trace) -> Array:
    """(T - 1, n) the time in s between consecutive instants, 0 for absent robots."""
    return np.where(_both(trace), np.diff(trace.t)[:, None], 0.0)


_KINEMATICS = "kinematics"

METRICS = (
    Metric("mean_speed", "m/s", "the robots' mean speed over the whole run", _KINEMATICS,
           mean_speed, mean_speeds),
    Metric("mean_speed_late_share", "share",
           "mean speed in the last 60 s as a share of the platform's highest", _KINEMATICS,
           speed_share, speed_shares),
    Metric("path_length", "m", "path length over the whole run, mean of the robots", _KINEMATICS,
           path_length, path_lengths_over_time),
)  # fmt: skip

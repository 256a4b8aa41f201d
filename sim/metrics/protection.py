"""Metrics of protection: how often and how far it changes requested commands.

Only present robots count: an absent robot has no daemon and therefore no protection.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.messages import Reason, State
from swarmd.core.values import Array
from swarmd.sim.metrics.metric import SHARE, Metric
from swarmd.sim.metrics.window import by_platform, late, mean, presence, reaches, row_means
from swarmd.sim.trace import Trace

_TRAVEL_WINDOW = 60.0  # s
_MIN_REQUEST = 0.1  # least requested speed, as a share of the top speed, of a robot that travels
_ROUNDING = 1e-9

HOLDS = (
    Reason.NO_SCAN,
    Reason.INVALID_SCAN,
    Reason.STALE_SCAN,
    Reason.FROZEN_SCAN,
    Reason.FROZEN_STAMP,
    Reason.CLOCK_SET,
    Reason.STALE_ODOMETRY,
    Reason.COMMAND_EXPIRED,
    Reason.DRIVER_LOST,
    Reason.PATTERN_RESTARTING,
)
"""Reasons for which the safe command is zero although the state is `running`."""


def protection_duty(trace: Trace) -> float | None:
    """The share of scans on which protection replaced or reduced the requested command.

    The share is over the scans of all robots, since the protection of Kaiser et al. 2022 decides on
    every scan. If the trace does not count scans, the result is the share of instants at which
    protection changed the command (`active`), over all instants at which a robot runs. None without
    data or decision.
    """
    if trace.decided is not None and trace.evaded is not None:
        is_present = presence(trace)
        decided = int(trace.decided[is_present].sum())
        return float(trace.evaded[is_present].sum()) / decided if decided else None
    if trace.active is None:
        return None
    return mean(trace.active.astype(np.float64), _running(trace))


def protection_duties(trace: Trace) -> Array | None:
    """(T,) `protection_duty` at each instant; NaN without a decision, None if not recorded."""
    is_present = presence(trace)
    if trace.decided is not None and trace.evaded is not None:
        decided = np.where(is_present, trace.decided, 0).sum(axis=1)
        evaded = np.where(is_present, trace.evaded, 0).sum(axis=1)
    elif trace.active is not None:
        running = _running(trace)
        decided = running.sum(axis=1)
        evaded = (running & trace.active).sum(axis=1)
    else:
        return None
    shares: Array = np.where(decided > 0, evaded / np.maximum(decided, 1), np.nan)
    return shares


def alterations(trace: Trace) -> Array | None:
    """(T, n) the difference of safe and requested command, as a share of full speed.

    The difference is |safe - requested| / v_max. In it the angular speed counts as the speed of the
    footprint's farthest corner, so that turns and platforms are comparable. Safety barrier
    certificates minimise |u - u_requested|, without our scale (Wang, Ames and Egerstedt, IEEE T-RO
    2017). NaN where the robot does not run. None without requested commands or `meta["v_max"]`.
    """
    limits = by_platform(trace, "v_max")
    if trace.requested is None or limits is None:
        return None
    change = trace.safe - trace.requested
    change = np.stack((change[..., 0], reaches(trace) * change[..., 1], change[..., 2]), axis=-1)
    altered: Array = np.linalg.norm(change, axis=-1) / limits
    return np.where(_running(trace), altered, np.nan)


def mean_alterations(trace: Trace) -> Array | None:
    """(T,) the mean of `alterations` over the running robots; NaN while none runs."""
    altered = alterations(trace)
    return None if altered is None else row_means(altered, ~np.isnan(altered))


def command_alteration(trace: Trace) -> float | None:
    """The mean of `alterations` over running robots and instants; None if unknown."""
    altered = alterations(trace)
    return None if altered is None else mean(altered)


def hold_share(trace: Trace) -> float | None:
    """The share of the running robots' instants with a hold.

    Ours: holds are this project's own. None if states were not recorded or no robot ran.
    """
    if trace.state is None or trace.reason is None:
        return None
    is_held = np.isin(trace.reason, [str(reason) for reason in HOLDS])
    return mean(is_held.astype(np.float64), _running(trace))


def recovery_share(trace: Trace) -> float | None:
    """The share of the running robots' instants in recovery.

    Ours. None if recovery was not recorded, or no robot ran.
    """
    if trace.recovering is None:
        return None
    return mean(trace.recovering.astype(np.float64), _running(trace))


def travel_extent(trace: Trace) -> float | None:
    """The mean extent in m of the paths of robots that request motion, over windows of 60 s.

    The extent of a robot in a window is the longer side of the axis-aligned bounding box of its
    positions. Only windows in which the robot requests motion for at least half of the time count.
    So a deadlocked group that moves to and fro before a door has a small extent. The metric is
    ours. None without requested commands or such a window.
    """
    limits = by_platform(trace, "v_max")
    if trace.requested is None or limits is None or len(trace.t) == 0:
        return None
    asks = np.hypot(trace.requested[..., 0], trace.requested[..., 2]) >= _MIN_REQUEST * limits
    asks &= _running(trace)
    extents: list[float] = []
    for start in np.arange(trace.t[0], trace.t[-1] - _TRAVEL_WINDOW + _ROUNDING, _TRAVEL_WINDOW):
        first, stop = np.searchsorted(
            trace.t, (start - _ROUNDING, start + _TRAVEL_WINDOW + _ROUNDING)
        )
        sides = np.ptp(trace.pose[first:stop, :, :2], axis=0)
        wants = asks[first:stop].mean(axis=0) >= 0.5
        extents.extend(sides[wants].max(axis=1))
    return float(np.mean(extents)) if extents else None


FAILED_PATTERNS = "failed_patterns"


def failed_patterns(trace: Trace) -> int | None:
    """The number of robots whose pattern failed at least once and was restarted or set aside.

    Ours: a pattern that raises does not end a run. None if states were not recorded, or no robot
    was present.
    """
    is_present = presence(trace)
    if trace.state is None or trace.reason is None or not is_present.any():
        return None
    is_failing = (trace.state == str(State.FAULTED)) | (
        trace.reason == str(Reason.PATTERN_RESTARTING)
    )
    return int((is_failing & is_present).any(axis=0).sum())


def _running(trace: Trace) -> NDArray[np.bool_]:
    """(T, n) whether a robot is running; without recorded states, whether it is present."""
    is_present = presence(trace)
    return is_present if trace.state is None else is_present & (trace.state == str(State.RUNNING))


_KAISER = "Kaiser et al. 2022, ICRA"

METRICS = (
    Metric("protection_duty", "share",
           "share of scans on which protection replaced or reduced the requested command", _KAISER,
           protection_duty, protection_duties, "less", bounds=SHARE),
    Metric("protection_duty_late", "share", "the same in the last 60 s", _KAISER,
           lambda trace: protection_duty(late(trace)), protection_duties, "less", bounds=SHARE),
    Metric("command_alteration", "share",
           "mean difference of safe and requested command; 1 is full speed",
           "change of the control: Wang et al. 2017, IEEE T-RO 33; its scale: ours",
           command_alteration, mean_alterations, "less"),
    Metric("hold_share", "share",
           "share of running time with a hold, in which the safe command is zero", "ours",
           hold_share, better="less", bounds=SHARE),
    Metric("recovery_share", "share",
           "share of running time in recovery, which leads a robot around an obstacle", "ours",
           recovery_share, better="less", bounds=SHARE),
    Metric("travel_extent", "m",
           "mean extent of the area that a robot covers in 60 s while it requests motion; small in"
           " a deadlock, even if it wanders", "ours", travel_extent, better="more"),
    Metric(FAILED_PATTERNS, "robots",
           "robots whose pattern failed: it was restarted, or set aside", "ours", failed_patterns,
           better="less"),
)  # fmt: skip

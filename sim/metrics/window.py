"""Selections of instants and robots for metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.trace import Trace

LATE = 60.0
"""The last seconds of a run, in which a swarm is assumed to have settled."""
_ROUNDING = 1e-9


def presence(trace: Trace) -> NDArray[np.bool_]:
    """(T, n) whether the robot's daemon is present; always true if the trace has no presence."""
    shape = trace.pose.shape[:2]
    return np.ones(shape, dtype=bool) if trace.present is None else trace.present


def late(trace: Trace, seconds: float = LATE) -> Trace:
    """The last `seconds` of a run, or its last half if that is shorter."""
    if len(trace.t) == 0:
        return trace
    since = trace.t[-1] - min(seconds, trace.duration / 2.0)
    return cut(trace, int(np.searchsorted(trace.t, since - _ROUNDING)), len(trace.t))


def last(trace: Trace) -> Trace:
    """The last instant alone."""
    return cut(trace, max(len(trace.t) - 1, 0), len(trace.t))


def first(trace: Trace) -> Trace:
    """The first instant alone."""
    return cut(trace, 0, min(len(trace.t), 1))


def cut(trace: Trace, start: int, stop: int) -> Trace:
    """The instants [start, stop) of a trace, as views, with the contacts between them."""
    span = slice(start, stop)
    t = trace.t[span]
    # A run without instants has no contacts.
    ends = (t[0], t[-1]) if len(t) else (np.inf, -np.inf)
    is_in = (trace.contact_t >= ends[0] - _ROUNDING) & (trace.contact_t <= ends[1] + _ROUNDING)
    return replace(
        trace,
        t=t,
        pose=trace.pose[span],
        safe=trace.safe[span],
        contact_t=trace.contact_t[is_in],
        contact_pair=trace.contact_pair[is_in],
        contact_speed=trace.contact_speed[is_in],
        requested=None if trace.requested is None else trace.requested[span],
        state=None if trace.state is None else trace.state[span],
        reason=None if trace.reason is None else trace.reason[span],
        active=None if trace.active is None else trace.active[span],
        decided=None if trace.decided is None else trace.decided[span],
        evaded=None if trace.evaded is None else trace.evaded[span],
        gap=None if trace.gap is None else trace.gap[span],
        scan_age=None if trace.scan_age is None else trace.scan_age[span],
        bound=None if trace.bound is None else trace.bound[span],
        recovering=None if trace.recovering is None else trace.recovering[span],
        present=None if trace.present is None else trace.present[span],
        report={name: values[span] for name, values in trace.report.items()},
        words={name: values[span] for name, values in trace.words.items()},
        box_pose=None if trace.box_pose is None else trace.box_pose[span],
    )


def mean(values: Array, is_counted: NDArray[np.bool_] | None = None) -> float | None:
    """The mean of the values that are not NaN, of those counted; None without one."""
    kept = ~np.isnan(values) if is_counted is None else is_counted & ~np.isnan(values)
    return float(values[kept].mean()) if kept.any() else None


def row_means(values: Array, is_counted: NDArray[np.bool_]) -> Array:
    """(T,) the mean of each row of values (T, n) over those counted; NaN without one."""
    count = is_counted.sum(axis=1)
    total = np.where(is_counted, values, 0.0).sum(axis=1)
    means: Array = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means


def by_platform(trace: Trace, key: str) -> Array | None:
    """(n,) the number that `meta[key]` gives each robot's platform; None if one is missing."""
    table = trace.meta.get(key)
    if not isinstance(table, Mapping) or any(name not in table for name in trace.platforms):
        return None
    return np.array([float(table[name]) for name in trace.platforms])

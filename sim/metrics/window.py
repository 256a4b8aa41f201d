"""Selections of instants and robots for metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.geometry import radius

LATE = 60.0
"""The last seconds of a run, in which a swarm is assumed to have settled."""
_ROUNDING = 1e-9
_SAMPLE = 1e-6  # s, less than between two instants
_OVER_TIME = (
    *("t", "pose", "safe", "requested", "state", "reason", "active", "decided", "evaded", "gap"),
    *("scan_age", "bound", "recovering", "present", "box_pose"),
)


def presence(trace: Trace) -> NDArray[np.bool_]:
    """(T, n) whether the robot's daemon is present; always true if the trace has no presence."""
    shape = trace.pose.shape[:2]
    return np.ones(shape, dtype=bool) if trace.present is None else trace.present


def late(trace: Trace, seconds: float = LATE) -> Trace:
    """The last `seconds` of a run, or its last half if half of the run is shorter."""
    return cut(trace, late_from(trace.t, seconds), len(trace.t)) if len(trace.t) else trace


def late_from(t: Array, seconds: float = LATE) -> int:
    """The index in `t` (T,), which is not empty, of the first instant of `late`."""
    since = t[-1] - min(seconds, float(t[-1] - t[0]) / 2.0)
    return int(np.searchsorted(t, since - _ROUNDING))


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
    parts: dict[str, Any] = {name: getattr(trace, name) for name in _OVER_TIME}
    sliced: dict[str, Any] = {
        name: None if values is None else values[span] for name, values in parts.items()
    }
    return replace(
        trace,
        contact_t=trace.contact_t[is_in],
        contact_pair=trace.contact_pair[is_in],
        contact_speed=trace.contact_speed[is_in],
        report={name: values[span] for name, values in trace.report.items()},
        words={name: values[span] for name, values in trace.words.items()},
        readings={name: values[span] for name, values in trace.readings.items()},
        **sliced,
    )


def between(trace: Trace, since: float, until: float) -> Trace:
    """The instants from `since` to `until`, in s of the trace's time, both included."""
    start, stop = np.searchsorted(trace.t, (since - _SAMPLE, until + _SAMPLE)).tolist()
    return cut(trace, start, stop)


def arena_of(trace: Trace) -> Arena | None:
    """The arena that the trace names; None without one, as in a trace of another program."""
    try:
        return parse_arena(str(trace.meta.get("arena", "")))
    except ConfigError:
        return None


def tall_boxes(trace: Trace) -> tuple[Array, Array] | None:
    """The outlines (m, k, 2) and poses (T, m, 3) of the movable boxes, without items.

    None without a movable box.
    """
    if trace.box_pose is None or trace.box_shapes is None:
        return None
    arena = arena_of(trace)
    m = len(trace.movable_boxes) - (0 if arena is None else len(arena.items))
    return (trace.box_shapes[:m], trace.box_pose[:, :m]) if m else None


def centroids(trace: Trace) -> Array:
    """(T, 2) the mean position of the present robots' axle centres; NaN without one."""
    is_present = presence(trace)
    return np.stack([row_means(trace.pose[..., axis], is_present) for axis in (0, 1)], axis=-1)


def reaches(trace: Trace) -> Array:
    """(n,) the distance in m of each footprint's farthest corner from its frame's origin."""
    reach = {name: radius(shape) for name, shape in trace.footprints.items()}
    return np.array([reach[name] for name in trace.platforms], dtype=np.float64)


def mean(values: Array, is_counted: NDArray[np.bool_] | None = None) -> float | None:
    """The mean of the values that are counted and not NaN; None without such a value."""
    kept = ~np.isnan(values) if is_counted is None else is_counted & ~np.isnan(values)
    return float(values[kept].mean()) if kept.any() else None


def row_means(values: Array, is_counted: NDArray[np.bool_]) -> Array:
    """(T,) the mean of each row of values (T, n) over its counted values; NaN without any."""
    count = is_counted.sum(axis=1)
    total = np.where(is_counted, values, 0.0).sum(axis=1)
    means: Array = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means


def by_platform(trace: Trace, key: str) -> Array | None:
    """(n,) the number of each robot's platform in `meta[key]`; None if a number is missing."""
    table = trace.meta.get(key)
    if not isinstance(table, Mapping) or any(name not in table for name in trace.platforms):
        return None
    return np.array([float(table[name]) for name in trace.platforms])

"""Metrics, and functions that make the number of a run from a series over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics import window
from swarmd.sim.trace import Trace

Value: TypeAlias = Callable[[Trace], float | None]
Series: TypeAlias = Callable[[Trace], Array | None]
Better: TypeAlias = Literal["less", "more"]
SHARE = (0.0, 1.0)
"""The bounds of a share, or of a metric that is 0 or 1."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of a run."""

    name: str
    unit: str
    meaning: str
    source: str
    value: Value
    """The number for a trace; None if the trace has no value."""
    series: Series | None = None
    """(T,) the value at each instant, NaN where unknown, or None if the trace lacks data. A metric
    without `series` is defined for whole runs only."""
    better: Better | None = None
    """The better direction; None if it depends on the task."""
    is_time_to_event: bool = False
    """The value is a duration in s, None where the event never happened."""
    event: str = ""
    """The name of the event in a figure, for a time to an event."""
    origin: str = ""
    """The name by which `metric_of` finds a custom metric from any working folder; else empty."""
    digest: str = ""
    """The SHA-256 of the code of a custom metric; else empty."""
    bounds: tuple[float, float] | None = None
    """The least and the largest value that a run can have; None: not known."""


def at_start(series: Series) -> Value:
    """The series' value at the first instant."""
    return _mean_of(series, window.first)


def at_end(series: Series) -> Value:
    """The series' value at the last instant."""
    return _mean_of(series, window.last)


def late_mean(series: Series) -> Value:
    """The series' mean over the last 60 s, or the last half if that is shorter."""
    return _mean_of(series, window.late)


def peak(series: Series) -> Value:
    """The series' largest value."""

    def value(trace: Trace) -> float | None:
        values = series(trace)
        known = np.zeros(0) if values is None else values[~np.isnan(values)]
        return float(known.max()) if len(known) else None

    return value


def _mean_of(series: Series, part: Callable[[Trace], Trace]) -> Value:
    def value(trace: Trace) -> float | None:
        values = series(part(trace))
        return None if values is None else window.mean(values)

    return value


def over_time(values: Array, t: Array, word: str) -> float | None:
    """The statistic `word` (of TIMES) of values (T,) at instants `t` (T,); NaN values are left out.

    `start` and `end`: the value at the first and the last instant. `late`: the mean as in
    `late_mean`. None if no value is left.
    """
    if word == "start":
        values = values[:1]
    elif word == "end":
        values = values[-1:]
    elif word == "late" and len(t):
        values = values[window.late_from(t) :]
    known = values[~np.isnan(values)]
    return float(_STATISTICS.get(word, np.mean)(known)) if len(known) else None


_STATISTICS: Mapping[str, Callable[[Array], np.floating]] = MappingProxyType(
    {"mean": np.mean, "min": np.min, "max": np.max, "std": np.std}
)
TIMES = ("start", "end", "late", *_STATISTICS)
"""The words of `over_time`."""

"""What patterns report, as metrics: `report:KEY[=TEXT][.ROBOTS][_TIME]`.

A number of each robot is taken over the robots (ROBOTS: mean, median, min, max, std, sum), then
over time (TIME: start, end, late, mean, min, max, std). Without ROBOTS it is the mean, without TIME
`late`; a TIME that is no word of ROBOTS may stand alone. Examples: `report:value`,
`report:value.max`, `report:value.std_end`, `report:value.end`. With TEXT a robot counts 1 while it
reports this text and 0 while it reports another: `report:state=wait` is a share of the robots.
Only present robots that report KEY count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.sim.metrics.metric import TIMES, Metric, over_time
from swarmd.sim.metrics.window import presence
from swarmd.sim.trace import WORD, Trace

PREFIX = "report:"
ROBOTS: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {
        "mean": np.nanmean,
        "median": np.nanmedian,
        "min": np.nanmin,
        "max": np.nanmax,
        "std": np.nanstd,
        "sum": np.nansum,
    }
)
"""Statistics over the robots."""

_MAX_TEXT = int(WORD[1:])  # characters of a text in a trace
_SUFFIXES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {time: ("mean", time) for time in TIMES}
    | {robots: (robots, "late") for robots in ROBOTS}
    | {f"{robots}_{time}": (robots, time) for robots in ROBOTS for time in TIMES}
)
"""Statistics over robots and time, by what stands behind the last point of a name."""


def reported_metric(name: str) -> Metric:
    """The metric of a name `report:...`; ConfigError if it names no key."""
    key, text, robots, time = _parts(name)

    def series(trace: Trace) -> Array | None:
        values = reported(trace, key, text)
        return None if values is None else _over_robots(values, robots)

    def value(trace: Trace) -> float | None:
        values = series(trace)
        return None if values is None else over_time(values, trace.t, time)

    what = f"share of the robots whose {key} is {text!r}" if text else f"reported {key}"
    return Metric(
        name=name,
        unit="share" if text and robots == "mean" else "",
        meaning=f"{what}: {robots} over the robots, {time} over time",
        source="reports of the robots",
        value=value,
        series=series,
    )


def reported(trace: Trace, key: str, text: str = "") -> Array | None:
    """(T, n) what each robot reports as `key`, NaN where absent; None if no robot ever did.

    With a text: 1 where the robot reports it, and 0 where it reports another.
    """
    if text:
        words = trace.words.get(key)
        if words is None:
            return None
        is_same = words == np.array(text, dtype=WORD)
        values = np.where(words == "", np.nan, is_same.astype(np.float64))
    elif key in trace.report:
        values = trace.report[key]
    else:
        return None
    return np.where(presence(trace), values, np.nan)


def check_reported(name: str, trace: Trace) -> None:
    """ConfigError with the nearest name if no robot of the trace reports what the metric takes."""
    key, text, _, _ = _parts(name)
    texts = [str(one) for one in np.unique(trace.words[key]) if one] if key in trace.words else []
    if text[:_MAX_TEXT] in texts or (not text and key in trace.report):
        return
    if texts and not text:
        listed = ", ".join(f"{key}={one}" for one in texts)
        raise ConfigError(f"metric {name!r}: {key} is a text; name one: {listed}")
    if texts:
        known = texts + [f"{one}.{suffix}" for one in texts for suffix in _SUFFIXES]
        raise ConfigError(f"metric {name!r}: {unknown(f'reported {key}', text, known)}")
    stem, _, _ = key.rpartition(".")
    known = [*trace.report, *trace.words]
    known += [f"{stem}.{suffix}" for suffix in _SUFFIXES] if stem in trace.report else []
    raise ConfigError(f"metric {name!r}: {unknown('reported value', key, known)}")


def _parts(name: str) -> tuple[str, str, str, str]:
    """Key, text, statistic over the robots, statistic over time."""
    body = name.removeprefix(PREFIX)
    stem, _, suffix = body.rpartition(".")
    robots, time = _SUFFIXES.get(suffix, ("", ""))
    if not (stem and robots):
        stem, robots, time = body, "mean", "late"
    key, equals, text = stem.partition("=")
    if not key or (equals and not text):
        raise ConfigError(
            f"metric {name!r}: expected {PREFIX}KEY, {PREFIX}KEY.max_end or {PREFIX}KEY=TEXT"
        )
    return key, text, robots, time


def _over_robots(values: Array, robots: str) -> Array:
    """(T,) of values (T, n); NaN where no robot has one."""
    found = np.full(len(values), np.nan)
    is_known = ~np.isnan(values).all(axis=1)
    if is_known.any():
        found[is_known] = ROBOTS[robots](values[is_known], axis=1)
    return found

"""Metrics of reports of patterns and readings of sensors: `report:KEY[=TEXT]`, `reading:KEY`.

The values of the robots are first combined over the robots, then over time. A suffix of the name
chooses the statistics: `report:KEY.ROBOTS_TIME`, `report:KEY.ROBOTS` or `report:KEY.TIME`.

- ROBOTS: mean (default), median, min, max, std or sum.
- TIME: start, end, late (default: the mean of the last 60 s), mean, min, max or std.
- A single word that is in both lists is ROBOTS.

Examples: `report:value`, `report:value.max`, `reading:battery.min_end`.

With TEXT the value of a robot is 1 while it reports this text, else 0: `report:state=wait` is the
share of the robots that wait. A reading has no TEXT. Only present robots with a value of KEY count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.sim.metrics.metric import SHARE, TIMES, Metric, over_time
from swarmd.sim.metrics.window import presence
from swarmd.sim.trace import WORD, Trace
from swarmd.sim.world.item_kind import DELIVERED, HELD

_REPORT = "report:"
_READING = "reading:"
PREFIXES = _REPORT, _READING
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

_UNITS = {HELD: "items", DELIVERED: "items", "_distance": "m", "_bearing": "rad"}
"""Units of readings by their key, or by the end of their key."""

_MAX_TEXT = int(WORD[1:])  # characters of a text in a trace
_SUFFIXES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {time: ("mean", time) for time in TIMES}
    | {robots: (robots, "late") for robots in ROBOTS}
    | {f"{robots}_{time}": (robots, time) for robots in ROBOTS for time in TIMES}
)
"""Statistics over robots and over time, by the suffix of a name, after the last point."""


def reported_metric(name: str, report_units: Mapping[str, str]) -> Metric:
    """The metric of a name `report:...` or `reading:...`; ConfigError for a name without key.

    `report_units`: units by the keys of reports.
    """
    parts = _parts(name)  # key, text, and the statistics over robots and over time
    is_report = parts.prefix == _REPORT

    def series(trace: Trace) -> Array | None:
        values = _values(trace, parts)
        return None if values is None else _over_robots(values, parts.robots)

    def value(trace: Trace) -> float | None:
        values = series(trace)
        return None if values is None else over_time(values, trace.t, parts.time)

    what = f"{'reported' if is_report else 'reading'} {parts.key}"
    if parts.text:
        what = f"share of the robots whose {parts.key} is {parts.text!r}"
    return Metric(
        name=name,
        unit=_unit(parts, report_units),
        meaning=f"{what}: {parts.robots} over the robots, {parts.time} over time",
        source=f"{'reports' if is_report else 'readings'} of the robots",
        value=value,
        series=series,
        bounds=SHARE if parts.text and parts.robots != "sum" else None,
    )


def _unit(parts: _Parts, report_units: Mapping[str, str]) -> str:
    """The unit of a count of robots, a report, or a reading of the world; empty if unknown."""
    if parts.text:
        return {"mean": "share", "sum": "robots"}.get(parts.robots, "")
    if parts.prefix == _REPORT:
        return report_units.get(parts.key, "")
    return _UNITS.get(parts.key) or _UNITS.get(f"_{parts.key.rpartition('_')[2]}", "")


def check_reported(name: str, trace: Trace) -> None:
    """ConfigError with the nearest name if no robot of the trace gives the report or reading."""
    prefix, key, text, _, _ = _parts(name)
    numbers, words = _named(trace, prefix)
    texts = [str(word) for word in np.unique(words[key]) if word] if key in words else []
    has_text = text[:_MAX_TEXT] in texts  # a trace keeps the beginning of a long text
    has_number = not text and key in numbers
    if has_text or has_number:
        return
    # What was meant instead: a text of this key, or another key, maybe with a suffix.
    if texts and not text:
        listed = ", ".join(f"{key}={word}" for word in texts)
        raise ConfigError(f"metric {name!r}: {key} is a text; name one: {listed}")
    if texts:
        known = texts + [f"{word}.{suffix}" for word in texts for suffix in _SUFFIXES]
        raise ConfigError(f"metric {name!r}: {unknown(f'reported {key}', text, known)}")
    stem, _, _ = key.rpartition(".")
    known = [*numbers, *words]
    known += [f"{stem}.{suffix}" for suffix in _SUFFIXES] if stem in numbers else []
    kind = "reported value" if prefix == _REPORT else "reading"
    raise ConfigError(f"metric {name!r}: {unknown(kind, key, known)}")


class _Parts(NamedTuple):
    """The parts of a name; `robots` and `time` are the statistics over robots and over time."""

    prefix: str
    key: str
    text: str
    robots: str
    time: str


def _parts(name: str) -> _Parts:
    prefix = next(known_prefix for known_prefix in PREFIXES if name.startswith(known_prefix))
    body = name.removeprefix(prefix)
    stem, _, suffix = body.rpartition(".")
    robots, time = _SUFFIXES.get(suffix, ("", ""))
    if not (stem and robots):
        stem = body
        robots = "mean"
        time = "late"
    key, equals, text = stem.partition("=")
    if not key or (equals and (not text or prefix == _READING)):
        or_text = f" or {prefix}KEY=TEXT" if prefix == _REPORT else ""
        raise ConfigError(f"metric {name!r}: expected {prefix}KEY, {prefix}KEY.max_end{or_text}")
    return _Parts(prefix, key, text, robots, time)


def _named(trace: Trace, prefix: str) -> tuple[Mapping[str, Array], Mapping[str, NDArray[np.str_]]]:
    """The numbers and the texts (T, n) of the robots by key."""
    return (trace.report, trace.words) if prefix == _REPORT else (trace.readings, {})


def _values(trace: Trace, parts: _Parts) -> Array | None:
    """(T, n) the number of each robot, NaN where absent; None if no robot ever had a number.

    With a text: 1 where the robot reports this text, and 0 where it reports another text.
    """
    numbers, words = _named(trace, parts.prefix)
    if parts.key not in (words if parts.text else numbers):
        return None
    if parts.text:
        said = words[parts.key]
        is_same = said == np.array(parts.text, dtype=WORD)
        values = np.where(said == "", np.nan, is_same.astype(np.float64))
    else:
        values = numbers[parts.key]
    return np.where(presence(trace), values, np.nan)


def _over_robots(values: Array, robots: str) -> Array:
    """(T,) of values (T, n); NaN where no robot has a value."""
    over_robots = np.full(len(values), np.nan)
    is_known = ~np.isnan(values).all(axis=1)
    if is_known.any():
        over_robots[is_known] = ROBOTS[robots](values[is_known], axis=1)
    return over_robots

"""The catalog of metrics by name, and the values of metrics for a trace.

`METRICS` are measured for every run. Three more kinds have names that `metric_of` resolves: metrics
of reports and readings (`reported.py`), metrics with a place or a number in their names
(`placed.py`), and custom metrics (`own.py`). Names are columns of tables and keys of files.

`late` in a name: the last 60 s of a run, or the last half of a run shorter than 120 s. A value is
None if the trace lacks the data, or if the metric has no value, such as the time to an event that
never happened.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.sim.metrics import (
    aggregation,
    clearance,
    collective_motion,
    consensus,
    contacts,
    coverage,
    delivery,
    formation,
    gap,
    kinematics,
    protection,
    radio_graph,
)
from swarmd.sim.metrics.metric import Better, Metric
from swarmd.sim.metrics.own import installed_metrics, metric_of_file
from swarmd.sim.metrics.placed import KINDS, is_placed, placed_metric
from swarmd.sim.metrics.reported import PREFIXES, check_reported, reported_metric
from swarmd.sim.trace import Trace

__all__ = ["METRICS", "Better", "Metric", "measure", "metric_of", "series"]

_ALL = (
    *aggregation.METRICS,
    *coverage.METRICS,
    *radio_graph.METRICS,
    *collective_motion.METRICS,
    *formation.METRICS,
    *kinematics.METRICS,
    *consensus.METRICS,
    *contacts.METRICS,
    *gap.METRICS,
    *clearance.METRICS,
    *delivery.METRICS,
    *protection.METRICS,
)
METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _ALL})
"""By name, in display order."""

NO_UNITS: Mapping[str, str] = MappingProxyType({})


def measure(trace: Trace, names: Iterable[str | Metric] | None = None) -> dict[str, float | None]:
    """The values of the metrics `names` (None: METRICS) for a trace, by name; true is 1.

    ConfigError for an unknown name. MetricError if a custom metric fails.
    """
    wanted = map(metric_of, METRICS if names is None else names)
    return {metric.name: _plain(metric.value(trace)) for metric in wanted}


def series(trace: Trace, name: str | Metric) -> Array | None:
    """(T,) a metric over time, NaN where unknown; None if the trace lacks the data.

    ConfigError for an unknown metric, and for a metric that is defined for whole runs alone.
    """
    metric = metric_of(name)
    if metric.series is None:
        known = ", ".join(m.name for m in METRICS.values() if m.series is not None)
        raise ConfigError(
            f"metric {metric.name} is defined for whole runs only; over time there are {known}"
        )
    return metric.series(trace)


def metric_of(
    name: str | Metric,
    digest: str = "",
    report_units: Mapping[str, str] = NO_UNITS,
    others: Iterable[str] = (),
) -> Metric:
    """The metric of that name; ConfigError with the nearest name if it is unknown.

    A name is one of METRICS, `report:KEY...`, `reading:KEY...`, one of `placed.KINDS` with its
    values, `FILE.py:FUNCTION`, or the name of an installed metric. `digest`: the SHA-256 that FILE
    must have; empty: any. `report_units`: units by the keys of reports, as patterns declare them.
    `others`: further names that the message about an unknown name may suggest.
    """
    if isinstance(name, Metric):
        return name
    if name in METRICS:
        return METRICS[name]
    if name.startswith(PREFIXES):
        return reported_metric(name, report_units)
    if is_placed(name):
        return placed_metric(name)
    if names_file(name):
        return metric_of_file(name, digest)
    installed = installed_metrics()
    if name not in installed:
        raise ConfigError(
            f"{unknown('metric', name, (*METRICS, *KINDS, *installed, *others))}"
            f" (one in a file of your own: FILE.py:{name.rpartition(':')[2]})"
        )
    return installed[name]


def names_file(name: str) -> bool:
    """Whether the name is FILE.py:FUNCTION, for which `metric_of` imports the file."""
    is_other = name in METRICS or name.startswith(PREFIXES) or is_placed(name)
    return ".py:" in name and not is_other


def check_has_value(metric: Metric, trace: Trace) -> None:
    """ConfigError with the nearest name if no robot of the trace has the report or reading."""
    if metric.name.startswith(PREFIXES):
        check_reported(metric.name, trace)


def beyond_catalog(metrics: Iterable[Metric]) -> list[Metric]:
    """The metrics that are not in METRICS, without repetitions."""
    return list({(m.name, m.origin): m for m in metrics if m.name not in METRICS}.values())


def _plain(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)

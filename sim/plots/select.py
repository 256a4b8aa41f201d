"""What of an experiment is worth a picture: which metrics, and which of the runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.experiments.results import Results
from swarmd.sim.metrics.catalog import METRICS

OVER_TIME = (
    "mean_distance_to_centroid_late",
    "one_cluster_at_end",
    "largest_cluster",
    "nearest_neighbor_median_late",
    "consensus_share",
    "radio_components_end",
    "minimum_gap",
    "mean_speed_late_share",
    "protection_duty_late",
)
"""The metrics that are drawn over time if nobody says which."""

RUN_BY_RUN = (
    *("mean_distance_to_centroid_30s", "mean_distance_to_centroid_late"),
    *("one_cluster_at_end", "time_in_one_cluster_late", "largest_cluster_peak", "gather_time"),
    *("nearest_neighbor_median_late", "consensus_time", "consensus_share", "minimum_gap"),
    *("robot_contacts", "arena_contacts", "box_contacts", "mean_speed_late_share"),
    *("protection_duty_late", "command_alteration"),
)
"""The metrics whose values are drawn run by run if nobody says which."""

_CHIEF = (
    *("consensus_share", "consensus_time", "mean_distance_to_centroid_late"),
    *RUN_BY_RUN,
)
_MOMENTS = ("_at_end", "_end", "_late", "_30s", "_start", "_peak")
_FLICKERING = ("mean_speed", "protection_duty", "command_alteration")


def label_of(metric: str) -> str:
    """A metric's name as words."""
    return metric.replace("_", " ")


def stem_of(metric: str) -> str:
    """A metric's name without the moment at which it is taken: what its series is of."""
    for moment in _MOMENTS:
        metric = metric.replace(moment, "")
    return metric


def smoothing_of(metric: str) -> float:
    """Seconds over which a metric's series is averaged to be read; 0 if it can be read as it is.

    What flickers from instant to instant, since it counts sweeps or differs places.
    """
    return 2.0 if metric.startswith(_FLICKERING) else 0.0


def metrics_over_time(names: Sequence[str]) -> list[str]:
    """Those that have a series, one for each that differs."""
    by_stem: dict[str, str] = {}
    for name in names:
        if name in METRICS and METRICS[name].series is not None:
            by_stem.setdefault(stem_of(name), name)
    return list(by_stem.values())


def primary_metric(results: Results, names: Sequence[str] | None) -> str | None:
    """The metric by which runs are told apart: the first of `names` whose values differ.

    Without names, of those that matter most; None if none has a value.
    """
    known = [name for name in (_CHIEF if names is None else names) if name in results.metrics]
    values = {name: results.metric(name) for name in known}
    has_value = [name for name in known if np.isfinite(values[name]).any()]
    differing = [name for name in has_value if np.ptp(_finite(values[name])) > 0.0]
    return next(iter((*differing, *has_value)), None)


def typical_first(values: Array) -> list[int]:
    """Indices (runs,) by how far a value is from the median; those without one come last."""
    known = _finite(values)
    if not len(known):
        return list(range(len(values)))
    away = np.abs(values - np.median(known))
    return _order(np.where(np.isnan(away), np.inf, away))


def worst_first(values: Array, metric: str) -> tuple[list[int], str]:
    """Indices from the worst on, and what the first is called.

    Where it depends on the task which way is good, that is the least typical one.
    """
    better = METRICS[metric].better if metric in METRICS else None
    if better is None:
        known = [index for index in typical_first(values) if not np.isnan(values[index])]
        return known[::-1], "least typical"
    bad = np.where(np.isnan(values), -np.inf, values if better == "less" else -values)
    return _order(-bad), "worst"


def _order(values: Array) -> list[int]:
    return [int(index) for index in np.argsort(values, kind="stable")]


def _finite(values: Array) -> Array:
    known: Array = values[np.isfinite(values)]
    return known

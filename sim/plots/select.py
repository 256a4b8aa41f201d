"""The selection of metrics, runs and events for the figures of an experiment, and of panels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.kit.params import schema
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.sim.experiments.plan import Plan, Variant, shown
from swarmd.sim.experiments.results import Results
from swarmd.sim.metrics.catalog import METRICS, Better, Metric
from swarmd.sim.plots.theme import finite
from swarmd.sim.trace import Trace

OVER_TIME = (
    "mean_distance_to_centroid_late",
    "one_cluster_at_end",
    "largest_cluster",
    "gather_time",
    "nearest_neighbor_median_late",
    "consensus_share",
    "consensus_time",
    "radio_components_end",
    "minimum_gap",
    "mean_speed_late_share",
    "protection_duty_late",
)
"""The metrics that are drawn over time by default."""

RUN_BY_RUN = (
    *("mean_distance_to_centroid_30s", "mean_distance_to_centroid_late"),
    *("one_cluster_at_end", "time_in_one_cluster_late", "largest_cluster_peak", "gather_time"),
    *("nearest_neighbor_median_late", "consensus_time", "consensus_share", "minimum_gap"),
    *("robot_contacts", "arena_contacts", "box_contacts", "mean_speed_late_share"),
    *("protection_duty_late", "command_alteration"),
)
"""The metrics whose values are drawn run by run by default."""

_PRIMARY = (*("consensus_share", "consensus_time", "mean_distance_to_centroid_late"), *RUN_BY_RUN)
MAX_EVENTS = 12
_TOO_CLOSE = 0.025  # of the duration: labels of closer events would overlap
_SUFFIXES = ("_at_end", "_end", "_late", "_30s", "_start", "_peak")
_FLICKERING = ("mean_speed", "protection_duty", "command_alteration")


def label_of(metric: str) -> str:
    """A metric's name with blanks, without its file or the word report."""
    return metric.rpartition(":")[2].replace("_", " ")


def stem_of(metric: str) -> str:
    """A metric's name without the time at which it is taken: the name of its series."""
    for suffix in _SUFFIXES:
        metric = metric.replace(suffix, "")
    return metric


def smoothing_of(metric: str) -> float:
    """Seconds over which a metric's series is averaged; 0 without averaging.

    Series that count scans or differentiate positions are averaged, since they change from instant
    to instant.
    """
    return 2.0 if metric.startswith(_FLICKERING) else 0.0


def metrics_over_time(metrics: Iterable[Metric]) -> list[Metric]:
    """The metrics that can be drawn over time, one for each series."""
    by_stem: dict[str, Metric] = {}
    for metric in metrics:
        if metric.series is not None or metric.is_time_to_event:
            by_stem.setdefault(stem_of(metric.name), metric)
    return list(by_stem.values())


def primary_metric(results: Results, metrics: Sequence[Metric] | None) -> Metric | None:
    """The metric that ranks runs: the first of `metrics` whose values differ.

    Without `metrics`, the first of a default list. None if no metric has a value.
    """
    if metrics is None:
        metrics = [METRICS[name] for name in _PRIMARY]
    metrics = [
        metric for metric in metrics if metric.name in results.metrics or metric.name not in METRICS
    ]
    values = [finite(results.metric(metric)) for metric in metrics]
    has_value = [metric for metric, known in zip(metrics, values, strict=True) if known.size]
    differing = [
        m for m, known in zip(metrics, values, strict=True) if known.size and np.ptp(known)
    ]
    return next(iter((*differing, *has_value)), None)


def typical_first(values: Array) -> list[int]:
    """Indices (runs,) by distance from the median; runs without a value come last."""
    known = finite(values)
    if not len(known):
        return list(range(len(values)))
    away = np.abs(values - np.median(known))
    return _order(np.where(np.isnan(away), np.inf, away))


def worst_first(values: Array, better: Better | None) -> tuple[list[int], str]:
    """The indices of runs in order from the worst run on, and the name of the first run.

    `better`: the better direction of the metric. The first run is "worst". Without a better
    direction (None) it is the run farthest from the median, and its name is "least typical".
    """
    if better is None:
        known = [index for index in typical_first(values) if not np.isnan(values[index])]
        return known[::-1], "least typical"
    bad = np.where(np.isnan(values), -np.inf, values if better == "less" else -values)
    return _order(-bad), "worst"


def events_of(trace: Trace) -> tuple[tuple[float, str], ...]:
    """Time in s and label of each event after the start; empty if there are too many to draw."""
    marks: list[tuple[float, list[str]]] = []
    for event in trace.meta.get("events", ()):
        at = float(event["at"])
        word = _label(event, len(trace.ids))
        if at <= 0.0:
            continue
        if marks and at - marks[-1][0] < _TOO_CLOSE * trace.duration:
            if word not in marks[-1][1]:
                marks[-1][1].append(word)
        else:
            marks.append((at, [word]))
    if len(marks) > MAX_EVENTS:
        return ()
    return tuple((at, ", ".join(words)) for at, words in marks)


def _order(values: Array) -> list[int]:
    return [int(index) for index in np.argsort(values, kind="stable")]


def _label(event: Mapping[str, Any], n: int) -> str:
    robots = event.get("robots") or ()
    which = f"{len(robots)} robots" if len(robots) > 1 else "".join(robots)
    words = [event["action"], event.get("pattern") or "", "" if len(robots) == n else which]
    return " ".join(word for word in words if word)


@dataclass(frozen=True, slots=True)
class Quantity:
    """The quantity of an axis, a swept key or a metric; `unit` may be empty."""

    name: str
    unit: str = ""

    @staticmethod
    def parse(text: str) -> Quantity:
        """The quantity of a text such as `lidar range [m]`."""
        name, _, unit = text.partition("[")
        return Quantity(name.strip(), unit.strip().removesuffix("]")) if unit else Quantity(text)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def at(self, value: Any) -> str:
        """The quantity with a value."""
        return f"{self.name}={shown(value)} {self.unit}".rstrip()


def swept_quantities(plan: Plan, labels: Mapping[str, str]) -> dict[str, Quantity]:
    """The quantity of each swept key of a plan; `labels`: texts by key or by its last part."""
    quantities = {}
    for key in plan.sweep:
        short = key.rpartition(".")[2]
        text = labels.get(key, labels.get(short))
        quantities[key] = Quantity.parse(text) if text else Quantity(short, _unit_of(plan, key))
    return quantities


def _unit_of(plan: Plan, key: str) -> str:
    """The unit of a swept key, if it is a pattern's parameter or one of _UNITS; else empty."""
    words = key.split(".")  # of a pattern's parameter: groups, GROUP, parameters, NAME
    if len(words) < 2 or words[-2] != "parameters":
        return _UNITS.get(key, "")
    group = words[1]
    name = words[-1]
    patterns = {
        variant.effective.get("groups", {}).get(group, {}).get("pattern")
        for variant in plan.variants
    }
    origins = pattern_names(None)
    for pattern in sorted(patterns & origins.keys()):
        origin = origins[pattern]
        load = PatternLoader({pattern: (origin.value, origin.is_file)})
        for parameter in schema(load(pattern).params_type) if not origin.is_file else ():
            if parameter.name == name:
                return parameter.unit
    return ""


_UNITS = {"duration": "s", "radio.range": "m", "start.clearance": "m"}


@dataclass(frozen=True, slots=True)
class Facet:
    """The place of a variant in a figure."""

    panel: str  # the title of its panel; empty without facets
    label: str  # the variant's label in the panel
    axis: str = ""  # the quantity of which the labels are values; empty if labels name it


def facets_of(
    plan: Plan, key: str | None, alone: str, labels: Mapping[str, str] | None = None
) -> dict[str, Facet]:
    """The facet of each variant, by the variant's name: its panel, and its label in the panel.

    - `key`: each value of this swept key has a panel; None: all variants are in one panel.
    - `alone`: the label of a variant that is alone in its panel.
    - `labels`: by swept key, the text that stands for the key.

    The last word of a swept key may stand for the whole key. ConfigError with the nearest key if
    `key` was not swept.
    """
    quantities = swept_quantities(plan, labels or {})
    if key is None:
        return {one.name: _facet("", one, quantities, alone) for one in plan.variants}
    short = {name.rpartition(".")[2]: name for name in plan.sweep}
    full = key if key in plan.sweep else short.get(key)
    if full is None:
        if not plan.sweep:
            raise ConfigError(f"--facet {key}: nothing was swept; run with --sweep {key}=A,B")
        raise ConfigError(f"--facet: {unknown('swept key', key, (*plan.sweep, *short))}")
    own = quantities.pop(full)
    return {
        one.name: _facet(own.at(one.values[full]), one, quantities, alone) for one in plan.variants
    }


def _facet(panel: str, one: Variant, quantities: Mapping[str, Quantity], alone: str) -> Facet:
    """The facet of a variant that the values of `quantities` distinguish in its panel."""
    if len(quantities) == 1:
        ((key, quantity),) = quantities.items()
        if isinstance(one.values[key], int | float):
            return Facet(panel, shown(one.values[key]), str(quantity))
    rest = [quantity.at(one.values[key]) for key, quantity in quantities.items()]
    return Facet(panel, ", ".join(rest) or alone)

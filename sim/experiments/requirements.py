"""Requirements on the statistics of an experiment, such as `median(gather_time) <= 60`.

The 95 % interval of a mean or median decides: the requirement is met if each value of the interval
meets it, not met if none does, and else undecided. `min`, `max` and `runs` are numbers of the runs
that were made, which say nothing of other seeds, so that the number itself decides.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.results import YES_OR_NO, Results
from swarmd.sim.experiments.statistics import (
    FEW,
    Interval,
    Summary,
    censored_median_interval,
    summarize,
)
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.reported import PREFIXES

RUNS = "runs"
"""The number of finished runs, in place of a metric."""

_STATISTICS = ("mean", "median", "min", "max", "share")
_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    ">": operator.gt,
    "<": operator.lt,
}
# A name may hold `=`, as `report:state=wait` does.
_GRAMMAR = re.compile(
    r"\s*(?:(\w+)\(\s*(\S+?)\s*\)|([^\s()<>]*?[^\s()<>=]))\s*(>=|<=|==|>|<)\s*([^\s<>=]+)\s*"
)


class Verdict(StrEnum):
    """Whether a requirement is met; undecided: the runs leave it open."""

    MET = "met"
    NOT_MET = "not met"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Requirement:
    """`statistic` of `metric`, compared with `value`; `text` is what the user wrote."""

    text: str
    statistic: str
    metric: str
    """A name, or the names of several metrics with `+` between them: the sum of their values."""
    comparison: str
    value: float

    @property
    def metrics(self) -> tuple[str, ...]:
        """The names of the metrics."""
        return metrics_in(self.metric)


@dataclass(frozen=True, slots=True)
class RequirementFinding:
    """The check of a requirement on one variant of an experiment."""

    requirement: Requirement
    variant: str
    value: float | None
    """The statistic; None if it does not exist."""
    interval: Interval | None
    """The 95 % interval of a mean or median; None without one."""
    remark: str
    """Why the statistic does not exist, or how many runs never had the event; else empty."""
    verdict: Verdict
    """By the interval. Not met without a value; undecided with a mean or median that has none."""
    few: int = 0
    """The number of runs of a bootstrap interval, if they are fewer than FEW; else 0."""

    @property
    def is_sure(self) -> bool:
        """True if the requirement is met, and not by a bootstrap interval of few runs."""
        return self.verdict is Verdict.MET and not self.few

    def document(self) -> dict[str, Any]:
        """The finding as plain values; None for an infinite end of the interval."""
        ends = self.interval and [end if math.isfinite(end) else None for end in self.interval]
        return {
            "requirement": self.requirement.text,
            "variant": self.variant,
            "value": self.value,
            "interval": ends,
            "met": self.verdict is Verdict.MET,
            "verdict": self.verdict,
            "sure": self.is_sure,
            "remark": self.remark,
        }


def parse_requirement(text: str) -> Requirement:
    """The requirement of a text `METRIC >= VALUE` or `STATISTIC(METRIC) >= VALUE`.

    METRIC may be a sum, `robot_contacts+arena_contacts`. Without a statistic the mean is compared.
    ConfigError names the text and its fault.
    """
    match = _GRAMMAR.fullmatch(text)
    wanted = "expected one such as 'median(gather_time) <= 60', with >= <= > < or =="
    if match is None:
        raise ConfigError(f"requirement {text!r}: {wanted}")
    statistic, inner, bare, comparison, number = match.groups()
    if statistic is not None and statistic not in _STATISTICS:
        raise ConfigError(f"requirement {text!r}: {unknown('statistic', statistic, _STATISTICS)}")
    value = float(number) if number in ("inf", "-inf") else finite_number(number)
    if math.isnan(value):
        raise ConfigError(f"requirement {text!r}: {number!r} is no number; {wanted}")
    return Requirement(text, statistic or "mean", inner or bare, comparison, value)


def metrics_in(name: str) -> tuple[str, ...]:
    """The metrics of a name with `+` between them; a key of a report or reading may hold a `+`."""
    return (name,) if name.startswith(PREFIXES) else tuple(name.split("+"))


def measured(results: Results, name: str, variant: str | None = None) -> tuple[Array, Metric]:
    """The values (runs,) of a metric or of a sum of metrics, and the first of the metrics.

    NaN: a run without a value of one of them. For a time to an event that is inf: the event never
    happened. `variant`: None for the runs of all variants. ConfigError with the nearest name for an
    unknown metric, and for a sum with a time to an event.
    """
    metrics = [results.about(one) for one in metrics_in(name)]
    if len(metrics) > 1 and (event := next((m for m in metrics if m.is_time_to_event), None)):
        raise ConfigError(f"{name}: {event.name} is the time to an event, which has no sum")
    values = np.sum([results.metric(metric, variant) for metric in metrics], axis=0)
    if metrics[0].is_time_to_event:
        values = np.where(np.isnan(values), np.inf, values)
    return values, metrics[0]


def check(requirement: Requirement, side: Side) -> RequirementFinding:
    """Check a requirement on one variant; ConfigError with the nearest name for unknown metrics."""
    results = side.results
    name = requirement.metric
    if name == RUNS:
        runs = float(len(results.seeds(side.variant)))
        return RequirementFinding(
            requirement, side.variant, runs, None, "", verdict_of(requirement, Interval(runs, runs))
        )
    values, metric = measured(results, name, side.variant)
    values = np.where(np.isinf(values), np.nan, values)
    is_single = len(requirement.metrics) == 1
    summary = summarize(
        values,
        is_share=is_single and metric.unit == YES_OR_NO,
        is_time_to_event=metric.is_time_to_event,
    )
    value: float | None = getattr(summary, requirement.statistic)
    interval = None
    if requirement.statistic == "mean":
        interval = summary.share_interval or summary.mean_interval
    elif requirement.statistic == "share":
        interval = summary.share_interval
    elif requirement.statistic == "median" and summary.never:
        interval = censored_median_interval(values)
    elif requirement.statistic == "median":
        interval = summary.median_interval
    is_bootstrap = interval is not None and not summary.share_interval and not summary.never
    few = summary.n if is_bootstrap and summary.n < FEW else 0
    if value is None and interval is None:
        verdict = Verdict.NOT_MET
    elif value is not None and requirement.statistic in ("min", "max"):
        verdict = verdict_of(requirement, Interval(value, value))
    else:
        verdict = verdict_of(requirement, interval or Interval(-math.inf, math.inf))
    remark = _remark(summary, requirement.statistic, value)
    return RequirementFinding(requirement, side.variant, value, interval, remark, verdict, few)


def verdict_of(requirement: Requirement, interval: Interval) -> Verdict:
    """What an interval says of a requirement."""
    compare = _COMPARISONS[requirement.comparison]
    is_met_at = {compare(end, requirement.value) for end in interval}
    # An interval around the wanted value of `==` has no end that meets it, and does not exclude it.
    if len(is_met_at) == 2 or interval.low < requirement.value < interval.high:
        return Verdict.UNDECIDED
    return Verdict.MET if True in is_met_at else Verdict.NOT_MET


def _remark(summary: Summary, statistic: str, value: float | None) -> str:
    if summary.never:
        return f"{summary.never} of {summary.n + summary.never} runs never had it"
    if value is None:
        return f"no run has a {statistic} of it"
    return ""

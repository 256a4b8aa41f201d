"""Requirements on the statistics of an experiment, such as `median(gather_time) <= 60`."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import finite_number
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.statistics import Interval, Summary

RUNS = "runs"
"""The number of finished runs, in place of a metric."""

_STATISTICS = ("mean", "median", "min", "max")
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


@dataclass(frozen=True, slots=True)
class Requirement:
    """`statistic` of `metric`, compared with `value`; `text` is what the user wrote."""

    text: str
    statistic: str
    metric: str
    comparison: str
    value: float


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
    is_met: bool

    def document(self) -> dict[str, Any]:
        """The finding as plain values."""
        return {
            "requirement": self.requirement.text,
            "variant": self.variant,
            "value": self.value,
            "interval": self.interval,
            "met": self.is_met,
            "remark": self.remark,
        }


def parse_requirement(text: str) -> Requirement:
    """The requirement of a text `METRIC >= VALUE` or `STATISTIC(METRIC) >= VALUE`.

    Without a statistic the mean is compared. ConfigError names the text and its fault.
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


def check(requirement: Requirement, side: Side) -> RequirementFinding:
    """Check a requirement on one variant; ConfigError with the nearest name for unknown metrics."""
    results, name = side.results, requirement.metric
    interval, remark = None, ""
    value: float | None
    if name == RUNS:
        value = float(len(results.seeds(side.variant)))
    else:
        metric = results.about(name)
        summary = results.summary(side.variant, [metric])[metric.name]
        value = getattr(summary, requirement.statistic)
        remark = _remark(summary, requirement.statistic, value)
        if requirement.statistic == "mean":
            interval = summary.share_interval or summary.mean_interval
        elif requirement.statistic == "median":
            interval = summary.median_interval
    is_met = value is not None and _COMPARISONS[requirement.comparison](value, requirement.value)
    return RequirementFinding(requirement, side.variant, value, interval, remark, is_met)


def _remark(summary: Summary, statistic: str, value: float | None) -> str:
    if summary.never:
        return f"{summary.never} of {summary.n + summary.never} runs never had it"
    if value is None:
        return f"no run has a {statistic} of it"
    return ""

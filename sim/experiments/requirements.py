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

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import finite_number
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.statistics import FEW, Interval, Summary, censored_median_interval

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
    results = side.results
    name = requirement.metric
    if name == RUNS:
        runs = float(len(results.seeds(side.variant)))
        return RequirementFinding(
            requirement, side.variant, runs, None, "", _verdict(requirement, Interval(runs, runs))
        )
    metric = results.about(name)
    summary = results.summary(side.variant, [metric])[metric.name]
    value: float | None = getattr(summary, requirement.statistic)
    interval = None
    if requirement.statistic == "mean":
        interval = summary.share_interval or summary.mean_interval
    elif requirement.statistic == "median" and summary.never:
        interval = censored_median_interval(results.metric(metric, side.variant))
    elif requirement.statistic == "median":
        interval = summary.median_interval
    is_bootstrap = interval is not None and not summary.share_interval and not summary.never
    few = summary.n if is_bootstrap and summary.n < FEW else 0
    if value is None and interval is None:
        verdict = Verdict.NOT_MET
    elif value is not None and requirement.statistic in ("min", "max"):
        verdict = _verdict(requirement, Interval(value, value))
    else:
        verdict = _verdict(requirement, interval or Interval(-math.inf, math.inf))
    remark = _remark(summary, requirement.statistic, value)
    return RequirementFinding(requirement, side.variant, value, interval, remark, verdict, few)


def _verdict(requirement: Requirement, interval: Interval) -> Verdict:
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

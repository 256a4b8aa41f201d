"""The benchmark suite: scenarios with `patterns` and a `metric`, and the ranks of their patterns.

A task is a scenario whose groups without a pattern run several patterns in turn: a sweep of the
scenario's key `pattern`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.operator.texts.values import NOTHING
from swarmd.plugins import find_pattern, is_pattern_path, pattern_at
from swarmd.sim.experiments.plan import Plan
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.statistics import Summary, summarize
from swarmd.sim.metrics.catalog import metric_of, names_file
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.scenarios.scenariofile import load_scenario

HEADER = ("TASK", "RANK", "PATTERN", "MEDIAN", "95 %", "UNIT", "RUNS")
_KEY = "pattern"  # the swept key


def plan_of_task(
    scenario: str,
    seeds: Iterable[int],
    patterns: Sequence[str] = (),
    plugin_dir: Path | None = None,
    on_misfit: Callable[[str], object] = str,
    values: Mapping[str, Any] | None = None,
) -> tuple[Plan, Metric] | None:
    """The runs of a scenario with each pattern, and the scenario's metric.

    None if there is no pattern to run. `patterns`: names or paths, empty for those of the
    scenario's file. `on_misfit` is called with a line for each of `patterns` that needs what the
    robots do not provide. `values`: overrides by dotted key.

    ConfigError for an unknown pattern, for a fault of the file or of `values`, and unless the file
    names a metric with a better direction. A metric of a Python file is refused: it would run code
    of the author of the scenario.
    """
    sets = dict(values or {})
    if _KEY in sets:
        raise ConfigError(f"--set {_KEY}: a task runs several; give --pattern NAME")
    if plugin_dir is not None and "plugin_dir" in sets:
        raise ConfigError("--plugin-dir and --set plugin_dir=..: keep one of them")
    if plugin_dir is not None:
        sets["plugin_dir"] = str(plugin_dir)
    loaded = load_scenario(scenario, sets)
    name = loaded.effective["metric"]
    try:
        metric = None if name is None or names_file(name) else metric_of(name)
    except ConfigError as error:
        raise ConfigError(f"{scenario}: metric: {error}") from error
    if metric is None or metric.better is None:
        text = f"{scenario}: metric is {name}; expected one with a better direction, and no file"
        raise ConfigError(f"{text}; see `exp metrics`")
    chosen = [] if patterns else [*loaded.effective["patterns"]]
    if not (chosen or patterns):
        on_misfit(f"{scenario} names no patterns; give --pattern NAME")
    for pattern in patterns:
        if is_pattern_path(pattern):
            pattern_at(pattern)  # ConfigError if there is none
        else:
            find_pattern(pattern, loaded.plugin_dir)
        try:
            load_scenario(scenario, {**sets, _KEY: pattern})
            chosen.append(pattern)
        except ConfigError as error:
            on_misfit(f"{pattern} does not fit {Path(scenario).stem}: {error}")
    return (plan_of(scenario, seeds, sets, {_KEY: chosen}), metric) if chosen else None


def task_of(plan: Plan) -> str:
    """The name of the task: that of the scenario without its folder."""
    return Path(plan.scenario).stem


@dataclass(frozen=True, slots=True)
class Standing:
    """A pattern among the patterns of a task."""

    task: str
    pattern: str
    rank: int | None
    """By median, from 1 on; equal medians share a rank. None without a median, and if its interval
    overlaps that of another median or either interval is unknown: other seeds may change the
    order."""
    unit: str
    planned: int
    """The number of runs, of which `summary.n` have a value."""
    summary: Summary


def standings(results: Results) -> list[Standing]:
    """The patterns of a task by their medians of the task's metric, best first, then by name."""
    plan = results.plan
    metric = results.about(plan.variants[0].effective["metric"])
    sign = 1.0 if metric.better == "less" else -1.0
    summaries = {
        variant.values[_KEY]: summarize(results.metric(metric, variant.name))
        for variant in plan.variants
    }
    costs = {
        name: math.inf if summary.median is None else sign * summary.median
        for name, summary in summaries.items()
    }
    found = []
    for name in sorted(costs, key=lambda name: (costs[name], name)):
        own = summaries[name]
        has_rank = own.median is not None and all(
            _is_apart(own, rival) for other, rival in summaries.items() if other != name
        )
        rank = 1 + sum(cost < costs[name] for cost in costs.values()) if has_rank else None
        found.append(Standing(task_of(plan), name, rank, metric.unit, len(plan.seeds), own))
    return found


def _is_apart(a: Summary, b: Summary) -> bool:
    """Whether the intervals of two medians do not overlap; True if `b` has no median."""
    left = a.median_interval
    right = b.median_interval
    if left is None or right is None:
        return b.median is None
    return left.high < right.low or right.high < left.low


def row(standing: Standing, form: str) -> tuple[str, ...]:
    """A row below HEADER, its numbers in the format `form`."""
    summary = standing.summary
    bounds = summary.median_interval
    return (
        standing.task,
        str(standing.rank or NOTHING),
        standing.pattern,
        NOTHING if summary.median is None else f"{summary.median:{form}}",
        NOTHING if bounds is None else f"{bounds.low:{form}} to {bounds.high:{form}}",
        standing.unit,
        f"{summary.n} of {standing.planned}" if summary.n < standing.planned else str(summary.n),
    )

"""Foraging: the items of a group rise with its size, then fall, as robots get in the way."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studies.outcomes.outcome import (
    Outcome,
    at_least,
    at_most,
    mean_of,
    metric,
    no_contacts,
    ratio_of,
    reported,
)
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

NAME = "foraging"
SHORT_FORM = {"sizes": (1, 4), "duration": 120.0}
IS_LONG = True
FILM = {"title": "from the source on the right to the nest", "stop": 120.0}
SIZES = (1, 6, 14, 20)
DURATION = 200.0
DARK = {"fields.0.power": 0.0}
"""Without its lamp a robot finds the nest by chance."""
RISE, FALL, CHANCE = 2.0, 0.8, 0.5
"""The least that the best group delivers, by what a robot alone does; the most that the largest
group delivers, by the best one; the most that a robot without the lamp delivers, by one with it."""
_SOURCE = "Lerman and Galstyan 2002, in words"


def outcomes(
    seeds: Sequence[int], jobs: int = 1, sizes: Sequence[int] = SIZES, duration: float = DURATION
) -> list[Outcome]:
    """Measure how the number of delivered items depends on the size of the group.

    For each seed there is a run of each size, and a run of one robot without the lamp of the nest.
    The first of `sizes` is 1. With more than two sizes the last size must be a crowd, whose robots
    deliver less than the robots of a smaller group. Each outcome has the measured values, their
    bound and the source of the bound.
    """
    alone, largest = sizes[0], sizes[-1]
    runs = {size: run(size, seeds, jobs, duration) for size in sizes}
    # Items a minute of the whole group in each run, and their mean over the runs.
    group_rates = {size: group_rate(results, size) for size, results in runs.items()}
    mean_rates = {size: float(np.mean(rates)) for size, rates in group_rates.items()}
    best = max(sizes, key=lambda size: mean_rates[size])
    rise = ratio_of(group_rates[best], group_rates[alone])
    of_groups = [at_least(NAME, f"the group: items of {best} robots / of one", RISE, rise, _SOURCE)]
    if len(sizes) > 2:
        fall_label = f"the group: items of {largest} robots / of {best}"
        fall = ratio_of(group_rates[largest], group_rates[best])
        robot_rates = [mean_rates[size] / size for size in sizes]
        steps = [more / less if less else np.nan for less, more in itertools.pairwise(robot_rates)]
        step_label = "a robot: items of a size / of that before"
        of_groups += [
            reported(NAME, f"{size} robots: items a minute of the group, mean", mean_of(rates), "-")
            for size, rates in group_rates.items()
        ]
        of_groups.append(at_most(NAME, fall_label, FALL, fall, _SOURCE))
        of_groups.append(at_most(NAME, step_label, 1.0, steps, _SOURCE, len(seeds)))
    dark_rates = group_rate(run(alone, seeds, jobs, duration, DARK), alone)
    dark_ratio = ratio_of(dark_rates, group_rates[alone])
    return [
        *of_groups,
        at_most(
            NAME, "one robot: without the lamp / with it", CHANCE,
            dark_ratio, "ours: random search for the nest",
        ),
        no_contacts(NAME, runs[largest]),
    ]  # fmt: skip


def run(
    robots: int, seeds: Sequence[int], jobs: int, duration: float, more: Mapping[str, Any] = {}
) -> Results:
    """A run of each seed with that many robots."""
    changes = {"groups.tb3.count": robots, "duration": duration, "trace_rate": 1.0, **more}
    return simulate(NAME, seeds, jobs=jobs, set=changes, traces=False)


def group_rate(found: Results, robots: int) -> list[float]:
    """The items a minute of the whole group of `robots` in each run."""
    return [robots * value for value in metric(found, "items_delivered")]

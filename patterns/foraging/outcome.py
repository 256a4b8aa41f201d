"""Foraging: the items of a group rise with its size, then fall, as robots get in the way."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts, ratio_of
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

NAME = "foraging"
SHORT_FORM = {"sizes": (1, 4), "duration": 120.0}
IS_LONG = True
FILM = {"title": "from the source on the right to the nest", "stop": 120.0, "camera": "top"}
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
    """All outcomes: for each seed a run of each size, and one of a robot without a lamp.

    With two sizes the larger one is below the crowd, so that nothing falls.
    """
    runs = {n: run(n, seeds, jobs, duration) for n in sizes}
    items = {n: group_rate(found, n) for n, found in runs.items()}
    mean = {n: float(np.mean(values)) for n, values in items.items()}
    alone, most = sizes[0], sizes[-1]
    best = max(sizes, key=lambda n: mean[n])
    rise = ratio_of(items[best], items[alone])
    dark = ratio_of(group_rate(run(alone, seeds, jobs, duration, DARK), 1), items[alone])
    found = [
        at_least(NAME, f"the group: items of {best} robots / of one", RISE, rise, _SOURCE),
        at_most(
            NAME, "one robot: without the lamp / with it", CHANCE,
            dark, "ours: random search for the nest",
        ),
        no_contacts(NAME, runs[most]),
    ]  # fmt: skip
    if len(sizes) > 2:
        what = f"the group: items of {most} robots / of {best}"
        fall = ratio_of(items[most], items[best])
        found.insert(1, at_most(NAME, what, FALL, fall, _SOURCE))
        robot = [mean[n] / n for n in sizes]
        steps = [later / before for before, later in itertools.pairwise(robot)]
        found.insert(
            2, at_most(NAME, "a robot: items of a size / of that before", 1.0, steps, _SOURCE)
        )
    return found


def run(
    robots: int, seeds: Sequence[int], jobs: int, duration: float, more: Mapping[str, Any] = {}
) -> Results:
    """A run of each seed with that many robots."""
    changes = {"groups.tb3.count": robots, "duration": duration, "trace_rate": 1.0, **more}
    return simulate(NAME, seeds, jobs=jobs, set=changes, traces=False)


def group_rate(found: Results, robots: int) -> list[float]:
    """The items a minute of the whole group in each run."""
    return [robots * value for value in metric(found, "items_delivered")]

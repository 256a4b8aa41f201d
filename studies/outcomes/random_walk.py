"""Random walk: it moves, covers the room, as theory has it for random search, turns both ways."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, number
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.metrics.coverage import COVER, covered_area
from swarmd.sim.trace import Trace

NAME = "random_walk"
FLOOR = 36.0
"""m2, of the scenario's room."""
ALONE = {"groups.tb3.parameters.recovery": False}
"""Protection leads no one around walls: robots that drive straight on would cover as much."""
SPEED, SHARE, GAIN, BIAS, DUTY = 0.5, 0.7, 1.5, 0.75, 0.1
_KOOPMAN = "random search: Koopman, Operations Research 4, 1956"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All of them: a run of walkers a seed, and one of robots that drive straight on."""
    results = simulate(NAME, seeds, jobs=jobs, set=ALONE)
    straight = simulate(NAME, seeds, jobs=jobs, set={**ALONE, "groups.tb3.pattern": "drive"})
    walks = list(results.traces)
    numbers = [measure(trace) for trace in walks]
    speeds = tuple(number(n["mean_speed"]) / 0.22 for n in numbers)
    duty = tuple(number(n["protection_duty"]) for n in numbers)
    touches = tuple(number(n["robot_contacts"]) + number(n["arena_contacts"]) for n in numbers)
    search = tuple(of_random_search(trace) for trace in walks)
    gain = tuple(
        number(covered_area(walk)) / number(covered_area(drive))
        for walk, drive in zip(walks, straight.traces, strict=True)
    )
    bias = (one_sidedness(walks),)
    return [
        Outcome(NAME, "mean speed / limit", f">= {SPEED}", speeds, at_least(SPEED, speeds), "ours"),
        Outcome(
            NAME,
            "floor covered / by random search",
            f">= {SHARE}",
            search,
            at_least(SHARE, search),
            _KOOPMAN,
        ),
        Outcome(NAME, "floor covered / by drive", f">= {GAIN}", gain, at_least(GAIN, gain), "ours"),
        Outcome(
            NAME,
            "turned more to one side than to the other, as a share",
            f"<= {BIAS}",
            bias,
            at_most(BIAS, bias),
            "both sides alike",
        ),
        Outcome(NAME, "protection duty", f"<= {DUTY}", duty, at_most(DUTY, duty), "ours"),
        Outcome(NAME, "touches", "0", touches, at_most(0.0, touches), "docs/safety.md"),
    ]


def of_random_search(trace: Trace) -> float:
    """The floor that was covered, as a share of what random search of the same way covers.

    1 - exp(-w L / A) of the floor A, with a sweep width w of twice 0.5 m and a way L of all robots.
    """
    way = np.hypot(*np.moveaxis(np.diff(trace.pose[..., :2], axis=0), -1, 0)).sum()
    expected = FLOOR * (1.0 - math.exp(-2.0 * COVER * float(way) / FLOOR))
    return number(covered_area(trace)) / expected


def one_sidedness(traces: Sequence[Trace]) -> float:
    """How much further all robots turned to one side than to the other, of all that they turned."""
    turns = np.concatenate([np.diff(trace.pose[..., 2], axis=0).ravel() for trace in traces])
    return float(abs(turns.sum()) / np.abs(turns).sum())

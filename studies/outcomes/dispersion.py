"""Dispersion: the robots reach their distance, keep it and stand; none touches anything."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, number
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.metrics.window import late
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import gaps, transform

NAME = "dispersion"
DISTANCE, TOLERANCE, TOO_FAR = 1.0, 0.03, 1.3
"""m: what the robots keep free, three standard deviations of the lidar, and no more than that."""
LIDAR = (-0.032, 0.0)
"""m, of a Burger's lidar before its axle."""
SETTING = {"groups.tb3.count": 5, "duration": 40}
SPEED, WAY = 0.03, 0.73
_PAPER = "Kaiser et al. 2022, experiment 2"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All of them, of one run a seed."""
    results = simulate(NAME, seeds, jobs=jobs, set=SETTING)
    traces = list(results.traces)
    numbers = [measure(trace) for trace in traces]
    nearest = tuple(late_ranges(trace)[0] for trace in traces)
    loosest = tuple(late_ranges(trace)[1] for trace in traces)
    speeds = tuple(number(n["mean_speed_late_share"]) for n in numbers)
    touches = tuple(number(n["robot_contacts"]) + number(n["arena_contacts"]) for n in numbers)
    ways = tuple(number(n["path_length"]) for n in numbers)
    least = DISTANCE - TOLERANCE
    return [
        Outcome(
            NAME, "least late range [m]", f">= {least}", nearest, at_least(least, nearest), _PAPER
        ),
        Outcome(
            NAME,
            "median late range to the nearest [m]",
            f"<= {TOO_FAR}",
            loosest,
            at_most(TOO_FAR, loosest),
            "it spreads no further than it is told: ours",
        ),
        Outcome(NAME, "mean way [m]", f"<= {WAY}", ways, at_most(WAY, ways), "ours: no detours"),
        Outcome(NAME, "late speed / limit", f"<= {SPEED}", speeds, at_most(SPEED, speeds), _PAPER),
        Outcome(NAME, "touches", "0", touches, at_most(0.0, touches), "docs/safety.md"),
    ]


def late_ranges(trace: Trace, seconds: float = 10.0) -> tuple[float, float]:
    """The least, and the median, of the ranges in m to the nearest other or wall, at the end.

    Truth: from where each lidar is to the outlines of the others and to the walls.
    """
    part = late(trace, seconds)
    n = len(part.ids)
    outlines = np.stack([transform(part.footprint(i), part.pose[:, i]) for i in range(n)], axis=1)
    lidars = np.stack([transform(np.array([LIDAR]), part.pose[:, i]) for i in range(n)], axis=1)
    # A lidar is a very small square.
    square = 1e-6 * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    ranges = np.full((len(part.t), n), np.inf)
    for i in range(n):
        for j in range(n):
            if i != j:
                seen = gaps(lidars[:, i] + square, outlines[:, j])
                ranges[:, i] = np.minimum(ranges[:, i], seen)
    half = 0.5 * float(str(trace.meta["arena"]).split(",")[0].split("x")[0])
    walls = half - np.abs(lidars[:, :, 0]).max(axis=-1)
    ranges = np.minimum(ranges, walls)
    return float(ranges.min()), float(np.median(ranges))

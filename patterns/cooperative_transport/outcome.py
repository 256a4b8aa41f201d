"""Cooperative transport: six robots bring a box to the lamp that one robot cannot move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, no_contacts, share_of
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

NAME = "cooperative_transport"
SHORT_FORM = {"shapes": ((0.5, 0.5),), "duration": 80.0}
IS_LONG = True
FILM = {"title": "to a lamp on the right", "stop": 75.0, "camera": "top"}
LAMP = (2.0, 0.0)
ARRIVED = 0.5
"""m from the lamp: the box, 0.25 m from its middle to its sides, has arrived."""
SHARE, WAY, ALONE = 0.85, 1.3, 0.05
"""The least share of runs in which the box arrives; the longest way of the box as a multiple of the
straight one; the most that one robot moves it, m."""
DURATION, LONE = 120.0, 30.0
SHAPES = ((0.5, 0.5), (0.3, 0.7))
"""Sides of the box in m."""


def outcomes(
    seeds: Sequence[int],
    jobs: int = 1,
    shapes: Sequence[tuple[float, float]] = SHAPES,
    duration: float = DURATION,
) -> list[Outcome]:
    """All outcomes: for each seed and shape a run of six robots, and one run of a robot alone."""
    sides = {"arena.boxes.0.size": [list(shape) for shape in shapes]}
    changes = {"duration": duration, "trace_rate": 2.0}
    results = simulate(NAME, seeds, jobs=jobs, set=changes, sweep=sides)
    found = [way(trace) for trace in results.traces]
    single = {"duration": LONE, "groups.tb3.count": 1}
    (alone,) = simulate(NAME, seeds[:1], set=single).traces
    arrived = [one for one in found if not np.isnan(one)]
    moved = float(np.hypot(*(box(alone)[-1] - box(alone)[0])))
    return [
        at_least(
            NAME, "share of runs in which the box arrives", SHARE,
            share_of(not np.isnan(one) for one in found),
            "Chen et al. 2015: 43 of 45, with e-pucks",
        ),
        at_most(NAME, "way of the box that arrives / straight way", WAY, arrived, "ours"),
        at_most(NAME, "one robot alone moves the box [m]", ALONE, [moved], "friction of the box"),
        no_contacts(NAME, results),
    ]  # fmt: skip


def box(trace: Trace) -> Array:
    """(T, 2) the middle of the box in m."""
    assert trace.box_pose is not None
    return trace.box_pose[:, 0, :2]


def way(trace: Trace) -> float:
    """The way of the box until it arrives by the straight one; NaN: never."""
    places = box(trace)
    away = np.hypot(*(places - LAMP).T)
    there = np.flatnonzero(away < ARRIVED)
    if not len(there):
        return float("nan")
    steps = np.hypot(*np.diff(places[: there[0] + 1], axis=0).T)
    return float(steps.sum() / (away[0] - away[there[0]]))

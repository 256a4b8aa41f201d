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
FILM = {"title": "to a lamp on the right", "stop": 75.0}
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
    """Measure whether six robots push the box to the lamp, and how long the path of the box is.

    A robot alone must not move the box. `shapes`: sides of the box in m. Six robots run `duration`
    s for each seed and shape, and a single robot for each seed. Each outcome has the measured
    values, their bound and the source of the bound.
    """
    sweep = {"arena.boxes.0.size": [list(shape) for shape in shapes]}
    changes = {"duration": duration, "trace_rate": 2.0}
    results = simulate(NAME, seeds, jobs=jobs, set=changes, sweep=sweep)
    # The length of the box's path over the straight distance; NaN if the box does not arrive.
    path_ratios = [way(trace) for trace in results.traces]
    has_arrived = [not np.isnan(ratio) for ratio in path_ratios]
    arrived_ratios = [ratio for ratio in path_ratios if not np.isnan(ratio)]
    alone = simulate(NAME, seeds, jobs=jobs, set={"duration": LONE, "groups.tb3.count": 1})
    lone_m = [float(np.hypot(*(box(trace)[-1] - box(trace)[0]))) for trace in alone.traces]
    paper = "Chen et al. 2015: 43 of 45, with e-pucks"
    return [
        at_least(NAME, "share of runs in which the box arrives", SHARE,
                 share_of(has_arrived), paper),
        at_most(NAME, "way of the box that arrives / straight way", WAY, arrived_ratios, "ours"),
        at_most(NAME, "one robot alone moves the box [m]", ALONE, lone_m, "friction of the box"),
        no_contacts(NAME, results),
    ]  # fmt: skip


def box(trace: Trace) -> Array:
    """(T, 2) the middle of the box in m."""
    assert trace.box_pose is not None
    return trace.box_pose[:, 0, :2]


def way(trace: Trace) -> float:
    """The length of the box's path until arrival, over the straight distance; NaN: no arrival."""
    places = box(trace)
    to_lamp_m = np.hypot(*(places - LAMP).T)
    arrivals = np.flatnonzero(to_lamp_m < ARRIVED)
    if not len(arrivals):
        return float("nan")
    first = arrivals[0]
    steps_m = np.hypot(*np.diff(places[: first + 1], axis=0).T)
    return float(steps_m.sum() / (to_lamp_m[0] - to_lamp_m[first]))

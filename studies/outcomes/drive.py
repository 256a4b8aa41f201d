"""Drive: straight ahead at its speed until protection stops it at the wall, or on a circle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, no_contacts, number
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.clearance import clearance
from swarmd.sim.trace import Trace

NAME = "drive"
LIMITS = {"burger": 0.22, "waffle": 0.26, "jackal": 0.5}
"""m/s, of the platforms' files."""
CIRCLE = 0.15 / 0.3
"""Radius in m from speed and turn rate of the scenario's circle."""
_UNDER_WAY = (2.0, 6.0)
_SPEEDS = "limits of the platforms (manuals)"
_SAFE = "docs/safety.md"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes, of one run for each seed."""
    results = simulate(NAME, seeds, jobs=jobs)
    rows = [
        (straightness(trace), speed_error(trace), stand(trace), radius_error(trace), room(trace))
        for trace in results.traces
    ]
    aside, off, still, circle, left = (tuple(values) for values in zip(*rows, strict=True))
    return [
        at_most(NAME, "most aside of its line [m]", 0.05, aside, "geometry"),
        at_most(NAME, "relative error of the speed", 0.05, off, _SPEEDS),
        at_most(NAME, "path in the last 5 s [m]", 0.1, still, _SAFE),
        at_least(NAME, "footprint from the wall [m]", 0.02, left, _SAFE),
        no_contacts(NAME, results),
        at_most(NAME, "circle: relative error of the radius", 0.1, circle, "v / w"),
    ]


def straightness(trace: Trace) -> float:
    """The largest lateral offset in m of the three robots from their lines."""
    return max(float(np.abs(_path(trace, name)[:, 1]).max()) for name in LIMITS)


def speed_error(trace: Trace) -> float:
    """The largest relative error of the forward speed against the limit, from 2 to 6 s."""
    since, until = np.searchsorted(trace.t, _UNDER_WAY)
    seconds = float(trace.t[until] - trace.t[since])
    errors = []
    for name, limit in LIMITS.items():
        path = _path(trace, name)
        errors.append(abs(float(path[until, 0] - path[since, 0]) / seconds / limit - 1.0))
    return max(errors)


def stand(trace: Trace) -> float:
    """The largest distance in m that one of the three moves in the last 5 s."""
    at = int(np.searchsorted(trace.t, trace.t[-1] - 5.0))
    return max(float(np.hypot(*(_path(trace, n)[-1] - _path(trace, n)[at]))) for n in LIMITS)


def room(trace: Trace) -> float:
    """The smallest distance in m of a footprint from a wall."""
    return number(clearance(trace))


def radius_error(trace: Trace) -> float:
    """The largest relative error of the radius of the robot that drives a circle to the left."""
    path = _path(trace, "circle")
    distance = np.hypot(path[:, 0], path[:, 1] - CIRCLE)
    return float(np.abs(distance / CIRCLE - 1.0).max())


def _path(trace: Trace, name: str) -> Array:
    """(T, 2) position in m, forward and left of the start of a robot."""
    pose = trace.pose[:, trace.ids.index(name)]
    cos, sin = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    step = pose[:, :2] - pose[0, :2]
    return np.column_stack(
        (cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0])
    )

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
FILM = {"title": "towards a wall", "stop": 25.0}
LIMITS = {"burger": 0.22, "waffle": 0.26, "jackal": 0.5}
"""m/s, of the platforms' files."""
CIRCLE = 0.15 / 0.3
"""Radius in m from speed and turn rate of the scenario's circle."""
_UNDER_WAY = (2.0, 6.0)
_SPEEDS = "limits of the platforms (manuals)"
_SAFE = "docs/safety.md"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes, of one run for each seed; of three robots ahead, and one on a circle."""
    results = simulate(NAME, seeds, jobs=jobs)
    aside, off, still, circle, left = [], [], [], [], []
    for trace in results.traces:
        paths = {name: _path(trace, name) for name in LIMITS}
        since, until, late = np.searchsorted(trace.t, (*_UNDER_WAY, trace.t[-1] - 5.0))
        seconds = float(trace.t[until] - trace.t[since])
        speeds = {n: float(path[until, 0] - path[since, 0]) / seconds for n, path in paths.items()}
        aside.append(max(float(np.abs(path[:, 1]).max()) for path in paths.values()))
        off.append(max(abs(speeds[name] / limit - 1.0) for name, limit in LIMITS.items()))
        still.append(max(float(np.hypot(*(path[-1] - path[late]))) for path in paths.values()))
        left.append(number(clearance(trace)))
        around = _path(trace, "circle") - (0.0, CIRCLE)
        # A robot that stands is on the circle, too.
        circle.append(
            float(np.abs(np.hypot(*around.T) / CIRCLE - 1.0).max())
            if np.ptp(around[:, 0]) >= CIRCLE
            else np.inf
        )
    return [
        at_most(NAME, "relative error of the speed", 0.05, off, _SPEEDS),
        at_most(NAME, "most aside of its line [m]", 0.05, aside, "geometry"),
        at_most(NAME, "path in the last 5 s [m]", 0.1, still, _SAFE),
        at_least(NAME, "footprint from the wall [m]", 0.02, left, _SAFE),
        no_contacts(NAME, results),
        at_most(NAME, "circle: relative error of the radius", 0.1, circle, "v / w"),
    ]


def _path(trace: Trace, name: str) -> Array:
    """(T, 2) position in m, forward and left of the start of a robot."""
    pose = trace.pose[:, trace.ids.index(name)]
    cos, sin = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    step = pose[:, :2] - pose[0, :2]
    return np.column_stack(
        (cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0])
    )

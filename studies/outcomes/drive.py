"""Drive: straight on at its speed until protection stops it before the wall, or along a circle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.clearance import clearance
from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.trace import Trace

NAME = "drive"
LIMITS = {"burger": 0.22, "waffle": 0.26, "jackal": 0.5}
"""m/s, of the platforms' files."""
CIRCLE = 0.15 / 0.3
"""The radius in m that speed and turn rate of the scenario's circle give."""
_UNDER_WAY = (2.0, 6.0)
_SPEEDS = "limits of the platforms (manuals)"
_SAFE = "docs/safety.md"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All of them, of one run a seed."""
    results = simulate(NAME, seeds, jobs=jobs)
    traces = list(results.traces)
    rows = [
        (straightness(trace), speed_error(trace), stand(trace), radius_error(trace), room(trace))
        for trace in traces
    ]
    aside, off, still, circle, left = (tuple(values) for values in zip(*rows, strict=True))
    touches = tuple(float(len(contact_list(trace))) for trace in traces)
    return [
        Outcome(
            NAME, "most aside of its line [m]", "<= 0.05", aside, at_most(0.05, aside), "geometry"
        ),
        Outcome(NAME, "speed, off by a share", "<= 0.05", off, at_most(0.05, off), _SPEEDS),
        Outcome(NAME, "way in the last 5 s [m]", "<= 0.1", still, at_most(0.1, still), _SAFE),
        Outcome(NAME, "footprint from the wall [m]", ">= 0.02", left, at_least(0.02, left), _SAFE),
        Outcome(NAME, "touches", "0", touches, at_most(0.0, touches), _SAFE),
        Outcome(
            NAME, "circle: radius, off by a share", "<= 0.1", circle, at_most(0.1, circle), "v / w"
        ),
    ]


def straightness(trace: Trace) -> float:
    """How far in m the worst of the three came aside of its line."""
    return max(float(np.abs(_way(trace, name)[:, 1]).max()) for name in LIMITS)


def speed_error(trace: Trace) -> float:
    """How far the speed forward of the worst is off its limit while it is under way, as a share."""
    since, until = np.searchsorted(trace.t, _UNDER_WAY)
    seconds = float(trace.t[until] - trace.t[since])
    errors = []
    for name, limit in LIMITS.items():
        way = _way(trace, name)
        errors.append(abs(float(way[until, 0] - way[since, 0]) / seconds / limit - 1.0))
    return max(errors)


def stand(trace: Trace) -> float:
    """How far in m the worst of the three moves in the last 5 s."""
    at = int(np.searchsorted(trace.t, trace.t[-1] - 5.0))
    return max(float(np.hypot(*(_way(trace, n)[-1] - _way(trace, n)[at]))) for n in LIMITS)


def room(trace: Trace) -> float:
    """The smallest distance in m of a footprint from a wall."""
    value = clearance(trace)
    return float("nan") if value is None else value


def radius_error(trace: Trace) -> float:
    """How far the robot on a circle is off it at worst, as a share of the radius; left is round."""
    way = _way(trace, "circle")
    distance = np.hypot(way[:, 0], way[:, 1] - CIRCLE)
    return float(np.abs(distance / CIRCLE - 1.0).max())


def _way(trace: Trace, name: str) -> Array:
    """(T, 2) m forward and left of where a robot has started."""
    pose = trace.pose[:, trace.ids.index(name)]
    cos, sin = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    step = pose[:, :2] - pose[0, :2]
    return np.column_stack(
        (cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0])
    )


_COMMAND = "return Twist(linear=self.params.speed, angular=self.params.turn)"

"""Phototaxis: robots reach a lamp on a short way, gather there, and flee it with sense: away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, mean_of, no_contacts
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

NAME = "phototaxis"
IS_LONG = True
FILM = {"title": "to a lamp on the right", "stop": 60.0}
LAMP = (2.0, 0.0)
NEAR, ARRIVED = 1.5, 0.8
"""m from the lamp: within which robots have gathered, and a robot alone has arrived."""
DURATION, ALONE = 150.0, 60.0
GATHERED, DETOUR, FAR = 0.8, 1.3, 4.0
"""The least share of robots near the lamp; the longest way of a robot alone as a multiple of the
straight one; the least mean distance in m of robots that flee, which begin at about 3.6 m."""
_EYES = "two eyes give the bearing: see the pattern"


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: for each seed a run of six robots, of one alone, and of six that flee."""
    found = simulate(NAME, seeds, jobs=jobs, set={"duration": DURATION})
    changes = {"duration": ALONE, "groups.tb3.count": 1, "arena.boxes": []}
    alone = simulate(NAME, seeds, jobs=jobs, set=changes)
    away = {"groups.tb3.parameters": {"sense": "away"}, "duration": ALONE}
    fled = simulate(NAME, seeds, jobs=jobs, set=away)
    gathered = mean_of(float((distances(trace)[-1] < NEAR).mean()) for trace in found.traces)
    detours = [detour(trace) for trace in alone.traces]
    far = [float(distances(trace)[-1].mean()) for trace in fled.traces]
    return [
        at_least(NAME, f"share of robots within {NEAR} m of the lamp", GATHERED, gathered, "ours"),
        at_most(NAME, "alone: way to the lamp / straight way", DETOUR, detours, _EYES),
        at_least(NAME, "away: mean distance from the lamp [m]", FAR, far, "ours"),
        no_contacts(NAME, found),
    ]


def distances(trace: Trace) -> Array:
    """(T, n) distances of robots from the lamp in m."""
    away: Array = np.hypot(trace.pose[..., 0] - LAMP[0], trace.pose[..., 1] - LAMP[1])
    return away


def detour(trace: Trace) -> float:
    """The way of the first robot to ARRIVED m from the lamp by the straight one; NaN: never."""
    away = distances(trace)[:, 0]
    there = np.flatnonzero(away < ARRIVED)
    if not len(there):
        return float("nan")
    steps = np.hypot(*np.diff(trace.pose[: there[0] + 1, 0, :2], axis=0).T)
    return float(steps.sum() / (away[0] - ARRIVED))

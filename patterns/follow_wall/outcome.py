"""Wall following: a robot keeps the wall at its distance, around a room and around a box."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, metric, no_contacts
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

NAME = "follow_wall"
SHORT_FORM = {"duration": 90.0, "has_more": False}
FILM = {"stop": 120.0, "camera": "top"}
SIDE, DISTANCE, OFF = 6.0, 0.5, 0.1
"""The room's side, the distance of a Burger and the error of it that counts as kept, in m."""
DURATION = 180.0
EARLY = 30.0
"""s until a robot has found a wall."""
_EMPTY: Mapping[str, Any] = {"arena.boxes": []}
_ALONE = {"groups.tb3.count": 1}
_BESIDE_BOX = {**_ALONE, "start": {"layout": "list", "poses": [[1.3, 0.0, 90.0]]}}
_OURS = "ours"
_WAY = "ours: three quarters of the way at full speed along the wall at that distance"


def outcomes(
    seeds: Sequence[int], jobs: int = 1, *, duration: float = DURATION, has_more: bool = True
) -> list[Outcome]:
    """All outcomes: for each seed a robot alone, and with `has_more` three robots and a box."""

    def found(sets: Mapping[str, Any]) -> Any:
        return simulate(NAME, seeds, jobs=jobs, set={"duration": duration, **sets})

    alone = found({**_EMPTY, **_ALONE})
    right = found({**_EMPTY, **_ALONE, "groups.tb3.parameters.side": "right"})
    room = 4.0 * (SIDE - 2.0 * DISTANCE)
    rounds = 0.75 * (duration - EARLY) * 0.22 / room
    kept = "alone in a room: share of the time within 0.1 m of the distance"
    main = [
        at_least(NAME, kept, 0.75, [share_kept(trace) for trace in alone.traces], _OURS),
        at_least(NAME, "rounds with the wall on the left", rounds, turns(alone.traces, -1), _WAY),
        at_least(NAME, "rounds with the wall on the right", rounds, turns(right.traces, 1), _WAY),
        no_contacts(NAME, alone),
    ]
    if not has_more:
        return main
    three, box = found(_EMPTY), found(_BESIDE_BOX)
    around = 2.0 * (1.4 + 0.8) + 2.0 * math.pi * DISTANCE
    rounds = 0.75 * duration * 0.22 / around
    speed = [value / 0.22 for value in metric(three, "mean_speed")]
    return [
        *main,
        at_least(NAME, "rounds around a box on the left", rounds, turns(box.traces, 1), _WAY),
        at_least(NAME, "three robots: mean speed / limit", 0.6, speed, _OURS),
        no_contacts(NAME, three),
    ]


def late(trace: Trace) -> Array:
    """(T, 2) the places of the first robot since EARLY."""
    places: Array = trace.pose[trace.t - trace.t[0] >= EARLY, 0, :2]
    return places


def share_kept(trace: Trace) -> float:
    """The share of the time since EARLY in which the nearest wall is at the distance."""
    distance = SIDE / 2.0 - np.abs(late(trace)).max(axis=1)
    return float(np.mean(np.abs(distance - DISTANCE) <= OFF))


def turns(traces: Iterable[Trace], sign: int) -> list[float]:
    """How often the robot of each run has gone around the middle; `sign` 1: to the left."""
    angles = [np.unwrap(np.arctan2(*late(trace).T[::-1])) for trace in traces]
    return [sign * float(some[-1] - some[0]) / (2.0 * math.pi) for some in angles]

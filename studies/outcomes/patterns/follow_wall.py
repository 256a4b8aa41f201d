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
FILM = {"stop": 120.0}
SIDE, DISTANCE, OFF = 6.0, 0.5, 0.1
"""The room's side, the distance of a Burger and the error of it that counts as kept, in m."""
DURATION = 180.0
SPEED = 0.22
"""The speed limit of a Burger in m/s."""
EARLY = 30.0
"""s until a robot has found a wall."""
_EMPTY: Mapping[str, Any] = {"arena.boxes": []}
_ALONE = {"groups.tb3.count": 1}
_BESIDE_BOX = {**_ALONE, "start": {"layout": "list", "poses": [[1.3, 0.0, 90.0]]}}
_OURS = "ours"
_WAY = "ours: three quarters of the way at full speed along the wall at that distance"
_WAY_SHARE = 0.75
_CLOCKWISE, _COUNTER_CLOCKWISE = -1, 1


def outcomes(
    seeds: Sequence[int], jobs: int = 1, *, duration: float = DURATION, has_more: bool = True
) -> list[Outcome]:
    """Measure how well a robot keeps its distance from the wall, and how far it goes around.

    For each seed a robot drives alone in a square room, with the wall on its left, then on its
    right. `has_more`: also three robots in the room, and a robot around a box. `duration`: s. Each
    outcome has the measured values, their bound and the source of the bound.
    """

    def runs_with(changes: Mapping[str, Any]) -> Any:
        return simulate(NAME, seeds, jobs=jobs, set={"duration": duration, **changes})

    left_runs = runs_with({**_EMPTY, **_ALONE})
    right_runs = runs_with({**_EMPTY, **_ALONE, "groups.tb3.parameters.side": "right"})
    room_round_m = 4.0 * (SIDE - 2.0 * DISTANCE)
    least_rounds = _WAY_SHARE * (duration - EARLY) * SPEED / room_round_m
    label = "alone in a room: share of the time within 0.1 m of the distance"
    shares_kept = [share_kept(trace) for trace in left_runs.traces]
    # With the wall on its left the robot goes clockwise about the middle of the room.
    left = turns(left_runs.traces, _CLOCKWISE)
    right = turns(right_runs.traces, _COUNTER_CLOCKWISE)
    room_outcomes = [
        at_least(NAME, label, 0.75, shares_kept, _OURS),
        at_least(NAME, "rounds with the wall on the left", least_rounds, left, _WAY),
        at_least(NAME, "rounds with the wall on the right", least_rounds, right, _WAY),
        no_contacts(NAME, left_runs),
    ]
    if not has_more:
        return room_outcomes
    three_robots, box_runs = runs_with(_EMPTY), runs_with(_BESIDE_BOX)
    box_round_m = 2.0 * (1.4 + 0.8) + 2.0 * math.pi * DISTANCE  # the box is 1.4 m by 0.8 m
    least_box_rounds = _WAY_SHARE * duration * SPEED / box_round_m
    box_rounds = turns(box_runs.traces, _COUNTER_CLOCKWISE)
    speeds = [speed / SPEED for speed in metric(three_robots, "mean_speed")]
    return [
        *room_outcomes,
        at_least(NAME, "rounds around a box on the left", least_box_rounds, box_rounds, _WAY),
        at_least(NAME, "three robots: mean speed / limit", 0.6, speeds, _OURS),
        no_contacts(NAME, three_robots),
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
    """How often the robot of each run has gone around the middle in the direction `sign`."""
    angles = [np.unwrap(np.arctan2(*late(trace).T[::-1])) for trace in traces]
    return [sign * float(some[-1] - some[0]) / (2.0 * math.pi) for some in angles]

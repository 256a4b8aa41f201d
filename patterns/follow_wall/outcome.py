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
SPEED = 0.22
"""The speed limit of a Burger in m/s."""
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
    """Measure how well a robot keeps its distance from the wall, and how far it goes around.

    For each seed a robot drives alone in a square room, with the wall on its left, then on its
    right. `has_more`: also three robots in the room, and a robot around a box. `duration`: s.
    The wanted rounds are three quarters of the way at full speed, over the length of a round. An
    outcome: text of the number, bound, values of the runs, source of the bound.
    """

    def runs_with(changes: Mapping[str, Any]) -> Any:
        return simulate(NAME, seeds, jobs=jobs, set={"duration": duration, **changes})

    left_runs = runs_with({**_EMPTY, **_ALONE})
    right_runs = runs_with({**_EMPTY, **_ALONE, "groups.tb3.parameters.side": "right"})
    room_round_m = 4.0 * (SIDE - 2.0 * DISTANCE)
    rounds = 0.75 * (duration - EARLY) * SPEED / room_round_m
    label = "alone in a room: share of the time within 0.1 m of the distance"
    shares_kept = [share_kept(trace) for trace in left_runs.traces]
    # Rounds about the middle of the room: with the wall on its left the robot goes clockwise (-1).
    left, right = turns(left_runs.traces, -1), turns(right_runs.traces, 1)
    room_outcomes = [
        at_least(NAME, label, 0.75, shares_kept, _OURS),
        at_least(NAME, "rounds with the wall on the left", rounds, left, _WAY),
        at_least(NAME, "rounds with the wall on the right", rounds, right, _WAY),
        no_contacts(NAME, left_runs),
    ]
    if not has_more:
        return room_outcomes
    three_robots, box_runs = runs_with(_EMPTY), runs_with(_BESIDE_BOX)
    box_round_m = 2.0 * (1.4 + 0.8) + 2.0 * math.pi * DISTANCE  # the box is 1.4 m by 0.8 m
    rounds = 0.75 * duration * SPEED / box_round_m
    speeds = [speed / SPEED for speed in metric(three_robots, "mean_speed")]
    return [
        *room_outcomes,
        at_least(NAME, "rounds around a box on the left", rounds, turns(box_runs.traces, 1), _WAY),
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
    """How often the robot of each run has gone around the middle; `sign` 1: to the left."""
    angles = [np.unwrap(np.arctan2(*late(trace).T[::-1])) for trace in traces]
    return [sign * float(some[-1] - some[0]) / (2.0 * math.pi) for some in angles]

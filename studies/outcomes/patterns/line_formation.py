"""Line formation: robots from anywhere form a line, rest in it, and close it when one is removed.

The error is the project's own; its bound is a tenth of the spacing. The error has two parts: the
distance from the best line, and the spacing. Fredslund and Mataric 2002 ask both of a formation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from studies.outcomes.outcome import Outcome, at_least, at_most, share_of
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.formation import line_errors
from swarmd.sim.metrics.window import cut, presence
from swarmd.sim.trace import Trace

SPACING = 1.1
"""Spacing of TurtleBots in m, 2.2 times their protection threshold."""
REMOVED, END = 30.0, 60.0
_BOUND = 0.1
_MOVING, _FEW = 0.05, 0.25
_HELD = 10.0
_PROJECT = "bound: the project's, a tenth of the spacing; error: after Fredslund and Mataric 2002"
_BREAKS = "otherwise the next outcome means nothing"


@dataclass(frozen=True, slots=True)
class Setting:
    """A kind of swarm; `changes` are applied to the scenario."""

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)


BURGERS = Setting("Burgers, range and bearing")
SETTINGS = (
    BURGERS,
    Setting("Waffle Pis, range and bearing", {"groups.tb3.platform": "waffle_pi"}),
)
SHORT_FORM = {"settings": (BURGERS,)}
FILM = {"title": "one robot is removed", "sets": {"arena.size": [6, 6]}}
BY_LIDAR = Setting("Burgers, lidar", {"radio.range_and_bearing": False})
Errors = Callable[[Trace, float], Array]


def outcomes(
    seeds: Sequence[int], jobs: int = 1, settings: Sequence[Setting] = SETTINGS
) -> list[Outcome]:
    """The outcomes of each setting."""
    return formed("line_formation", line_errors, seeds, jobs, settings)


def formed(
    pattern: str, errors: Errors, seeds: Sequence[int], jobs: int, settings: Sequence[Setting]
) -> list[Outcome]:
    """The outcomes of a formation with that error, a share of the spacing."""
    found = []
    for setting in settings:
        runs: list[Trace] = []
        for count in range(5, 9):
            if own := [seed for seed in seeds if seed % 4 == count - 5]:
                some = {**setting.changes, "groups.tb3.count": count}
                runs += simulate(pattern, own, set=some, jobs=jobs).traces
        found += _judged(pattern, setting.name, errors, runs)
    return found


def _judged(pattern: str, name: str, errors: Errors, runs: Sequence[Trace]) -> list[Outcome]:
    def largest(since: float, until: float) -> list[float]:
        parts = [_span(run, since, until) for run in runs]
        return [float(errors(part, SPACING).max(initial=0.0)) for part in parts]

    before, after = largest(REMOVED - _HELD, REMOVED - 0.1), largest(END - _HELD, END)
    moved = [_moving(_span(run, END - _HELD, END)) for run in runs]
    share = share_of(error > _BOUND for error in largest(REMOVED, REMOVED + 1.0))
    again, moving = (
        "largest error, 20 to 30 s after a removal",
        "share that moves 5 cm in these 10 s",
    )
    return [
        at_most(pattern, f"{name}: largest error, 20 to 30 s", _BOUND, before, _PROJECT),
        at_least(pattern, f"{name}: runs in which a removal breaks it", 0.5, share, _BREAKS),
        at_most(pattern, f"{name}: {again}", _BOUND, after, _PROJECT),
        at_most(pattern, f"{name}: {moving}", _FEW, moved, "ours: noise wakes one now and then"),
    ]


def _span(run: Trace, since: float, until: float) -> Trace:
    start, stop = np.searchsorted(run.t, (since - 1e-6, until + 1e-6)).tolist()
    return cut(run, start, stop)


def _moving(part: Trace) -> float:
    """The share of the present robots with a path longer than that of a robot at rest."""
    step = np.diff(part.pose[:, presence(part).all(axis=0), :2], axis=0)
    return float(np.mean(np.hypot(step[..., 0], step[..., 1]).sum(axis=0) > _MOVING))

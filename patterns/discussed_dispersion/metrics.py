"""Metrics of discussed dispersion: experiment 2 of Kaiser et al., ICRA 2022.

Robots vote for 20 s and stand meanwhile, then spread, and keep the distance from 40 to 70 s. Times
are in s from the start, lengths in m. A range is the true distance of a robot's lidar to the
nearest robot or wall. studies/paper_exp2.py makes the tables of docs/paper.md from the same
numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics.lidar_ranges import lidar_ranges
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

DISCUSS = 20.0
SPREAD_BY = 40.0
KEPT_UNTIL = 70.0
TOLERANCE = 0.03
"""Three standard deviations of the lidar's noise, in m."""
STRAYED = 0.1
"""Standing robots stay within this distance in m of a position."""
MOVING = 0.05
"""Standing robots move for at most this mean share of the time."""
STILL = 0.01
"""Slower than this speed in m/s is no motion."""
JOINED = 8.0
"""When the late robot of `outcomes.yaml` joins, in s."""
JOINED_IN_PAPER = 50.0
"""When the late robot of the scenario `paper_exp2_late` joins, in s."""
_HEARD = 0.5  # s after it has joined
_SAME = 1e-6  # s, less than between two samples


@metric(unit="m")
def least_over_wanted(trace: Trace) -> float:
    """The least range from 40 to 70 s, less the distance of the opinion of all robots."""
    course = judged(trace)
    return course.least - course.wanted


@metric(unit="0 or 1", better="more")
def one_opinion(trace: Trace) -> bool:
    """Whether all robots hold one opinion from 20 s on."""
    return agreed(trace) >= 0


@metric(unit="m", better="less")
def moved_early(trace: Trace) -> float:
    """The largest distance of a robot from its start before 20 s."""
    return float(away(trace.pose[..., :2][~_since_vote(trace)]).max())


@metric(unit="m", better="less")
def strayed_late(trace: Trace) -> float:
    """The largest distance of a robot from its place at 40 s, from 40 to 70 s."""
    return float(away(trace.pose[..., :2][_late(trace)]).max())


@metric(unit="share", better="less", bounds=(0.0, 1.0))
def moving_late(trace: Trace) -> float:
    """The mean share of the time from 40 to 70 s in which a robot moves."""
    steps = np.hypot(*np.moveaxis(np.diff(trace.pose[..., :2], axis=0), -1, 0))
    speeds = steps / np.diff(trace.t)[:, None]
    return float((speeds[_late(trace)[1:]] > STILL).mean())


@metric(better="less")
def contact_steps(trace: Trace) -> int:
    """The number of contact steps of the run."""
    return len(trace.contact_t)


@metric(unit="s", better="less", is_time_to_event=True)
def adopted(trace: Trace) -> float | None:
    """The time until the robot that joins at 8 s holds the opinion of the others."""
    found = joined(trace, JOINED).adopted
    return found if math.isfinite(found) else None


@metric(unit="0 or 1", better="less")
def is_swayed(trace: Trace) -> bool:
    """Whether another robot changes its opinion after the last one has joined at 8 s."""
    return joined(trace, JOINED).is_swayed


@dataclass(frozen=True, slots=True)
class Course:
    """The result of one run."""

    opinion: int
    """The opinion of all robots from 20 s on; -1 if they differ."""
    moved: float
    """The largest distance of a robot from its start before 20 s."""
    wanted: float
    """The wanted distance f(opinion)."""
    kept_since: float
    """The time from which until 70 s all ranges are at least `wanted` - TOLERANCE; inf: never."""
    least: float
    """The least range from 40 to 70 s."""
    strayed: float
    """The largest distance of a robot from its position at 40 s, from 40 to 70 s."""
    moving: float
    """The mean share of the time from 40 to 70 s in which a robot moves."""
    contacts: int
    """The number of contact steps of the run."""

    @property
    def is_kept(self) -> bool:
        """Whether all ranges were large enough from 40 s to 70 s."""
        return self.kept_since <= SPREAD_BY

    @property
    def is_standing(self) -> bool:
        """Whether the robots stood from 40 s to 70 s, except for small corrections."""
        return self.strayed <= STRAYED and self.moving <= MOVING


def judged(trace: Trace, base: float = 0.6, step: float = 0.4) -> Course:
    """The result of a trace of experiment 2; f(opinion) = `base` + `step` * opinion, in m.

    This f is the paper's function, not the distance that robots report.
    """
    time = trace.t - trace.t[0]
    until = time <= KEPT_UNTIL + _SAME
    opinion = agreed(trace)
    held = opinion if opinion >= 0 else np.max(trace.report["opinion"][-1])
    wanted = base + step * float(held)
    least = lidar_ranges(trace).min(axis=1)
    times = np.append(time[until], np.inf)
    too_near = np.flatnonzero(least[until] < wanted - TOLERANCE)
    kept_since = times[too_near[-1] + 1] if len(too_near) else 0.0
    return Course(
        opinion=opinion,
        moved=moved_early(trace),
        wanted=wanted,
        kept_since=float(kept_since),
        least=float(least[_late(trace)].min()),
        strayed=strayed_late(trace),
        moving=moving_late(trace),
        contacts=contact_steps(trace),
    )


def agreed(trace: Trace) -> int:
    """The opinion of all robots from 20 s on; -1 if they differ."""
    since_vote = trace.report["opinion"][_since_vote(trace)]
    return int(since_vote[0, 0]) if len(np.unique(since_vote)) == 1 else -1


def away(places: Array) -> Array:
    """(T, n) the distance in m of positions (T, n, 2) from those at the first instant."""
    distance: Array = np.hypot(*np.moveaxis(places - places[0], -1, 0))
    return distance


def _since_vote(trace: Trace) -> NDArray[np.bool_]:
    """(T,) whether the robots have voted."""
    return np.asarray(trace.t - trace.t[0] >= DISCUSS - _SAME)


def _late(trace: Trace) -> NDArray[np.bool_]:
    """(T,) whether the robots have to keep their distance."""
    time = trace.t - trace.t[0]
    return np.asarray((time >= SPREAD_BY - _SAME) & (time <= KEPT_UNTIL + _SAME))


@dataclass(frozen=True, slots=True)
class Joining:
    """The result of a run in which an eighth robot joins late with another opinion."""

    adopted: float  # s until the eighth robot holds the opinion of the seven; inf: never
    is_swayed: bool  # one of the seven changes its opinion after the eighth has joined
    stirred: float  # m, the largest distance that one of the seven moves after that
    least: float  # m, the least range in the last 20 s
    contacts: int  # contact steps of the run


def joined(trace: Trace, at: float = JOINED_IN_PAPER) -> Joining:
    """The result of a trace of `paper_exp2_late`, in which the last robot joins at `at` s."""
    time = trace.t - trace.t[0]
    opinion = trace.report["opinion"]
    there = time >= at + _HEARD
    others = opinion[there][:, :-1]
    held = np.flatnonzero(opinion[there][:, -1] == others[0, 0])
    return Joining(
        adopted=float(time[there][held[0]] - at) if len(held) else float("inf"),
        is_swayed=len(np.unique(others)) > 1,
        stirred=float(away(trace.pose[there][:, :-1, :2]).max()),
        least=float(lidar_ranges(trace)[time >= time[-1] - 20.0].min()),
        contacts=contact_steps(trace),
    )

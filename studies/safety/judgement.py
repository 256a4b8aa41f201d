"""The numbers of a run: contacts, faults and goals."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from msgspec import Struct

from studies.safety.driven import faults
from studies.safety.held import WINDOW, held_windows
from studies.safety.judge import FAULT, collisions, stuck_windows
from swarmd.sim.metrics.gap import minimum_gap
from swarmd.sim.metrics.protection import alterations
from swarmd.sim.metrics.window import arena_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.realism import REALISTIC, Actuation


class Judgement(Struct, frozen=True, kw_only=True):
    """The numbers of a run, of its protected robots only; they add up over runs.

    A robot is at fault for what its own drives did, see `driven`.

    `seconds`: the sum over these robots. Collisions with robots, and contacts with walls, boxes
    and poles, each with the number at fault and their fastest own surface in m/s (0: none);
    `hits`: collisions that began with a fault, and the fastest. `pushed`: collisions and contacts
    into which a robot was pushed. `told`: events of robots that a wall moved, at most ten a robot.
    `held` s in which robots that asked for motion stood with free floor, in windows of 10 s
    (held.py); None: not known, as without the requested commands. `goals` reached within
    `goal_seconds` of all of them together, `windows` of WINDOW s, and how many of them `stuck`: all
    0 where there was no goal to reach. `altered`: mean change of the requested command, times
    `seconds`.
    `min_gap` m between two robots' outlines at the trace's instants.
    """

    seconds: float
    collisions: int
    faults: int
    worst: float
    hits: int
    worst_hit: float
    touches: int
    touch_faults: int
    worst_touch: float
    pushed: int
    goals: int
    goal_seconds: float
    windows: int
    stuck: int
    altered: float
    min_gap: float
    told: int = 0
    held: float | None = None


def judge(
    trace: Trace,
    unprotected: Collection[str] = (),
    actuation: Actuation = REALISTIC.actuation,
) -> Judgement:
    """The numbers of a trace; `unprotected` are the ids of robots without protection.

    `actuation`: of the bases.
    """
    rows = np.array([row for row, robot in enumerate(trace.ids) if robot not in unprotected])
    found = collisions(trace, unprotected)
    robots = [one for one in found if one.b in trace.ids]
    by_own_drives = list(faults(trace, unprotected, actuation))
    drove_into = [one.own_speed for one in by_own_drives if one.b in trace.ids]
    drove_at = [one.own_speed for one in by_own_drives if one.b not in trace.ids]
    at_once = [min(one.own_speed, one.first_speed) for one in by_own_drives if one.b in trace.ids]
    ran_into = [speed for speed in at_once if speed > FAULT]
    goals = trace.report.get("goals")
    seconds = trace.duration * len(rows)
    reached = np.zeros(1) if goals is None else np.nanmax(goals[:, rows], axis=0, initial=0.0)
    windows, stuck = (0, 0) if goals is None else stuck_windows(trace, rows)
    held = None
    if trace.requested is not None and arena_of(trace) is not None:
        held = WINDOW * float(held_windows(trace)[:, rows].sum())
    changes = alterations(trace)
    altered = 0.0 if changes is None else float(np.nan_to_num(np.nanmean(changes[:, rows])))
    return Judgement(
        seconds=seconds,
        collisions=len(robots),
        faults=len(drove_into),
        worst=max(drove_into, default=0.0),
        hits=len(ran_into),
        worst_hit=max(ran_into, default=0.0),
        touches=len(found) - len(robots),
        touch_faults=len(drove_at),
        worst_touch=max(drove_at, default=0.0),
        pushed=sum(one.is_fault or one.is_pushed for one in found) - len(by_own_drives),
        goals=int(reached.sum()),
        goal_seconds=0.0 if goals is None else seconds,
        windows=windows,
        stuck=stuck,
        altered=altered * seconds,
        min_gap=minimum_gap(trace),
        held=held,
    )

"""Experiment 2 of Kaiser et al., ICRA 2022: `python -m benchmarks.paper exp2 [OUT]`.

Seven Waffle Pis agree on a distance and disperse to it: in the paper's arena, in one 1.4 times as
long and wide, and with an eighth robot that joins late. Writes the table and the figures of
docs/paper.md, section "Experiment 2", to OUT. What OUT has already is not run again; with `--draw`
nothing is run at all.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swarmd.settings import load_platform
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.plots.bands import draw_series
from swarmd.sim.plots.spread import Series
from swarmd.sim.plots.trajectories import draw_trajectories
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import apart, transform
from swarmd.values import Array

SEEDS = range(20)
DISCUSS = 20.0
SPREAD_BY = 40.0
KEPT_FOR = 30.0
TOLERANCE = 0.03
"""Three standard deviations of the lidar's noise, in m."""
LARGER = "[9.24, 6.72]"
"""1.4 times the paper's arena along both sides."""

PLAN: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("paper", "paper_exp2", {}),
    ("larger", "paper_exp2", {"arena.size": LARGER}),
    ("late", "paper_exp2_late", {}),
)
WORDS = {"paper": "6.6 x 4.8 m", "larger": "9.24 x 6.72 m", "late": "one joins at 50 s"}


@dataclass(frozen=True, slots=True)
class Course:
    """What one run made of it. Times in s from the start, lengths in m.

    `opinion` -1: no agreement at 20 s that lasts. `moved`: how far anyone got before 20 s.
    `wanted`: f(opinion). `kept_since`: from when on every range stayed at least that less the
    tolerance until 70 s, inf: not. `least`: the least range from 40 to 70 s. `speed`: the fastest
    that anyone moved then, in m/s. `touches`: instants in contact.
    """

    opinion: int
    moved: float
    wanted: float
    kept_since: float
    least: float
    speed: float
    touches: int


def judged(trace: Trace, base: float = 0.6, step: float = 0.4) -> Course:
    """The course of a trace of experiment 2; f is what the paper says, not what is reported."""
    time = trace.t - trace.t[0]
    opinion = trace.report["opinion"]
    since, until = time >= DISCUSS - 1e-6, time <= SPREAD_BY + KEPT_FOR + 1e-6
    late = (time >= SPREAD_BY - 1e-6) & until
    first = opinion[since][0, 0]
    agreed = int(first) if bool((opinion[since] == first).all()) else -1
    places = trace.pose[..., :2]
    still = np.hypot(*np.moveaxis(places[~since] - places[0], -1, 0))
    speeds = (
        np.hypot(*np.moveaxis(np.diff(places[late], axis=0), -1, 0)) / np.diff(time[late])[:, None]
    )
    least = ranges(trace).min(axis=1)
    wanted = base + step * (agreed if agreed >= 0 else int(np.nanmax(opinion[-1])))
    return Course(
        opinion=agreed,
        moved=float(still.max()),
        wanted=wanted,
        kept_since=_since(time[until], least[until] >= wanted - TOLERANCE),
        least=float(least[late].min()),
        speed=float(speeds.max()),
        touches=len(trace.contact_t),
    )


def ranges(trace: Trace) -> Array:
    """(T, n) m from each lidar to the nearest outline of another or wall. Truth."""
    arena = parse_arena(str(trace.meta["arena"]))
    half = np.array([arena.length, arena.width]) / 2.0
    offsets = {name: np.array([load_platform(name).scan.offset]) for name in trace.platforms}
    robots = range(len(trace.ids))
    lidars = [transform(offsets[trace.platforms[i]], trace.pose[:, i])[:, 0] for i in robots]
    outlines = [transform(trace.footprint(i), trace.pose[:, i]) for i in robots]
    nearest = np.stack([(half - np.abs(lidar)).min(axis=1) for lidar in lidars], axis=1)
    for i in robots:
        for j in robots:
            if i != j:
                start, end = outlines[j], np.roll(outlines[j], -1, axis=1)
                away = apart(lidars[i][:, None], start, end).min(axis=1)
                nearest[:, i] = np.minimum(nearest[:, i], away)
    return nearest


def _since(time: Array, is_kept: Any) -> float:
    """From which of the times on it holds to the last of them; inf: not even then."""
    broken = np.flatnonzero(~is_kept)
    index = int(broken[-1]) + 1 if len(broken) else 0
    return float(time[index]) if index < len(time) else float("inf")

"""Getting past each other: named tasks, each with the share of robots that arrive and when.

The tasks are those in which robots hinder each other: goals, swaps on a circle, a door, a corridor,
crossing flows, a wall driven along and a parked robot on the way. Doorway, hallway and intersection
have the form of the social mini-games (Chandra et al. 2025, arXiv 2508.13459): two robots, gaps and
streets of three bodies, a hallway of seven.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from benchmarks.table import markdown
from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.driven import faults
from studies.safety.judge import collisions, stuck_windows
from studies.safety.passages import Passage, passage_scenario
from studies.safety.scenes import PLUGINS, Scene, protected, scenario
from studies.safety.tracking import TrueTracker, replace_trackers
from swarmd.core.values import Array
from swarmd.robot.protection.walls.walls_settings import MOVING_WALL
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

KIND = "burger"
SIDE = 4.0  # m, of the arena
TRUTH = "orca_true"
"""Mode: avoidance with the true places of robots in place of the tracks of its scans."""
MODES = ("ghost", "barrier", "stop_zone", "orca", "walls_stand", TRUTH)
_BODY = float(np.ptp(load_platform(KIND).footprint[:, 1]))
_PARKED = "parked"
_START = 1.5  # m from the middle


class Found(Struct, frozen=True, kw_only=True):
    """What one run gave; robots that are parked do not count.

    `arrived` of `robots` reached a goal, the last at `last` s (None: not all did). `goals` in all.
    `recovering` and `avoiding`: shares of the instants. `stuck` of `windows` of 10 s. `faults` of
    `touches`. `slowed`: robots that a finding slows at the end; `found`: robots with any finding.
    `cpu` in s.
    """

    arrived: int
    robots: int
    last: float | None
    goals: int
    recovering: float
    stuck: int
    windows: int
    touches: int
    faults: int
    slowed: int = 0
    found: int = 0
    cpu: float


class Run(Struct, frozen=True, order=True):
    """A run to do: one of TASKS in a mode, with a seed."""

    task: str
    mode: str
    seed: int


def _scenario(
    name: str,
    mode: str,
    duration: float,
    groups: Mapping[str, Sequence[Sequence[float]]],
    arena: Mapping[str, Any] | None = None,
) -> Scenario:
    """Robots at poses, by group; each drives through the middle to the other side and back."""
    goals = {"pattern": "goals", "parameters": {"choice": "opposite", "reach": 0.2}}
    parked = {"pattern": "drive", "parameters": {"speed": 0.0}}
    return scenario_of(
        {
            "name": name,
            "duration": duration,
            "trace_rate": 20.0,
            "lidar_visibility": "body",
            "realism": "realistic",
            "arena": {"size": [SIDE, SIDE], **(arena or {})},
            "fields": [
                {"kind": "linear", "name": "x", "slope": 1.0},
                {"kind": "linear", "name": "y", "slope": 1.0, "direction_deg": 90.0},
            ],
            "plugin_dir": str(PLUGINS),
            "platforms": {KIND: protected(KIND, mode, {"unseen_extent": 0.0})},
            "groups": {
                group: {
                    "platform": KIND,
                    "count": len(poses),
                    "prefix": group,
                    "start": {"layout": "list", "poses": [list(pose) for pose in poses]},
                    **(parked if group == _PARKED else goals),
                }
                for group, poses in groups.items()
            },
        }
    )


def _swap(count: int) -> Callable[[str], Scenario]:
    def made(mode: str) -> Scenario:
        angles = [360.0 * i / count for i in range(count)]
        poses = [
            (_START * math.cos(math.radians(a)), _START * math.sin(math.radians(a)), a - 180.0)
            for a in angles
        ]
        return _scenario(f"swap-{count}", mode, 60.0, {"swap": poses})

    return made


def _passage(bodies: float, **given: Any) -> Callable[[str], Scenario]:
    return lambda mode: passage_scenario(Passage(bodies * _BODY, mode=mode, **given))


def _goals(*, is_sparse: bool) -> Callable[[str], Scenario]:
    return lambda mode: scenario(Scene("goals", KIND, "body", mode, is_sparse, 90.0))


def _crossing(mode: str) -> Scenario:
    along = [0.4 * (i - 2) for i in range(5)]
    flows = {
        "east": [(-_START, y, 0.0) for y in along],
        "north": [(x, -_START, 90.0) for x in along],
    }
    return _scenario("crossing", mode, 60.0, flows)


def _intersection(mode: str) -> Scenario:
    corner = 3.5 * _BODY  # m, side of the boxes at the corners of two streets of three bodies
    at = 0.5 * (3.0 * _BODY + corner)
    boxes = [{"at": [x, y], "size": [corner, corner]} for x in (-at, at) for y in (-at, at)]
    flows = {"east": [(-_START, 0.0, 0.0)], "north": [(0.0, -_START, 90.0)]}
    return _scenario("intersection", mode, 60.0, flows, {"boxes": boxes})


def _wall(mode: str) -> Scenario:
    beside = 0.5 * _BODY + 0.09  # m: the half-width of a corridor that recovery calls free
    wall = {"at": [0.0, -beside - 0.05], "size": [2.4, 0.1]}
    return _scenario("wall", mode, 60.0, {"one": [(-_START, 0.0, 0.0)]}, {"boxes": [wall]})


def _parked(x: float) -> Callable[[str], Scenario]:
    groups = {"one": [(-_START, 0.0, 0.0)], _PARKED: [(x, 0.02, 90.0)]}
    return lambda mode: _scenario("parked", mode, 60.0, groups)


def _two(*pose: float) -> Callable[[str], Scenario]:
    groups: dict[str, list[tuple[float, ...]]] = {"one": [(-_START, 0.0, 0.0)], "other": [pose]}
    return lambda mode: _scenario("two", mode, 60.0, groups)


def _at_start(mode: str) -> Scenario:
    box = {"at": [-_START + 0.2, 0.0], "size": [0.1, 0.4]}
    return _scenario("start", mode, 60.0, {"one": [(-_START, 0.0, 0.0)]}, {"boxes": [box]})


TASKS: Mapping[str, Callable[[str], Scenario]] = {
    "goals, sparse": _goals(is_sparse=True),
    "goals, dense": _goals(is_sparse=False),
    "swap of 8": _swap(8),
    "swap of 12": _swap(12),
    "swap of 16": _swap(16),
    "swap of 20": _swap(20),
    "a door of 2 bodies, alone": _passage(2.0, duration=60.0),
    "door of 2 bodies, 4 against 4": _passage(2.0, left=4, right=4),
    "corridor of 2.5 bodies, 2 against 2": _passage(
        2.5, length=1.0, left=2, right=2, duration=120.0
    ),
    "two that swap in a lane": _passage(2.5, length=1.0, right=1, duration=1200.0),
    "doorway": _passage(3.0, right=1, duration=60.0),
    "hallway": _passage(3.0, length=7.0 * _BODY, right=1, duration=120.0),
    "intersection": _intersection,
    "crossing flows, 5 against 5": _crossing,
    "along a wall": _wall,
    "past a parked robot": _parked(0.0),
    "a parked robot on the goal": _parked(_START),
    "two that meet": _two(_START, 0.0, 180.0),
    "two with crossing goals": _two(0.0, -_START, 90.0),
    "an obstacle at the start": _at_start,
}


def scenario_for(task: str, mode: str) -> Scenario:
    """The scenario of a task in one of MODES."""
    return TASKS[task]("orca" if mode == TRUTH else mode)


def measure(trace: Trace, cpu: float) -> Found:
    """The numbers of a trace."""
    rows = np.array([i for i, robot in enumerate(trace.ids) if not robot.startswith(_PARKED)])
    goals: Array = np.nan_to_num(trace.report["goals"][:, rows])
    first = np.where(goals >= 1.0, trace.t[:, None], np.inf).min(axis=0)
    recovering = trace.recovering
    windows, stuck = stuck_windows(trace, rows)
    return Found(
        arrived=int(np.isfinite(first).sum()),
        robots=len(rows),
        last=float(first.max()) if np.isfinite(first).all() else None,
        goals=int(goals.max(axis=0).sum()),
        recovering=0.0 if recovering is None else float(recovering[:, rows].mean()),
        stuck=stuck,
        windows=windows,
        touches=len(collisions(trace)),
        faults=len(list(faults(trace))),
        cpu=cpu,
    )


def perform(run: Run) -> Traced[Found]:
    """Simulate and measure one run, in this process."""
    begin = time.process_time()
    made = scenario_for(run.task, run.mode)
    lockstep = Lockstep(made, run.seed)
    if run.mode == TRUTH:
        replace_trackers(lockstep, TrueTracker)
    lockstep.advance(made.duration)
    trace = lockstep.trace()
    found = measure(trace, time.process_time() - begin)
    shells = [shell for shell in lockstep.shells if shell is not None]
    status = [shell.robot.status(lockstep.world.time) for shell in shells]
    slowing = [any(MOVING_WALL not in text for text in one.findings) for one in status]
    with_findings = sum(bool(one.findings) for one in status)
    return traced(msgspec.structs.replace(found, slowed=sum(slowing), found=with_findings), trace)


def carry_out(
    tasks: Sequence[str], modes: Sequence[str], seeds: Sequence[int], jobs: int, file: Path
) -> dict[tuple[str, str], list[Found]]:
    """The runs of each task and mode, one for each seed; those in `file` are not done again.

    Seeds come first: after an interruption all cells have as many runs.
    """
    cells = [(task, mode) for task in tasks for mode in modes]
    runs = [Run(*cell, seed) for seed in seeds for cell in cells]
    found: dict[tuple[str, str], list[Found]] = {cell: [] for cell in cells}
    for record in keeper.records(perform, runs, file, jobs=jobs):
        found[record.task.task, record.task.mode].append(record.found)
    return found


def table(found: Mapping[tuple[str, str], Sequence[Found]]) -> str:
    """Markdown, a row for each task and mode.

    `60, 120 s`: in how many runs all robots arrived within this time. `median`: of the time in
    which all robots of a run arrived.
    """
    rows = [
        [
            *("task", "mode", "arrived", "of ghosts", "all within [s]", "60, 120 s", "median [s]"),
            *("goals", "recovering", "stuck", "touches", "at fault"),
            *("slowed", "with findings", "CPU [s]"),
        ]
    ]
    for (task, mode), runs in found.items():
        goals = sum(one.goals for one in runs)
        ghosts = sum(one.goals for one in found.get((task, "ghost"), ()))
        last = [math.inf if one.last is None else one.last for one in runs]
        complete = sum(map(math.isfinite, last))
        worst = f"{max(one for one in last if math.isfinite(one)):.0f}" if complete else "-"
        robots = sum(one.robots for one in runs)
        rows.append(
            [
                *(task, mode, f"{sum(one.arrived for one in runs)} of {robots}"),
                f"{goals / ghosts:.0%}" if ghosts else "-",
                f"{worst} ({complete} of {len(runs)} runs)",
                ", ".join(str(sum(one <= within for one in last)) for within in (60.0, 120.0)),
                f"{float(np.median(last)):.0f}",
                str(goals),
                f"{float(np.mean([one.recovering for one in runs])):.0%}",
                f"{sum(one.stuck for one in runs) / sum(one.windows for one in runs):.1%}",
                str(sum(one.touches for one in runs)),
                str(sum(one.faults for one in runs)),
                f"{sum(one.slowed for one in runs)} of {robots}",
                f"{sum(one.found for one in runs)} of {robots}",
                f"{sum(one.cpu for one in runs):.0f}",
            ]
        )
    return markdown(rows)
